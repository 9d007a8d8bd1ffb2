"""The targets that a table names, against those that the robot file has."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from casadical.core.errors import InputError
from casadical.identification.sessions import sessions_in
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot


def with_known_targets(m: Measurements, robot: Robot) -> Measurements:
    """The measurements, without a column `tool` that names one point of a robot with one tool.

    Raises InputError where the column names a point that the robot file does not have, or is missing where the robot
    file has several.
    """
    measured = names_in(m)
    known = [robot.tool_name, *(t.name for t in robot.targets)]
    if not robot.targets and len(measured) < 2:
        return replace(m, conditions={k: v for k, v in m.conditions.items() if not k.startswith("tool_")})
    missing = [name for name in measured if name not in known]
    if missing:
        there = f"the robot file has {', '.join(known)}" if robot.targets else "the robot file has one tool"
        raise InputError(
            f"{m.source}: column 'tool' names {', '.join(measured)}, and {there}: give a table [[tool]] with name, "
            f"xyz_mm and unknown for each (docs/robot-file.md); missing: {', '.join(missing)}"
        )
    return m


def names_in(m: Measurements) -> list[str]:
    """Names of the targets that were measured, in the order in which they come."""
    return [name.removeprefix("tool_") for name in m.conditions if name.startswith("tool_")]


def refuse_nameless(m: Measurements, robot: Robot) -> None:
    """Raises InputError where a robot has several targets and the table does not say which was measured."""
    if robot.targets and not names_in(m):
        known = ", ".join([robot.tool_name, *(t.name for t in robot.targets)])
        raise InputError(
            f"{m.source}: the robot file has several targets, {known}, and the table does not say which one was "
            "measured: add a column 'tool' with one of these names in each row, or list the rows in `tools` of "
            "problem.toml (docs/measurements.md)"
        )


def unfitted(sets: Mapping[str, Sequence[Measurements]]) -> list[str]:
    """Targets that were measured in poses that are held out, but in none that is fitted: a sentence each."""
    fitted = {name for m in sets.get("identify", ()) for name in names_in(m) if m.conditions[f"tool_{name}"].any()}
    found = []
    for name, parts in sets.items():
        for m in parts:
            for target in names_in(m):
                rows = m.row[m.conditions[f"tool_{target}"] > 0]
                if target not in fitted and len(rows):
                    listed = ", ".join(map(str, rows[:8])) + (" ..." if len(rows) > 8 else "")
                    found.append(
                        f"{m.source}: target {target!r} was measured in row {listed} only, of the set {name!r}; no "
                        "pose that is fitted tells where it is: measure it at three poses or more, or leave the rows "
                        f"out (leave_out = [{listed}] in problem.toml)"
                    )
    inside = set(sessions_in(sets.get("identify", ())))
    for name, parts in sets.items():
        for session in sorted(set(sessions_in(parts)) - inside):
            found.append(
                f"session {session!r} has poses of the set {name!r} only; none that is fitted tells where its base and "
                "tool are: put some of them into the set 'identify'"
            )
    return found


def unmeasured(sets: Mapping[str, Sequence[Measurements]], robot: Robot) -> list[str]:
    """Targets of the robot file that no row names."""
    seen = {name for parts in sets.values() for m in parts for name in names_in(m)}
    return [name for name in (robot.tool_name, *(t.name for t in robot.targets)) if name and name not in seen]

"""Several sessions of one robot: base, tool or joint zeros may differ between them.

The first session has the robot's own base and tool; each further one is an effect
(`instrument.Session`) with the differences from it. All other parameters are shared. What sets of some kinds cannot
determine in any number is said here, with a remedy.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.transforms import to_xyz
from casadical.effects import Session
from casadical.identification.least_squares import LeastSquares
from casadical.identification.placement import place_frames
from casadical.measurements.kinds.distance import Distance
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import SESSION_PREFIX, Measurements
from casadical.robot.robot import Robot


def sessions_in(sets: Sequence[Measurements]) -> tuple[str, ...]:
    """Return the names of all sessions of the sets in order of appearance; () if none is stated."""
    return tuple(dict.fromkeys(name for m in sets for name in m.session_names))


def split_by_session(sets: Sequence[Measurements]) -> tuple[Measurements, ...]:
    """Return the sets with every set of several sessions split into one set for each of them.

    In a resulting set base and tool are the same at all poses; poses of no session are left out.
    """
    alone = []
    for m in sets:
        flags = [flag for name in m.session_names if (flag := m.conditions[SESSION_PREFIX + name] > 0).any()]
        alone += [m[np.flatnonzero(flag)] for flag in flags] if len(flags) > 1 else [m]
    return tuple(alone)


def with_sessions(robot: Robot, sets: Sequence[Measurements]) -> tuple[Robot, tuple[str, ...]]:
    """Return the robot with an effect for each session but the first, and the effects' labels.

    The labels name groups of parameters that are to be identified. The robot is unchanged where it
    already has such effects, the sets have fewer than two sessions, or sessions share all.
    Raises InputError where a table does not state its session and others do, and for fewer than
    six poses of a session where each has a base of its own.
    """
    labels = tuple(e.label for e in robot.effects if isinstance(e, Session))
    names = sessions_in(sets)
    if labels or not names:
        return robot, labels
    for m in sets:
        if not m.session_names:
            raise InputError(
                f"{m.source}: says no session, and others do ({', '.join(names)}): give it a column 'session', or "
                'session = "..." in its [[measurements]]'
            )
    if len(names) < 2:
        return robot, ()
    rule = robot.sessions
    least = 6
    for name in names:
        count = sum(int(m.conditions.get(SESSION_PREFIX + name, np.zeros(1)).sum()) for m in sets)
        if rule.base == "own" and count < least:
            raise InputError(
                f"session {name!r} has {count} poses; where its base and tool are cannot be determined from fewer than "
                f"{least}: measure {least - count} more in it, or write "
                'base = "shared" in [sessions] of '
                "problem.toml where nothing was moved"
            )
    zeros = robot.n if rule.zeros == "own" else 0
    if not (zeros or "own" in (rule.base, rule.tool)):
        return robot, ()
    effects = [Session(None, name, rule.base == "own", rule.tool == "own", zeros) for name in names[1:]]
    return robot.with_effect(*effects), tuple(e.label for e in effects)


def place_sessions(robot: Robot, sets: Sequence[Measurements]) -> Robot:
    """Return the robot with initial base and tool frames, and those of sessions, fitted to the sets.

    The robot's own frames are fitted by `place_frames` to the first set with positions outside of
    the sessions, or to all sets without such. Each session with a base of its own and measured
    positions gets this base and, where that is its own too, its tool point; others keep theirs.
    """
    sessions = [e for e in robot.effects if isinstance(e, Session)]
    if not sessions:
        return place_frames(robot, sets)
    bare = robot.with_only(e for e in robot.effects if e not in sessions)
    placed = place_frames(bare, _first_positions(sets, sessions, inside=False) or sets)
    values = dict(robot.effect_values)
    for effect in sessions:
        own = _first_positions(sets, [effect], inside=True)
        if own is None or not effect.base_too:
            continue
        there = place_frames(placed, own)
        moved = np.linalg.solve(placed.base.T, there.base.T)
        values |= _values_of_session(effect, ("x", "y", "z"), moved[:3, 3])
        values |= _values_of_session(effect, ("rx", "ry", "rz"), to_xyz(moved[:3, :3]))
        if effect.tool_too:
            values |= _values_of_session(
                effect, ("tool_x", "tool_y", "tool_z"), there.tool.T[:3, 3] - placed.tool.T[:3, 3]
            )
    return replace(robot, base=placed.base, tool=placed.tool, targets=placed.targets, effect_values=values)


def not_shared(sets: Sequence[Measurements]) -> str:
    """Return the end of a sentence "they cannot ..." on sessions without a pose in common.

    It states what they cannot distinguish, with a remedy; it is empty where every further session
    repeats a pose of the first one, or there are fewer than two sessions.
    """
    names = sessions_in(sets)
    if len(names) < 2:
        return ""
    flags = [[m.conditions.get(SESSION_PREFIX + name, np.zeros(len(m))) > 0 for m in sets] for name in names]
    poses = [np.concatenate([m.q[own] for m, own in zip(sets, each, strict=True)]) for each in flags]
    from scipy.spatial.distance import cdist

    # Two sessions share a pose if its joint readings differ by less than 5e-4 rad or m.
    near = [(cdist(poses[0], q, "chebyshev") < 5e-4).any() for q in poses[1:]]
    apart = [name for name, same in zip(names[1:], near, strict=True) if not same]
    if not apart:
        return ""
    return (
        f"tell a change of the robot from how it was set up: session {', '.join(map(repr, apart))} shares no pose with "
        f"{names[0]!r}; some poses of {names[0]!r} measured again would"
    )


def _first_positions(sets: Sequence[Measurements], sessions: Sequence[Session], inside: bool) -> Measurements | None:
    """Return the poses in any of these sessions of the first position set with such; else None."""
    for m in (m for m in sets if m.position is not None):
        flags = sum((m.conditions.get(e.column, np.zeros(len(m))) for e in sessions), np.zeros(len(m)))
        if len(rows := np.flatnonzero((flags > 0) == inside)):
            return m[rows]
    return None


def _values_of_session(effect: Session, names: Sequence[str], values: Array) -> dict[str, float]:
    """Return a session's parameters, "label.name" -> value [SI]; `names` are without the label."""
    return {f"{effect.label}.{name}": float(v) for name, v in zip(names, values, strict=True)}


def undetermined(sets: Sequence[Measurements], where: Mapping[str, Array]) -> Iterator[str]:
    """Yield what sets of these kinds cannot determine, each as the end of "these data cannot ...".

    Of sets with positions only sessions without a common pose are judged.

    where : "set number/point name" -> unknown point, as of `Identification.unknown_points`, shape
        (3,) [m]
    """
    if apart := not_shared(sets):
        yield apart
    if any(m.position is not None for m in sets):
        return
    if not any(find_kind(m.kind).has_scale or m.separations for m in sets):
        gives = "one distance between two of them gives it ([[measurements.separation]])"
        if not any(find_kind(m.kind).places for m in sets):
            gives = "touches of a ball of known radius give it (kind sphere)"
        yield (
            "tell the size of the robot: no distance between touched points is known, and the longest length is taken "
            f"as it is; {gives}"
        )
    if any(m.kind != Distance.name for m in sets):
        return
    ends = [
        m.target
        if m.target is not None
        else np.array([where[f"{k}/{name}"] for name in find_kind(m.kind).point_names(m.arrays)])
        for k, m in enumerate(sets)
    ]
    places = np.unique(np.concatenate(ends).round(4), axis=0)
    if len(places) == 1:
        yield (
            "see errors across the beam of the one instrument, nor a turn of the whole robot about it; distances to a "
            "second and a third place, not in line with it, show them"
        )
        return
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    # Places are collinear if their second singular value is below this share of the first.
    if spread[1] < 0.05 * spread[0]:
        yield (
            f"see a turn of the whole robot about the line in which the {len(places)} places lie that distances are "
            "measured to; distances to one place off that line show it"
        )


def undetermined_at_start(robot: Robot, sets: Sequence[Measurements]) -> Iterator[str]:
    """Yield what these sets cannot determine, before an identification; see `undetermined`.

    Unknown points are estimated from the positions of the robot, whose base and tool are placed.
    """
    problem = LeastSquares(robot, tuple(sets), (), "linear", False, ((1.0, 1.0),) * len(sets))
    yield from undetermined(sets, dict(zip(problem.labels, problem.points, strict=True)))

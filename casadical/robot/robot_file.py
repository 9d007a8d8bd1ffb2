"""Robot files in TOML: reading, checked by `robot_schema`, and writing."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from casadical import __version__
from casadical.core.basics import InputError, errors_of, shown
from casadical.core.files import write_together
from casadical.core.parts import WIDTHS, Body, BodyWidth, Coupling, Joint, Placement, Target
from casadical.core.reading import load_toml
from casadical.core.schema import check
from casadical.core.statistics import rounded_at
from casadical.core.transforms import to_rpy
from casadical.effects import Effect
from casadical.effects.plugins import defined_in_files, find_effect
from casadical.robot.effect_tables import FILE_VERSION, large_covariances, text_of
from casadical.robot.robot import Robot, dh_row, in_file_units
from casadical.robot.robot_schema import RobotFile, ToolTable


def read_robot(path: str | Path, effects: Sequence[type[Effect]] = ()) -> Robot:
    """Read a robot from its TOML file, with its effects and the accuracy of their values.

    effects : classes of your own, besides those that are installed (see
        `casadical.effects.plugins`); a file runs no other code
    Raises InputError: a file that is no robot; it names the file, the key and what is allowed.

    Examples
    --------
    >>> arm = casadical.read_robot("problems/planar/robot.toml")
    >>> arm.n, arm.name
    (2, 'Planar arm of two links')
    """
    path = Path(path)
    return robot_from(load_toml(path), path.name, effects, path.parent)


def robot_from(
    data: Mapping[str, Any], source: str, effects: Sequence[type[Effect]] = (), folder: Path = Path()
) -> Robot:
    """Return the robot that the tables of a robot file describe.

    data : content of the TOML file; source : its name in messages; effects : as of `read_robot`
    folder : of the file, and of the NPZ file that it may name
    Raises InputError for a file that is no robot, or of a newer version.
    """
    version = data.get("casadical")
    if isinstance(version, int) and version > FILE_VERSION:
        raise InputError(
            f"{source}: casadical = {version}: a file of version {version}, written by "
            f"{data.get('written_by', 'a newer casadical')}; this is casadical {__version__}, "
            f"which reads files up to version {FILE_VERSION}: install the newer one"
        )
    file = check(RobotFile, _with_tools_apart(data), source)
    with errors_of(f"{source}: "):
        return file.robot(effects, folder)


def _with_tools_apart(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the tables with the first of several [[tool]] under the key `tool`.

    The others are listed under `further_tool`; a single [tool] is unchanged.
    """
    tools = data.get("tool")
    if not isinstance(tools, list) or not tools or not all(isinstance(t, dict) for t in tools):
        return data
    first = {key: value for key, value in tools[0].items() if key != "name"}
    return {**data, "tool": first, "tool_name": tools[0].get("name", ""), "further_tool": tools[1:]}


def with_tools(robot: Robot, tools: Sequence[ToolTable]) -> Robot:
    """Return the robot with these measured points in place of its tool.

    What is unknown of them is what was unknown of the tool, unless the first declares it.

    tools : at least one, in the frame of the robot's present tool; only the first one's orientation
        is used
    Raises InputError for targets that do not fit each other.
    """
    first, *further = tools
    T = robot.tool.T
    targets = tuple(Target(t.name, T[:3, :3] @ np.array(t.xyz) + T[:3, 3]) for t in further)
    unknown = first.unknown if "unknown" in first.model_fields_set else robot.tool.unknown
    tool = Placement(T @ first.placement().T, unknown)
    return replace(robot, tool=tool, tool_name=first.name if further else "", targets=targets)


def write_robot(robot: Robot, path: str | Path, comment: str = "", effects: Sequence[type[Effect]] = ()) -> None:
    """Write a robot as TOML that `read_robot` reads; the file appears complete or not at all.

    Large covariances are in a second file next to it (see `robot_files`).

    path : file to write; an existing one is replaced
    comment : text of the comment at the file's head
    effects : classes of your own, as of `read_robot`
    Raises InputError: an effect that is not installed, and so could not be read again.

    Examples
    --------
    >>> casadical.write_robot(found.robot, "calibrated.toml", "after the crash of May")
    >>> read = casadical.read_robot("calibrated.toml")
    >>> bool(abs(read.parameters["a1"].value - found.robot.parameters["a1"].value) < 1e-15)  # [m]
    True
    """
    write_together(robot_files(Path(path), robot, comment, effects))


def robot_files(
    path: Path, robot: Robot, comment: str = "", effects: Sequence[type[Effect]] = (), *, reproducible: bool = False
) -> dict[Path, str | bytes]:
    """Return the content of the robot's file by its path, and of the file of its large covariances.

    That of arm.robot.toml is arm.covariance.npz; it is absent where no covariance is large.

    path : of the robot file; further arguments, and Raises InputError : as of `to_toml`
    """
    covariances = large_covariances(_as_written(robot).knowledge, reproducible)
    companion = path.with_name(path.name.removesuffix(".toml").removesuffix(".robot") + ".covariance.npz")
    text = to_toml(robot, comment, effects, reproducible=reproducible, companion=companion.name if covariances else "")
    return {path: text, **({companion: covariances} if covariances else {})}


def to_toml(
    robot: Robot,
    comment: str = "",
    effects: Sequence[type[Effect]] = (),
    *,
    reproducible: bool = False,
    companion: str = "",
) -> str:
    """Return the robot as the text of a TOML file.

    Numbers have full precision, those of covariances and remaining errors 12 digits. Units are mm
    and degrees, of effects SI. Sessions belong to their measurements: base and tool are those of
    the first one. Without effects, knowledge and remaining errors it is version 1.

    comment, effects, and Raises InputError : as of `write_robot`
    reproducible : whether digits are omitted that depend on a processor's rounding, so that a
        result is the same file everywhere
    companion : name of the file that has the large covariances; "": the text has them
    """
    robot = _as_written(robot)
    defined = {definition.name for definition in defined_in_files(robot.effects)}
    for effect in robot.effects:
        if effect.name not in defined and find_effect(effect.name, effects) is not type(effect):
            raise InputError(f"{effect.label}: another effect of this name is installed; rename yours")
    more = bool(robot.effects or robot.knowledge or robot.remaining)
    tool = _frame_table(robot.tool)
    further = [{"name": t.name, "xyz_mm": _mm(t.point), "unknown": robot.tool.unknown} for t in robot.targets]
    document = tomlkit.document()
    for line in comment.splitlines():
        document.add(tomlkit.comment(shown(line)))
    # Units of bounds and priors in a file; a group is written if they are not its default ones.
    width_units = {"length_bound": "mm", "angle_bound": "deg", "length_prior": "mm", "angle_prior": "deg"}
    widths = {group: in_file_units(w, **width_units) for group, w in robot.widths.items() if w != WIDTHS[group]}
    if robot.body_width != BodyWidth():
        widths["body"] = {"mass_share": robot.body_width.mass_share, "com_mm": _mm(robot.body_width.com)}
    four_bar_units = {"crank": "mm", "coupler": "mm", "rocker": "mm", "offset": "deg"}
    tables = {
        "casadical": 2 if more else 1,
        "written_by": f"casadical {__version__}" if more else None,
        "name": robot.name,
        "notes": list(robot.notes) or None,
        "masses": robot.masses if robot.masses != "declared" else None,
        "base": _frame_table(robot.base),
        "tool": [{"name": robot.tool_name, **tool}, *further] if robot.targets else tool,
        "gravity": {"frame": robot.gravity_frame, "vector_m_per_s2": [float(g) for g in robot.gravity]},
        "payload": _body_table(robot.payload) if robot.payload else None,
        "drive": robot.drive.table() if robot.drive else None,
        "width": widths,
        "joint": [_joint_table(joint) for joint in robot.joints],
        "four_bar": [
            {"driven": f.driven, "carrier": f.carrier, **in_file_units(f, **four_bar_units)} for f in robot.loops
        ]
        or None,
    }
    document.update(
        {key: _without_rounding_digits(key, v) if reproducible else v for key, v in tables.items() if v is not None}
    )
    text = tomlkit.dumps(document)
    if more:
        lines = text_of(robot, robot.effects, robot.knowledge, robot.remaining, reproducible, companion)
        text = "\n".join([text.rstrip("\n"), *lines, ""])
    check(RobotFile, _with_tools_apart(tomllib.loads(text)), f"robot {shown(robot.name)!r} cannot be written")
    return text


def _as_written(robot: Robot) -> Robot:
    """Return the robot without sessions and without covariances of parameters that it lacks."""
    robot = robot.without_sessions
    knowledge = robot.knowledge
    gone = set(knowledge.std_errors) - set(robot.parameters.names) if knowledge else set[str]()
    return replace(robot, knowledge=knowledge.without(gone)) if knowledge and gone else robot


def _without_rounding_digits(key: str, value: Any) -> Any:
    """Return a value of the file, floats rounded to digits that no processor's rounding changes.

    Lists and tables are rounded entry by entry.
    """
    if isinstance(value, dict):
        return {name: _without_rounding_digits(name, inner) for name, inner in value.items()}
    if isinstance(value, list):
        return [_without_rounding_digits(key, inner) for inner in value]
    if not isinstance(value, float):
        return value
    if key.startswith("stiffness"):
        return rounded_at(value, value, 7)
    decimals = {"_mm": 8, "_deg": 9, "_s2": 9}
    return round(value, next((n for end, n in decimals.items() if key.endswith(end)), 15)) + 0.0


def _mm(values: Any) -> Any:
    """Return metres as millimetres, a number or a list."""
    return (1e3 * np.asarray(values)).tolist()


def _deg(values: Any) -> Any:
    """Return radians as degrees, a number or a list."""
    return np.rad2deg(values).tolist()


def _frame_table(placement: Placement) -> dict[str, Any]:
    """Return the table of a base or tool frame, with the keys xyz_mm, rpy_deg and unknown."""
    T = placement.T
    return {"xyz_mm": _mm(T[:3, 3]), "rpy_deg": _deg(to_rpy(T[:3, :3])), "unknown": placement.unknown}


def _body_table(body: Body) -> dict[str, Any]:
    """Return the table of a body, with the keys mass_kg, com_mm and, if declared, inertia_kgm2."""
    table: dict[str, Any] = {"mass_kg": float(body.mass), "com_mm": _mm(body.com)}
    if body.inertia is not None:
        table["inertia_kgm2"] = [float(v) for v in body.inertia[np.triu_indices(3)]]
    return table


def _joint_table(joint: Joint) -> dict[str, Any]:
    """Return the [[joint]] table of a robot file, by its keys, for a joint.

    It has DH row, limits, and as far as given name, type, coupling, readings, compliance and body.
    """
    table: dict[str, Any] = {"name": joint.name} if joint.name else {}
    table |= {key: value for key, value in dh_row(joint).items() if value is not None}
    table |= {"type": "prismatic"} if joint.kind == "prismatic" else {}
    unit, to_unit = ("mm", _mm) if joint.kind == "prismatic" else ("deg", _deg)
    table[f"limits_{unit}"] = to_unit([joint.lower, joint.upper])
    if joint.coupling is not None:
        table["follows"] = [[j, float(k)] for j, k in joint.coupling.follows]
        table[f"at_{unit}"] = to_unit(joint.coupling.at)
    if joint.readings is not None:
        table |= readings_table(joint.readings, joint.kind)
    if joint.compliance is not None:
        table["compliant"] = True
        if joint.compliance > 0:
            unit = "Nm_per_rad" if joint.kind == "revolute" else "N_per_m"
            table[f"stiffness_{unit}"] = float(1 / joint.compliance)
    if joint.body:
        table["body"] = _body_table(joint.body)
    return table


def readings_table(readings: Coupling, kind: str) -> dict[str, Any]:
    """Return the keys of a row's `readings` in a file; the offset's, in deg or mm, if not zero."""
    unit, to_unit = ("mm", _mm) if kind == "prismatic" else ("deg", _deg)
    offset = {f"offset_{unit}": to_unit(readings.at)} if readings.at else {}
    return {"readings": [[j, float(k)] for j, k in readings.follows], **offset}

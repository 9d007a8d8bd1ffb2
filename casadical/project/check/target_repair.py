"""Repairs written into a problem: of slips, and of several targets that the table does not name."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tomlkit

from casadical.core.arrays import Array
from casadical.core.files import write_together
from casadical.core.reading import load_toml, read_text
from casadical.project.check.repair import MIRRORED, difference, left_mm, write_repair
from casadical.project.check.result import Precheck
from casadical.project.problem import read_problem_robot
from casadical.robot.robot_file import robot_from
from casadical.robot.urdf import read_urdf


def repaired(found: Precheck) -> str:
    """Write the repair of what a check has found, targets before slips; the lines that change, or nothing.

    Raises InputError.
    """
    robot, slips, targets = found.nominal, found.slips, found.targets
    if targets and targets.which is not None and targets.points is not None and targets.rows is not None:
        rows = [targets.rows[targets.which == k] for k in range(targets.count)]
        texts = files_with_targets(found.folder, targets.names, targets.points, rows)
        shown = difference(texts)
        write_together(texts)
        return f"{shown}\nrepaired: {targets.count} targets, named {', '.join(targets.names)}"
    if wrong := found.misnamed:
        rows = [wrong.row[wrong.meant == k] for k in range(len(wrong.names))]
        texts = file_with_names(found.folder, wrong.names, rows)
        shown = difference(texts)
        write_together(texts)
        return f"{shown}\nrepaired: {int((wrong.given != wrong.meant).sum())} rows name another target"
    if robot and slips and slips.explains:
        shown = write_repair(found.folder, slips.best, robot)
        meant = f"\nthe frame is mirrored: {MIRRORED}" if slips.best.mirrored else ""
        after = left_mm(slips.best, robot)
        return f"{shown}\nrepaired: {1e3 * slips.before.error:.4g} mm before, {after} after{meant}"
    return ""


def not_repaired(found: Precheck) -> str:
    """Why errors are left that nothing was written for; empty where there are none."""
    if found.ok:
        return ""
    slips = found.slips
    if slips and not slips.explains:
        best, before = 1e3 * slips.best.error, 1e3 * slips.before.error
        return f"nothing more is written: of {before:.4g} mm the best explanation leaves {best:.4g} mm, which is none"
    topics = ", ".join(dict.fromkeys(f.topic for f in found.of_level("error")))
    return f"nothing more is written: --repair knows no remedy for these errors ({topics}); they say what to correct"


def files_with_targets(folder: Path, names: Sequence[str], points: Array, rows: Sequence[Array]) -> dict[Path, str]:
    """problem.toml and, unless the robot is from a URDF, the robot file, with several targets in place of one.

    points : in the last link's frame, shape (K, 3) [m]; rows : of the file, of each target
    """
    path = folder / "problem.toml"
    problem = tomlkit.parse(file_with_names(folder, names, rows)[path])
    unknown = read_problem_robot(folder).tool.unknown
    place = folder / str(problem.get("robot", "robot.toml"))
    if place.suffix != ".toml":
        urdf: Any = problem.setdefault("urdf", tomlkit.table())
        tip = read_urdf(place, urdf.get("base_link"), urdf.get("tip_link")).tool.T
        urdf["tool"] = _tools(names, points, tip, unknown)
        return {path: tomlkit.dumps(problem)}
    document = tomlkit.parse(read_text(place))
    bare = {key: value for key, value in load_toml(place).items() if key != "tool"}
    document["tool"] = _tools(names, points, robot_from(bare, place.name).tool.T, unknown)
    return {path: tomlkit.dumps(problem), place: tomlkit.dumps(document)}


def file_with_names(folder: Path, names: Sequence[str], rows: Sequence[Array]) -> dict[Path, str]:
    """problem.toml with the rows of the file at which each target was measured."""
    path = folder / "problem.toml"
    problem = tomlkit.parse(read_text(path))
    tables: Any = problem["measurements"]
    listed = tomlkit.table()
    for name, own in zip(names, rows, strict=True):
        listed.add(name, [int(row) for row in own])
    tables[0]["tools"] = listed
    return {path: tomlkit.dumps(problem)}


def _tools(names: Sequence[str], points: Array, flange: Array, unknown: str) -> Any:
    """Tables of these points, seen from the frame in which the file gives its tool, at `flange` in the last link."""
    seen = (points - flange[:3, 3]) @ flange[:3, :3]
    tools = tomlkit.aot()
    for name, point in zip(names, seen, strict=True):
        tool = tomlkit.table()
        tool.update({"name": name, "xyz_mm": [round(1e3 * float(v), 1) for v in point], "unknown": unknown})
        tools.append(tool)
    return tools

"""Repair of slips and of target names, written to problem.toml and to the robot file."""

import difflib
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from casadical.core.basics import Array, InputError
from casadical.core.files import write_together
from casadical.core.parts import Coupling, with_estimated_masses
from casadical.core.reading import load_toml, read_text
from casadical.measurements.columns import ORIENTATION, Source
from casadical.measurements.raw_table import read_table
from casadical.project.check.result import Precheck
from casadical.project.check.slip_fit import Fit
from casadical.project.check.slip_list import MIRROR_WARNING, error_in_mm, meant_length, other_lengths
from casadical.project.new.texts import with_masses
from casadical.project.problem import read_problem, read_problem_robot
from casadical.project.problem_file import UrdfTable, as_toml, robot_of_file
from casadical.project.recognition import understood
from casadical.robot.robot import Robot
from casadical.robot.robot_file import readings_table, robot_from
from casadical.robot.urdf import read_urdf


def repaired_files(folder: Path, fit: Fit, robot: Robot) -> dict[Path, str]:
    """Return path -> text of problem.toml and of the robot file with the slips of a fit undone.

    How the controller counts its joints (signs, zeros, couplings), rows and lengths belong to the
    robot file, of a URDF to [urdf] of problem.toml; columns and units to the first table of
    problem.toml. Unchanged files are not included. Raises InputError.
    """
    path = folder / "problem.toml"
    problem = tomlkit.parse(read_text(path))
    tables: Any = problem["measurements"]
    table = tables[0]
    raw = read_table(folder / str(table["file"]))
    present = _table_columns(folder, table, robot)
    columns = {**present, **repaired_columns(fit, robot, {**{n: Source(n) for n in raw.header}, **present})}
    texts: dict[Path, str] = {}
    other, counted, repaired_robot = other_lengths(fit, robot), _counted(fit, robot), robot
    place = folder / str(problem.get("robot", "robot.toml"))
    if counted and place.suffix == ".urdf":
        urdf: Any = problem.setdefault("urdf", tomlkit.table())
        listed = {str(joint["name"]): dict(joint) for joint in urdf.get("joint", [])}
        urdf["joint"] = tomlkit.aot()
        for name, entry in (listed | {str(robot.joints[i].name): entry for i, entry in counted.items()}).items():
            urdf["joint"].append(tomlkit.item({"name": name, **entry}))
        texts[path] = tomlkit.dumps(problem)
        repaired_robot = robot_of_file(place, UrdfTable.model_validate(urdf.unwrap()))
    if fit.hypothesis.rows or fit.hypothesis.lengths or other or (counted and place.suffix != ".urdf"):
        times = other or 1.0
        if place.suffix != ".toml":
            raise InputError(
                f"{place}: the repair changes rows of the robot, which is not a robot file; change it by hand"
            )
        document = tomlkit.parse(read_text(place))
        convention = str(document.get("convention", "modified"))
        if fit.hypothesis.rows:
            convention = {"modified": "standard", "standard": "modified"}[convention]
            document["convention"] = convention
        rows: Any = document["joint"]
        for i, entry in counted.items():
            for key in [k for k in rows[i] if re.fullmatch(r"readings|offset_\w+", k)]:
                del rows[i][key]
            if entry != {"readings": [[i + 1, 1.0]]}:
                rows[i].update(entry)
        for name, i, departure in fit.hypothesis.lengths:
            # Standard rows have the a of the next modified row.
            row = rows[i - 1 if convention == "standard" and name == "a" else i]
            key, factor = (f"{name}_m", 1.0) if f"{name}_m" in row else (f"{name}_mm", 1e3)
            value = factor * meant_length(float(row.get(key, 0.0)) / factor, departure)
            row[key] = round(value, 4 if factor == 1.0 or times != 1.0 else 1)
        for part in (*rows, document.get("tool", {})) if times != 1.0 else ():
            for key in [k for k in part if re.fullmatch(r"(a|d|b|xyz)_mm?", k)]:
                own = np.array(part[key], dtype=float) * times
                part[key] = own.tolist()
        # Estimated masses lie in the frames of the other convention: they are estimated again.
        again = fit.hypothesis.rows and document.get("masses") == "estimated"
        if again:
            del document["masses"], document["width"]["body"]
            for row in rows:
                del row["body"]
        text = tomlkit.dumps(document)
        if again:
            bare = robot_from(tomllib.loads(text), place.name, folder=place.parent)
            text = with_masses(text, with_estimated_masses(bare), convention == "standard")
        texts[place] = text
        repaired_robot = robot_from(tomllib.loads(texts[place]), place.name, folder=place.parent)
    # The order of a quaternion's numbers was inferred from readings with the slip: infer it again.
    others = {ours: source for ours, source in columns.items() if not re.fullmatch(ORIENTATION, ours)}
    meaning = understood(raw, repaired_robot, others, table.get("kind"))
    again = {ours: source for ours, source in meaning.sources.items() if re.fullmatch(ORIENTATION, ours)}
    columns = columns if meaning.questions or not again else {**others, **again}
    if columns != present:
        table["columns"] = _columns_table(columns)
        texts[path] = tomlkit.dumps(problem)
    return texts


def _table_columns(folder: Path, table: Any, robot: Robot) -> dict[str, Source]:
    """Return the columns of a table of problem.toml, declared or inferred, by our name."""
    raw = read_table(folder / str(table["file"]))
    given = {str(ours): Source.read(theirs) for ours, theirs in dict(table.get("columns", {})).items()}
    return {**understood(raw, robot, given, table.get("kind")).sources, **given}


def _columns_table(columns: Mapping[str, Source]) -> Any:
    """Return the table `columns` of problem.toml."""
    made = tomlkit.table()
    for ours, source in columns.items():
        made[ours] = as_toml(source)
    return made


def _counted(fit: Fit, robot: Robot) -> dict[int, dict[str, Any]]:
    """Return index of a joint -> keys that say how its row follows from the controller's readings.

    Only joints are listed for which the fit changes that.
    """
    h, n = fit.hypothesis, robot.n
    table = h._replace(sign=(1,) * n, zero=(0.0,) * n, add=(0,) * n)
    if robot.counts_otherwise and table.source + table.factor != tuple(range(n)) + (1.0,) * n:
        raise InputError(
            f"{robot.name}: its file says how the controller counts (readings), and columns are swapped or in another "
            "unit; correct the columns in problem.toml by hand"
        )
    # A reading of zero on all joints, and of one on each, tell the linear map of the fit.
    whole = h._replace(source=tuple(range(n)), factor=(1.0,) * n)
    b = whole.readings(np.zeros((1, n)))[0]
    A = whole.readings(np.eye(n)).T - b[:, None]
    A, b = A @ robot.reading_map[0], A @ robot.reading_map[1] + b
    made = {}
    for i in range(n):
        if not np.array_equal(A[i], robot.reading_map[0][i]) or b[i] != robot.reading_map[1][i]:
            factors = tuple((int(j) + 1, float(A[i, j])) for j in np.flatnonzero(A[i]))
            made[i] = readings_table(Coupling(factors, _round(b[i])), robot.joints[i].kind)
    return made


def repaired_columns(fit: Fit, robot: Robot, present: Mapping[str, Source]) -> dict[str, Source]:
    """Return casadical's column name -> its new source, for the columns that the repair changes.

    present : casadical's column name -> its present source, for all columns
    Raises InputError where a column is missing, or is a sum of columns already.
    """
    h = fit.hypothesis
    units = ("_deg", "_rad", "_mm", "_m")
    # A joint that follows others needs no column; its reading is in the unit of the model then.
    names = [
        f"q{i}_{robot.units[i - 1]}"
        if joint.coupling and not any(f"q{i}{unit}" in present for unit in units)
        else _column_present(present, f"q{i}", units)
        for i, joint in enumerate(robot.joints, 1)
    ]
    si = {"deg": np.pi / 180, "rad": 1.0, "mm": 1e-3, "m": 1.0}
    unit = [si[name.rsplit("_", 1)[1]] for name in names]
    columns: dict[str, Source] = {}
    for i, name in enumerate(names):
        if name not in present and h.source[i] == i:
            continue
        if names[h.source[i]] not in present:
            raise InputError(f"column {names[h.source[i]]} is missing; the repair cannot be written")
        made = source = present[names[h.source[i]]]
        factor = h.factor[i] * unit[h.source[i]] / unit[i]
        if factor != 1.0:
            source = _without_sum(source)
            made = Source(source.name, _round(factor * source.times), _round(factor * source.plus), {}, source.rows)
        columns[name] = replace(made, rows=made.rows + h.shift)
    scales = (1.0, 1.0, 1.0) if other_lengths(fit, robot) else fit.scale
    for c, scale in zip("xyz", scales, strict=True):
        if scale == 1.0 and not (c == "y" and fit.mirrored):
            continue
        name = _column_present(present, c, ("_mm", "_m"))
        source, sign = _without_sum(present[name]), -1.0 if c == "y" and fit.mirrored else 1.0
        times = sign * scale * source.times
        columns[name] = Source(source.name, _round(times), sign * scale * source.plus, {}, source.rows)
    return {name: made for name, made in columns.items() if made != present.get(name)}


def _round(value: float) -> float:
    """Return a number with ten significant digits."""
    return float(f"{value:.10g}")


def _column_present(present: Mapping[str, Source], stem: str, units: tuple[str, ...]) -> str:
    """Return the name of a column, stem and unit, that has a source, or raise InputError."""
    for unit in units:
        if stem + unit in present:
            return stem + unit
    raise InputError(f"column {stem} is missing; the repair cannot be written")


def _without_sum(source: Source) -> Source:
    """Return the source unchanged if it is no sum of columns. Raises InputError for a sum."""
    if source.add:
        raise InputError(f"column {source.name!r} is a sum already (columns in problem.toml); repair it by hand")
    return source


def write_repair(texts: Mapping[Path, str]) -> str:
    """Write repaired files and return the changed lines, for display. Raises InputError.

    They are as in a unified diff, without context and hunk headers.

    texts : path -> new text
    """
    lines: list[str] = []
    for path, text in texts.items():
        before = read_text(path).splitlines()
        lines += difflib.unified_diff(before, text.splitlines(), str(path), f"{path} repaired", n=0, lineterm="")
    write_together(texts)
    return "\n".join(line for line in lines if not line.startswith("@@"))


def repaired(found: Precheck) -> str:
    """Write the repair that a check has found; return the changed lines and a sentence.

    Only the first that applies is repaired: targets, their names, slips, inverse poses, joint
    readings. The text is empty where there is no repair. Raises InputError.
    """
    robot, slips, targets = found.nominal, found.slips, found.targets
    if targets and targets.which is not None and targets.points is not None and targets.rows is not None:
        rows = [targets.rows[targets.which == k] for k in range(targets.count)]
        shown = write_repair(files_with_targets(found.folder, targets.names, targets.points, rows))
        return f"{shown}\nrepaired: {targets.count} targets, named {', '.join(targets.names)}"
    if wrong := found.wrong_names:
        rows = [wrong.row[wrong.meant == k] for k in range(len(wrong.names))]
        shown = write_repair(file_with_names(found.folder, wrong.names, rows))
        return f"{shown}\nrepaired: {int((wrong.given != wrong.meant).sum())} rows name another target"
    if robot and slips and slips.explains:
        shown = write_repair(repaired_files(found.folder, slips.best, robot))
        meant = f"\nthe frame is mirrored: {MIRROR_WARNING}" if slips.best.mirrored else ""
        after = error_in_mm(slips.best, robot)
        return f"{shown}\nrepaired: {1e3 * slips.before.error:.4g} mm before, {after} after{meant}"
    if texts := _inverted_files(found):
        return f"{write_repair(texts)}\nrepaired: each pose is the inverse of the tool's, and the file says so now"
    if texts := _files_with_better_readings(found):
        firsts = ", ".join(repr(next(iter(better.values())).name) for better in found.readings.values())
        return f"{write_repair(texts)}\nrepaired: readings {firsts} and on are taken, which the robot fits better"
    return ""


def _files_with_better_readings(found: Precheck) -> dict[Path, str]:
    """Return path -> text of problem.toml with its tables' better joint readings; or {}."""
    if found.nominal is None or found.tables or not found.readings:
        return {}
    path = found.folder / "problem.toml"
    problem = tomlkit.parse(read_text(path))
    listed: Any = problem["measurements"]
    for table in listed:
        if better := found.readings.get(Path(str(table["file"])).name):
            joints = re.compile(r"q\d+_(deg|rad|mm|m)")
            present = _table_columns(found.folder, table, found.nominal)
            others = {ours: source for ours, source in present.items() if not joints.fullmatch(ours)}
            table["columns"] = _columns_table({**better, **others})
    return {path: tomlkit.dumps(problem)}


def _inverted_files(found: Precheck) -> dict[Path, str]:
    """Return path -> text of problem.toml with `inverted` where poses are and it lacks; or {}."""
    if found.nominal is None or found.tables:
        return {}
    path = found.folder / "problem.toml"
    problem = tomlkit.parse(read_text(path))
    inverted = {m.source for _, m in read_problem(found.folder).parts() if m.inverted}
    silent: Any = [t for t in problem["measurements"] if Path(str(t["file"])).name in inverted and "inverted" not in t]
    for table in silent:
        table["inverted"] = True
    return {path: tomlkit.dumps(problem)} if silent else {}


def not_repaired(found: Precheck) -> str:
    """Return why errors remain for which nothing was written; empty without errors."""
    if found.ok:
        return ""
    slips = found.slips
    if slips and not slips.explains:
        best, before = 1e3 * slips.best.error, 1e3 * slips.before.error
        return f"nothing more is written: of {before:.4g} mm the best explanation leaves {best:.4g} mm, which is none"
    topics = ", ".join(dict.fromkeys(f.topic for f in found.of_level("error")))
    return f"nothing more is written: --repair knows no remedy for these errors ({topics}); they say what to correct"


def files_with_targets(folder: Path, names: Sequence[str], points: Array, rows: Sequence[Array]) -> dict[Path, str]:
    """Return path -> text of problem.toml and robot file with several targets.

    For a URDF, problem.toml alone is changed.

    points : in the last link's frame, shape (K, 3) [m]
    rows : rows of the file at which each target was measured
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
    document["tool"] = _tools(names, points, robot_from(bare, place.name, folder=place.parent).tool.T, unknown)
    return {path: tomlkit.dumps(problem), place: tomlkit.dumps(document)}


def file_with_names(folder: Path, names: Sequence[str], rows: Sequence[Array]) -> dict[Path, str]:
    """Return path -> text of problem.toml with the rows at which each target was measured.

    names : of the targets; rows : rows of the first table's file, for each name
    """
    path = folder / "problem.toml"
    problem = tomlkit.parse(read_text(path))
    tables: Any = problem["measurements"]
    listed = tomlkit.table()
    for name, own in zip(names, rows, strict=True):
        listed.add(name, [int(row) for row in own])
    tables[0]["tools"] = listed
    return {path: tomlkit.dumps(problem)}


def _tools(names: Sequence[str], points: Array, flange: Array, unknown: str) -> Any:
    """Return the tables [[tool]] of these points, in TOML.

    points : in the last link's frame, shape (K, 3) [m]
    flange : pose in the last link of the frame in which the file gives its tool, shape (4, 4)
    """
    seen = (points - flange[:3, 3]) @ flange[:3, :3]
    tools = tomlkit.aot()
    for name, point in zip(names, seen, strict=True):
        tool = tomlkit.table()
        tool.update({"name": name, "xyz_mm": [round(1e3 * float(v), 1) for v in point], "unknown": unknown})
        tools.append(tool)
    return tools

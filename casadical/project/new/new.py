"""New problem folders: their files are composed, read on trial and then written.

Poses for a first run are simulated with the robot's own model, and marked as synthetic.
"""

import re
import tempfile
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from casadical.core.basics import Array, InputError, shown
from casadical.core.files import claimed, csv_text, write_together
from casadical.core.parts import lacks_masses, with_estimated_masses
from casadical.core.reading import read_bytes, read_text, text_fault
from casadical.core.reporting.blocks import Table, Words
from casadical.core.transforms import frame, from_rpy
from casadical.identification.pose_selection import Workspace
from casadical.identification.pose_selection.candidates import draw, expected, one_turn
from casadical.measurements.arrangement import joined, long, with_headings
from casadical.measurements.camera_noise import Camera
from casadical.measurements.columns import Columns, is_ours
from casadical.measurements.corners import INTRINSICS
from casadical.measurements.kinds.registry import kinds
from casadical.measurements.logs.systems import is_bag, stations_of_bag
from casadical.measurements.measurements import Measurements
from casadical.measurements.proposals import Question, Understanding
from casadical.measurements.raw_table import RawTable, read_table
from casadical.measurements.reading import from_columns
from casadical.project.faults import each_of
from casadical.project.new.dh_table import robot_text
from casadical.project.new.texts import EXAMPLE_ROBOT, Given, problem_text, readme_text, with_masses, with_measured
from casadical.project.problem import Problem, read_problem
from casadical.project.recognition import computed, understood
from casadical.project.robot_columns import as_poses, placed_by, poses_in_words, with_coupled
from casadical.robot.robot import Robot
from casadical.robot.robot_file import robot_from

# Number of poses that are simulated where a new folder has no measured ones.
SYNTHETIC_POSE_COUNT = 60
# Standard deviation of the noise of a simulated coordinate [m], as of a laser tracker.
SYNTHETIC_NOISE_M = 2e-5


def synthetic_poses(robot: Robot, seed: int = 0) -> str:
    """Return the text of a CSV table of simulated poses: readings and noisy positions [mm].

    The simulated robot departs from nominal (`as_built`).
    """
    rng = np.random.default_rng(seed)
    built = as_built(robot, rng)
    q = draw(one_turn(robot), SYNTHETIC_POSE_COUNT, Workspace(), rng)
    m = expected(built, q, {}, "synthetic")
    assert m.position is not None
    rows = zip(m.q, m.position + rng.normal(0.0, SYNTHETIC_NOISE_M, m.position.shape), strict=True)
    return csv_text([[*robot.reading_units, "x_mm", "y_mm", "z_mm"], *(reading_cells(robot, *row) for row in rows)])


def reading_cells(robot: Robot, q: Array, position: Array) -> list[str]:
    """Return a row of a table as texts.

    q : joint variables, shape (joints,) [rad or m], written as the controller's readings in the
        units of their columns
    position : shape (3,) [m], written in mm
    """
    readings = robot.readings_of(q[None])[0] / list(robot.reading_units.values())
    return [*(f"{v:.6f}" for v in readings), *(f"{v:.4f}" for v in 1e3 * position)]


def as_built(robot: Robot, rng: np.random.Generator) -> Robot:
    """Return a simulated real robot: random departures from nominal, and another base pose.

    An unknown base is moved by a fixed transform; rng : source of the departures
    """
    values, times = {}, {"geometry": 1, "loop": 1, "tool": 5}
    # One sigma by which the simulated robot departs from the nominal one, by unit of the parameter.
    synthetic_departure_sigma = {"m": 3e-4, "rad": 5e-4}
    for p in robot.parameters:
        if p.group in times:
            values[p.name] = p.value + times[p.group] * rng.normal(0.0, synthetic_departure_sigma[p.unit])
        elif p.group == "compliance":
            values[p.name] = p.value + rng.uniform(0.2, 0.5) * p.prior
    built = robot.with_values(values)
    if robot.base.unknown == "none":
        return built
    # Pose of the simulated base relative to the nominal one, where the base is unknown.
    synthetic_base = frame(from_rpy(np.deg2rad([0.5, -0.3, 30.0])), np.array([0.8, -0.4, 0.2]))
    return replace(built, base=replace(built.base, T=built.base.T @ synthetic_base))


def new_problem(
    folder: str | Path,
    *,
    urdf: Path | None = None,
    base_link: str | None = None,
    tip_link: str | None = None,
    dh: Path | None = None,
    convention: str = "modified",
    data: Path | Sequence[Path] | None = None,
    headings: str = "",
    camera: Camera = "",
    intrinsics: str = "",
    seed: int = 0,
    ask: Callable[[Question], str] | None = None,
    show: Callable[[Words | Table], None] | None = None,
    also: Callable[[Problem, list[Path]], Mapping[Path, str]] = lambda _problem, _files: {},
) -> Problem:
    """Write a problem folder that runs, and return it as it reads.

    folder : folder to write
    urdf, base_link, tip_link : URDF of the robot, and the ends of its chain
    dh, convention : table of DH rows and their convention (modified, standard); without URDF and
        table the robot is an example arm
    data : table of measured poses, or several that are joined; None: poses are simulated from the
        seed and marked synthetic everywhere
    headings : headings of the table, separated by commas, in place of its own or where it has none
    camera : where the camera is that measured them, "in hand" or "to base"; empty: as they look
    intrinsics : of that camera, four to nine numbers separated by commas (see `corners.INTRINSICS`)
    seed : seed of simulated poses and of the split
    ask : takes a question on the table and returns one of its choices; None: the first choice,
        which is the most probable
    show : called with what was understood of the table, before anything is asked
    also : returns further files, from the problem and the paths of its files; they appear with the
        folder or not at all

    Nothing is overwritten. Raises InputError: a file that is there already, or input that does not
    read.
    """
    folder, tables = Path(folder), [data] if isinstance(data, Path | str) else list(data or ())
    if urdf and dh:
        raise InputError("--urdf and --dh: both say which robot it is; give one of them")
    if tables and not (urdf or dh):
        raise InputError("--data needs the robot that was measured; give --urdf or --dh as well")
    name = folder.resolve().name
    if fault := text_fault(name):
        raise InputError(f"{shown(name)}: its name {fault}")
    steps: list[Callable[[], Any]] = [
        lambda: _robot_files(name, urdf, base_link, tip_link, dh, convention),
        lambda: _table(tables, headings) if tables else None,
    ]
    (texts, robot), given = each_of(steps)
    before = partial(_before_gripper, urdf, base_link, tip_link)
    lens = dict(zip(INTRINSICS, _numbers(intrinsics), strict=False))
    understood = _understood(given, robot, camera, lens, ask, show, before) if given else Given()
    if len(understood.tools) > 1 and show:
        place, listed = "problem.toml" if urdf else "robot.toml", ", ".join(understood.tools)
        show(Words(f"Column 'tool' names {len(understood.tools)} measured points, {listed}: {place} has each."))
    if "robot.toml" in texts:
        texts["robot.toml"] = with_measured(str(texts["robot.toml"]), understood)
    made = given is not None and bool(given.said)  # then the folder has the table as it was rearranged
    file = f"poses{tables[0].suffix.lower() if tables and tables[0].suffix and not made else '.csv'}"
    texts |= {
        file: given.frame.to_csv(index=False, lineterminator="\n")
        if made and given
        else read_bytes(tables[0])
        if tables
        else synthetic_poses(robot, seed),
        "problem.toml": problem_text(
            robot,
            understood if tables else None,
            links=(base_link, tip_link) if urdf else None,
            named_sets=given is not None and "set" in given.header,
            seed=seed,
            poses=SYNTHETIC_POSE_COUNT,
            file=file,
        ),
        "README.md": readme_text(
            name,
            robot.name,
            file,
            " and ".join(p.name for p in tables) or None,
            *(p.name if p else None for p in (urdf, dh)),
        ),
    }
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; name a folder")
    if taken := [file for file in texts if (folder / file).exists()]:
        raise InputError(f"{folder}: {', '.join(taken)} is there already; nothing was written: name another folder")
    with tempfile.TemporaryDirectory() as scratch:
        trial = Path(scratch) / name
        write_together({trial / name: text for name, text in texts.items()})
        try:
            problem = read_problem(trial)
        except InputError as error:  # which names the user's table, not its copy
            said = str(error).replace(f"{trial}/", "")
            said = said.replace(file, str(tables[0])) if tables and not made else said
            raise InputError(said) from None
    files = {folder / name: text for name, text in texts.items()}
    further = also(problem, sorted(files))
    with claimed([folder]):
        write_together({**files, **further})
    written = read_problem(folder)
    if show and (words := written.unnamed_targets):
        show(Words(words, "warning"))
    return written


def _table(paths: Sequence[Path], headings: str) -> RawTable:
    """Return the table in one or several files, with one position in each row.

    headings : names of the columns, separated by commas, of the only table or of the one without
        headings; empty: its own
    """
    tables = each_of(partial(stations_of_bag if is_bag(path) else read_table, path) for path in paths)
    for k, raw in enumerate(tables):
        if headings and (len(tables) == 1 or not raw.form.header_line):
            tables[k] = with_headings(raw, [name.strip() for name in headings.split(",")])
    return long(joined(tables))


def _before_gripper(urdf: Path | None, base_link: str | None, tip_link: str | None, joint: int) -> str:
    """Return how to end the arm before a joint, as a sentence; empty unless it is from a URDF.

    joint : number of the joint, from 1; other arguments are as of `new_problem`
    """
    if urdf is None or joint == 1:
        return ""
    from casadical.robot.urdf.reading import read_chain

    link = read_chain(urdf, base_link, tip_link).moving[joint - 1].parent
    return (
        f". If it is a gripper's, end the arm before it: --tip-link {link}; if it follows joints of the arm, as "
        "the wrist of a palletiser does, give it <mimic> in the URDF, or `follows` in a robot file of DH rows"
    )


def _refuse_missing(raw: RawTable, robot: Robot, found: Understanding, before: Callable[[int], str]) -> None:
    """Refuse a table in which the readings of some joints have columns, but not of all."""
    there = {m[1] for name in (*raw.header, *found.sources) if (m := re.match(r"q(\d+)_(deg|rad|mm|m)$", name))}
    free = [str(i) for i, joint in enumerate(robot.joints, 1) if joint.coupling is None]
    missing = [int(i) for i in free if i not in there]
    if missing and len(missing) < len(free):
        joint = robot.joints[missing[0] - 1]
        name = f" {joint.name!r}" * bool(joint.name) + (f", which {joint.leader[0]!r} drives" if joint.leader else "")
        more = f", nor of joint {', '.join(map(str, missing[1:]))}" if missing[1:] else ""
        raise InputError(
            f"{raw.path}: no column has the readings of joint {missing[0]}{name} ({joint.kind}){more}; "
            f"there are {', '.join(raw.header)}{before(missing[0]) if missing[0] > max(map(int, there)) else ''}"
        )


def _understood(
    raw: RawTable,
    robot: Robot,
    camera: Camera,
    lens: Mapping[str, float],
    ask: Callable[[Question], str] | None,
    show: Callable[[Words | Table], None] | None,
    before: Callable[[int], str],
) -> Given:
    """Return the interpretation of a table by which the files of the folder are written.

    Questions that it leaves open are asked by `ask` (None: the first choice is taken), and findings
    are shown by `show`.

    camera : where the camera is, empty if unknown; lens : its intrinsics, as named by INTRINSICS
    """
    meaning = understood(raw, robot, {})
    if show:
        for sentence in raw.said:
            show(Words(sentence))
        for block in shown_columns(raw, meaning):
            show(block)
    for question in meaning.questions:
        meaning = meaning.answered(question, ask(question) if ask else next(iter(question.choices)), "the answer")
    _refuse_missing(raw, robot, meaning, before)
    columns = Columns.of_file(raw).mapped(meaning.sources)
    columns = replace(columns, table=columns.table.assign(**lens))
    kind = next((kind for kind in kinds().values() if kind.matches({*map(str, columns.table)})), None)
    flags = columns.tools()
    order = sorted(flags, key=lambda name: -flags[name].sum())
    names = {name: name.removeprefix("tool_") for name in order}
    # The rows of a target with fewer poses are omitted: they do not determine its point.
    few = [name for name in order if flags[name].sum() < 3 and len(order) > 1]
    rare = {int(line): f"one of few of target {names[n]}" for n in few for line in columns.row[flags[n] > 0]}
    tools = tuple(names[name] for name in order if name not in few)
    left_out = {**rare, **dict.fromkeys(columns.lost_rows, "a cell is no number")}
    turned = kind is not None and kind.angles > 0
    tilt, said, poses = _tilt(columns.without(left_out, "the table"), robot, camera)
    # A base that is upright, on a wall or on a ceiling within this angle [deg] was measured by a
    # levelled instrument; with orientations (a camera looks sideways or down) upright alone counts.
    level = min(abs(tilt - upright) for upright in ((0,) if turned else (0, 90, 180))) < 3.0
    given = Given(
        columns=meaning.sources,
        left_out=left_out,
        tools=tools,
        kind=kind.name if kind else "",
        turned=turned,
        tilted=turned if np.isnan(tilt) else not level,
        inverted=poses is not None and poses.inverted,
        camera=poses.camera if poses is not None else camera,
        lens=lens,
    )
    rows = "; ".join(f"{row}, {why}" for row, why in left_out.items())
    said += [Words(f"Rows that are left out (leave_out in problem.toml): {rows}.")] if rows else []
    if turned:
        said.append(Words('The table has orientations: the tool\'s is identified, too (unknown = "pose").'))
    if given.tilted:
        where = "" if np.isnan(tilt) else f"The z axis of the instrument is {tilt:.0f} deg from that of the robot: "
        text = f'{where}the robot is taken to stand upright ([gravity] frame = "base").'
        said.append(Words(text[0].upper() + text[1:]))
    if show:
        for words in said:
            show(words)
    return given


def _numbers(text: str) -> list[float]:
    """Return the four to nine numbers of --intrinsics, [] without. Raises InputError for others."""
    try:
        numbers = [float(number) for number in text.split(",")] if text else []
    except ValueError:
        numbers = [0.0]
    if text and not (4 <= len(numbers) <= len(INTRINSICS) and min(numbers[:2]) > 0 and np.isfinite(numbers).all()):
        raise InputError(
            f"--intrinsics {text}: allowed: FX,FY,CX,CY in pixels, the first two positive, and up to five coefficients "
            "K1,K2,P1,P2,K3"
        )
    return numbers


def _tilt(columns: Columns, robot: Robot, camera: Camera) -> tuple[float, list[Words], Measurements | None]:
    """Return the angle [deg] between the z axes of base and measuring frame, findings, and poses.

    The angle is NaN where the data do not show it; the poses are None where they cannot be read.
    """
    try:
        m = from_columns(with_coupled(columns, robot), [j.kind for j in robot.joints])
        m = as_poses(m, robot, camera=camera)
        placed, median = placed_by(robot, m)
    except (InputError, np.linalg.LinAlgError):
        return np.nan, [], None
    doubt = "The positions are the nominal robot's own, to the last digit: they are computed, not measured."
    fits = median < 0.02 * robot.reach  # else tilt and place of a camera are unknown
    tilt = float(np.rad2deg(np.arccos(np.clip(placed.base.T[2, 2], -1, 1)))) if fits else np.nan
    said = [Words(doubt, "warning")] if computed(robot, m) else []
    if words := poses_in_words(m):
        far = "" if fits else ": is it this robot, and is the --convention of a DH table right?"
        said.append(Words(f"{words[:-1]} (the nominal robot is {1e3 * median:.3g} mm off, median{far})."))
    return tilt, said, m


def shown_columns(raw: RawTable, found: Understanding) -> list[Words | Table]:
    """Return a table of the meaning of each column, and a note on unused columns.

    found : meaning of the columns; open questions are marked
    """
    frame, first = raw.frame, [c for q in found.questions for c in next(iter(q.choices.values()))]
    made = {name: c for c in (*found.columns, *first) for name in (c.source.name, *c.source.add)}
    columns = Columns.of_file(raw).mapped(found.sources)
    kind = next((kind for kind in kinds().values() if kind.matches({*map(str, columns.table)})), None)
    rows, unused = [], []
    for name in raw.header:
        if c := made.get(name):
            why = "to be asked" if c in first else f"from {c.why}"
            rows.append((c.ours, name, c.unit, _cell(frame[name].iloc[0]), why))
        elif is_ours(name, kind.pattern if kind else ""):
            rows.append((name, name, "", _cell(frame[name].iloc[0]), "from its name"))
        elif name:
            unused.append(name)
    # Of the entries of a rotation matrix, the first stands for all.
    rows = [row for row in rows if row[0] == "R00" or not re.fullmatch("R[012]{2}", row[0])]
    rows = [("R00 ...", *row[1:]) if row[0] == "R00" else row for row in rows]
    title = f"{raw.path.name}: {raw.form.words}{f'; kind {kind.name}' if kind else ''}"
    table = Table(title, ("casadical", "file", "unit", "first row", "known"), rows)
    return [table, *([Words(f"Not used: {', '.join(unused)}.", "note")] if unused else [])]


def _cell(value: object) -> str:
    """Return the text of a cell, numbers with nine digits."""
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _robot_files(
    name: str, urdf: Path | None, base_link: str | None, tip_link: str | None, dh: Path | None, convention: str
) -> tuple[dict[str, str | bytes], Robot]:
    """Return file name -> content of the robot's file, and the robot. Raises InputError.

    Arguments are as of `new_problem`; missing masses are estimated in robot.toml.
    """
    if urdf:
        from casadical.robot.urdf import read_urdf

        return {"robot.urdf": read_text(urdf)}, read_urdf(urdf, base_link, tip_link)
    text = robot_text(dh, name, convention) if dh else EXAMPLE_ROBOT
    robot = robot_from(tomllib.loads(text), dh.name if dh else "robot.toml")
    if lacks_masses(robot):
        robot = with_estimated_masses(robot)
        text = with_masses(text, robot, 'convention = "standard"' in text)
    return {"robot.toml": text}, robot

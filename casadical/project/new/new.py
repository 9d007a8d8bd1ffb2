"""Compose the files of a new problem, check that they can be read, and then write them."""

import tempfile
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from casadical.core.errors import InputError
from casadical.core.estimated_masses import with_estimated_masses, without_masses
from casadical.core.files import claimed, write_together
from casadical.core.reading import read_bytes, read_text
from casadical.core.telling.blocks import Table, Words
from casadical.measurements.column_map import Source
from casadical.measurements.columns import Columns
from casadical.measurements.headings import Question, Understanding, understand
from casadical.measurements.raw_table import RawTable, read_table
from casadical.project.check.targets import unnamed_targets
from casadical.project.new.dh_table import robot_text
from casadical.project.new.synthetic import POSES, synthetic_poses
from casadical.project.new.texts import EXAMPLE_ROBOT, column_lines, problem_text, readme_text, with_masses, with_tools
from casadical.project.problem import Problem, read_problem
from casadical.robot.robot import Robot
from casadical.robot.robot_file import robot_from

# A target that is measured at fewer poses is left out.
FEWEST = 3


def new_problem(
    folder: str | Path,
    *,
    urdf: Path | None = None,
    base_link: str | None = None,
    tip_link: str | None = None,
    dh: Path | None = None,
    convention: str = "modified",
    data: Path | None = None,
    seed: int = 0,
    ask: Callable[[Question], str] | None = None,
    show: Callable[[Words | Table], None] | None = None,
    also: Callable[[Problem, list[Path]], Mapping[Path, str]] = lambda _problem, _files: {},
) -> Problem:
    """Write a problem folder that runs, and give it back as it reads.

    urdf, base_link, tip_link : the robot from a URDF; dh, convention : from a table of DH rows (modified, standard);
        neither: an example arm
    data : measured poses; None: poses that the model itself makes up from the seed, marked synthetic everywhere
    ask : takes a question on the table and gives one of its choices; None: the first choice, which is the most probable
    show : takes what was understood of the table, before anything is asked
    also : further files that appear with the folder or not at all, from the problem and the paths of its files
    Nothing is overwritten. Raises InputError: a file that is there already, or input that does not read.
    """
    folder = Path(folder)
    if urdf and dh:
        raise InputError("--urdf and --dh: both say which robot it is; give one of them")
    if data and not (urdf or dh):
        raise InputError("--data needs the robot that was measured; give --urdf or --dh as well")
    name = folder.resolve().name
    texts, robot = _robot_files(name, urdf, base_link, tip_link, dh, convention)
    given = read_table(data) if data else None
    place = "problem.toml" if urdf else "robot.toml"
    columns, left_out, tools = _understood(given, robot, place, ask, show) if given else ({}, {}, ())
    if len(tools) > 1 and "robot.toml" in texts:
        texts["robot.toml"] = with_tools(str(texts["robot.toml"]), tools)
    compliant = any(j.compliance is not None for j in robot.joints)
    links = (base_link, tip_link) if urdf else None
    sets = given is not None and "set" in given.header
    file = f"poses{data.suffix.lower() if data and data.suffix else '.csv'}"
    lines = column_lines(columns, left_out)
    texts |= {
        file: read_bytes(data) if data else synthetic_poses(robot, seed),
        "problem.toml": problem_text(robot.name, bool(data), links, compliant, sets, seed, POSES, file, lines, tools),
        "README.md": readme_text(name, robot.name, file, *(p.name if p else None for p in (data, urdf, dh))),
    }
    _refuse_taken(folder, texts)
    with tempfile.TemporaryDirectory() as scratch:
        trial = Path(scratch) / name
        write_together({trial / name: text for name, text in texts.items()})
        problem = _read_on_trial(trial, data, file)
    files = {folder / name: text for name, text in texts.items()}
    further = also(problem, sorted(files))
    with claimed([folder]):
        write_together({**files, **further})
    made = read_problem(folder)
    if show and (words := unnamed_targets(made)):
        show(Words(words, "warning"))
    return made


def _understood(
    given: RawTable,
    robot: Robot,
    place: str,
    ask: Callable[[Question], str] | None,
    show: Callable[[Words | Table], None] | None,
) -> tuple[dict[str, Source], dict[int, str], tuple[str, ...]]:
    """The table's columns, rows to be left out with the reason of each, and the names of the measured points.

    place : the file that has these points
    """
    understood = understand(given, [j.kind for j in robot.joints])
    if show and understood.columns:
        show(table_of(given, understood))
    columns = understood.sources
    tools, rare = tools_in(given, columns)
    if len(tools) > 1 and show:
        show(Words(f"Column 'tool' names {len(tools)} measured points, {', '.join(tools)}: {place} has each."))
    for question in understood.questions:
        columns = _answered(columns, question, ask)
    lost = Columns.of_file(given).mapped(columns).lost_rows
    left_out = {**rare, **dict.fromkeys(lost, "a cell is no number")}
    if left_out and show:
        rows = "; ".join(f"{row}, {why}" for row, why in left_out.items())
        show(Words(f"Rows that are left out (leave_out in problem.toml): {rows}."))
    return columns, left_out, tools


def _answered(
    columns: dict[str, Source], question: Question, ask: Callable[[Question], str] | None
) -> dict[str, Source]:
    """The columns with one answer; a unit that an answer changes is another name of the same column."""
    answer = question.choices[ask(question) if ask else next(iter(question.choices))]
    stems = {name.rpartition("_")[0] or name: name for name in columns}
    if all(name in stems for name in answer):  # which columns, their units as they were
        return {**columns, **{stems[name]: replace(columns[stems[name]], name=s.name) for name, s in answer.items()}}
    taken = {name.rpartition("_")[0] for name in answer}
    return {**{name: s for name, s in columns.items() if name.rpartition("_")[0] not in taken}, **answer}


def tools_in(raw: RawTable, columns: Mapping[str, Source]) -> tuple[tuple[str, ...], dict[int, str]]:
    """Names in the column that says which point on the flange was measured, the one measured most first.

    Of those measured at fewer poses than tell where they are, the rows, each with the reason to leave it out.
    """
    table = Columns.of_file(raw).mapped({n: s for n, s in columns.items() if n == "tool"})
    found = table.tools()
    order = sorted(found, key=lambda name: -found[name].sum())
    names = {name: name.removeprefix("tool_") for name in order}
    few = [name for name in order if found[name].sum() < FEWEST and len(order) > 1]
    rare = {int(row): f"one of few of target {names[n]}" for n in few for row in table.row[found[n] > 0]}
    return tuple(names[name] for name in order if name not in few), rare


def table_of(raw: RawTable, found: Understanding) -> Table:
    """What was understood of a table, for the terminal."""
    frame = raw.frame()
    rows = [(c.ours, c.source.name, c.unit, f"{frame[c.source.name].iloc[0]}", f"from {c.why}") for c in found.columns]
    rows += [("not used", name, "", "", "") for name in found.left]
    return Table(f"{raw.path.name}: {raw.form.words}", ("casadical", "file", "unit", "first row", "known"), rows)


def _robot_files(
    name: str, urdf: Path | None, base_link: str | None, tip_link: str | None, dh: Path | None, convention: str
) -> tuple[dict[str, str | bytes], Robot]:
    if urdf:
        from casadical.robot.urdf import read_urdf

        return {"robot.urdf": read_text(urdf)}, read_urdf(urdf, base_link, tip_link)
    text = robot_text(dh, name, convention) if dh else EXAMPLE_ROBOT
    robot = robot_from(tomllib.loads(text), dh.name if dh else "robot.toml")
    if without_masses(robot):
        robot = with_estimated_masses(robot)
        text = with_masses(text, robot, convention == "standard")
    return {"robot.toml": text}, robot


def _read_on_trial(folder: Path, data: Path | None, file: str) -> Problem:
    """Refuse what would not read, by the name of the file that the user gave."""
    try:
        return read_problem(folder)
    except InputError as error:
        text = str(error).replace(f"{folder}/", "")
        raise InputError(text.replace(file, str(data)) if data else text) from None


def _refuse_taken(folder: Path, texts: Mapping[str, str | bytes]) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; name a folder")
    taken = [file for file in texts if (folder / file).exists()]
    if taken:
        raise InputError(f"{folder}: {', '.join(taken)} is there already; nothing was written: name another folder")

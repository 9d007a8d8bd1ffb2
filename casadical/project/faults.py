"""All faults of all files that a command was given: after the first error the others are read."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np

from casadical.core.basics import FaultsError, InputError, all_faults
from casadical.core.reading import load_toml
from casadical.core.schema import check
from casadical.identification.plausibility import check_against
from casadical.measurements.arrangement import long
from casadical.measurements.columns import Columns, columns_used
from casadical.measurements.kinds.registry import kinds
from casadical.measurements.logs.reading import is_log
from casadical.measurements.proposals import understand
from casadical.measurements.raw_table import read_table
from casadical.measurements.reading import from_columns
from casadical.project.problem_file import DataTable, ProblemFile, UrdfTable, robot_of_file, table_like, tables_of
from casadical.project.recognition import understood
from casadical.project.robot_columns import with_coupled
from casadical.robot.robot import Robot

Given = ParamSpec("Given")
Read = TypeVar("Read")


def every_fault(error: InputError, paths: Iterable[Path], *, later: bool = False) -> InputError:
    """Return the error at which a command ended, joined with those of all other given files.

    paths : problem folders, robot files and tables; joint logs, and tables that take long to read,
        are not checked
    later : whether rows with a cell that is no number are removed from given tables, and a folder's
        own tables are checked even if tables were given
    """
    errors, given = [error], list(paths)
    # Files with these endings are tables; all others are robot files or problem folders.
    table_suffixes = (".csv", ".txt", ".tsv", ".xlsx", ".parquet", ".gz")
    tables = [path for path in given if path.suffix.lower() in table_suffixes and not is_log(path)]
    robot: Robot | None = None
    joints: list[str] = []
    source = next((path for path in given if path.suffix.lower() not in table_suffixes), Path())
    for path in given:
        if (path / "problem.toml").is_file():
            file = _tried(errors, _problem_file, path, errors) or ProblemFile(casadical=1, title="")
            place, urdf = path / file.robot, file.urdf or UrdfTable()
            own = _robot(errors, place, urdf)
            for data in () if tables and not later else file.measurements:  # given ones replace them
                _tried(errors, _check_table, path / data.file, data, *own, False)
        elif path.suffix.lower() not in table_suffixes and path.is_file() and _is_robot(path):
            own = _robot(errors, path, UrdfTable())
        else:
            continue
        robot, joints = (robot, joints) if joints else own
    for path in tables:
        _tried(errors, _check_given_table, source, path, robot, joints, later)
    return FaultsError.joined(errors)


def each_of(steps: Iterable[Callable[[], Read]]) -> list[Read]:
    """Return the results of several steps, in order.

    All steps are executed; raises InputError with the errors of all that failed, joined.
    """
    given: list[Read] = []

    def take(step: Callable[[], Read]) -> None:
        given.append(step())

    all_faults(partial(take, step) for step in steps)
    return given


def _tried(
    errors: list[InputError], step: Callable[Given, Read], *given: Given.args, **named: Given.kwargs
) -> Read | None:
    """Return the result of `step(*given, **named)`; None if it raised an InputError.

    errors : list to which the error is added
    """
    try:
        return step(*given, **named)
    except InputError as error:
        errors.append(error)
        return None


def _problem_file(folder: Path, errors: list[InputError]) -> ProblemFile:
    """Return the contents of a folder's problem.toml without its invalid keys.

    The faults of these keys are added to `errors`.
    """
    path = folder / "problem.toml"
    data = load_toml(path)
    _tried(errors, check, ProblemFile, data, str(path))
    tables = data.get("measurements")
    good = {key: value for key, value in data.items() if _holds({key: value})}
    if isinstance(tables, list) and "measurements" not in good:
        some = [t for t in tables if isinstance(t, Mapping)]
        named = [t if _holds({"measurements": [t]}) else {"file": t.get("file")} for t in some]
        good["measurements"] = [t for t in named if _holds({"measurements": [t]})]
    return check(ProblemFile, {"casadical": 1, "title": "", **good}, str(path))


def _holds(some: Mapping[str, Any]) -> bool:
    """Return whether these keys of a problem.toml are valid."""
    return _tried([], check, ProblemFile, {"casadical": 1, "title": "", **some}, "") is not None


def _is_robot(path: Path) -> bool:
    """Return whether a file is a robot file (also one that cannot be parsed) or a URDF."""
    if path.suffix != ".toml":
        return path.suffix == ".urdf"
    try:
        return "joint" in load_toml(path)
    except InputError:
        return True


def _robot(errors: list[InputError], path: Path, urdf: UrdfTable) -> tuple[Robot | None, list[str]]:
    """Return a robot and the kinds of its joints; None and the declared kinds for an unusable file.

    errors : list to which the file's errors are added; urdf : [urdf] of problem.toml
    """
    robot = _tried(errors, robot_of_file, path, urdf)
    if robot is not None:
        return robot, [j.kind for j in robot.joints]
    try:
        joints = load_toml(path).get("joint", []) if path.suffix == ".toml" else []
        return None, [str(j.get("type", "revolute")) for j in joints]
    except (InputError, AttributeError):
        return None, []


def _check_given_table(source: Path, table: Path, robot: Robot | None, joints: Sequence[str], later: bool) -> None:
    """Check a given table, interpreted as those of its problem are. Raises InputError.

    source : problem folder or robot file; robot : None where it cannot be read
    joints : kind of each joint; later : whether rows with a cell that is no number are omitted
    """
    raw = read_table(table, keep_text=False)
    try:
        data = table_like(source, raw, tables_of(source))
    except InputError:
        data = DataTable(file=table.name)
    _check_table(table, data, robot, joints, later)


def _check_table(path: Path, data: DataTable, robot: Robot | None, joints: Sequence[str], later: bool) -> None:
    """Check cells of a table of up to 4 MB and, with a robot, ranges of joints. Raises InputError.

    data : its [[measurements]]; joints : kind of each joint
    later : whether rows with a cell that is no number are omitted
    """
    if path.is_file() and path.stat().st_size > 4_000_000:  # bytes; reading it again takes too long
        return
    raw = read_table(path, keep_text=False)
    of_file = [j if j in ("revolute", "prismatic") else "revolute" for j in joints]
    if robot is None and not of_file:
        return
    raw = long(raw, [name for name, _ in columns_used(data.sources)])
    meaning = understood(raw, robot, data.sources, data.kind) if robot else understand(raw, of_file, data.sources)
    columns = Columns.of_file(raw).mapped({**meaning.sources, **data.sources}, data.point_from)
    columns = columns.without(data.leave_out, "leave_out")
    columns = with_coupled(columns, robot) if robot else columns
    whole = columns.without(columns.lost_rows, "the table")
    observations = "|".join(k.pattern for k in kinds().values())
    steps = [partial((whole if later else columns).refuse_faults, of_file, observations)]
    if robot is not None and not meaning.questions:
        steps.append(partial(_check_ranges, robot, whole, data.kind))
    all_faults(steps)


def _check_ranges(robot: Robot, columns: Columns, kind: str | None) -> None:
    """Check joint limits and payloads; other errors are passed over. Raises FaultsError."""
    try:
        check_against(robot, from_columns(columns, [j.kind for j in robot.joints], kind))
    except FaultsError:
        raise
    except (InputError, np.linalg.LinAlgError):
        return

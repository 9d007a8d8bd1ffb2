"""All faults of all files that a command was given: where one ends it, the others are read, too, each by itself."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np

from casadical.core.basics import FaultsError, InputError, all_faults
from casadical.core.reading import load_toml
from casadical.core.schema import check
from casadical.identification.plausibility import check_against
from casadical.measurements.columns import Columns
from casadical.measurements.headings import understand
from casadical.measurements.kinds.registry import kinds
from casadical.measurements.logs.reading import is_log
from casadical.measurements.raw_table import read_table
from casadical.measurements.reading import from_columns
from casadical.project.problem_file import DataTable, ProblemFile, UrdfTable, robot_of_file, table_like, tables_of
from casadical.project.robot_columns import understood
from casadical.robot.robot import Robot

TABLES = (".csv", ".txt", ".tsv", ".xlsx", ".parquet", ".gz")

Given = ParamSpec("Given")
Read = TypeVar("Read")


def every_fault(error: InputError, paths: Iterable[Path], *, later: bool = False) -> InputError:
    """The error at which a command ended, together with those of all other files that it was given.

    paths : problem folders, robot files and tables; not joint logs, nor tables that take long to read
    later : whether rows with a cell that is no number are left out of tables
    """
    collected, given = _Collected([error]), list(paths)
    tables = [path for path in given if path.suffix.lower() in TABLES and not is_log(path)]
    robot: Robot | None = None
    joints: list[str] = []
    source = next((path for path in given if path.suffix.lower() not in TABLES), Path())
    for path in given:
        if (path / "problem.toml").is_file():
            file = collected.tried(_problem_file, path, collected) or ProblemFile(casadical=1, title="")
            place, urdf = path / file.robot, file.urdf or UrdfTable()
            own = _robot(collected, place, urdf)
            for data in () if tables and not later else file.measurements:  # others are given in their place
                collected.tried(_read, path / data.file, data, *own, False)
        elif path.suffix.lower() not in TABLES and path.is_file() and _is_robot(path):
            own = _robot(collected, path, UrdfTable())
        else:
            continue
        robot, joints = (robot, joints) if joints else own
    for path in tables:
        collected.tried(_beside, source, path, robot, joints, later)
    return FaultsError.joined(collected.errors)


def each_of(steps: Iterable[Callable[[], Read]]) -> list[Read]:
    """What several steps give; their errors are raised together. Raises InputError."""
    given: list[Read] = []

    def take(step: Callable[[], Read]) -> None:
        given.append(step())

    all_faults(partial(take, step) for step in steps)
    return given


@dataclass
class _Collected:
    errors: list[InputError] = field(default_factory=list)

    def tried(self, step: Callable[Given, Read], *given: Given.args, **named: Given.kwargs) -> Read | None:
        """What a step gives; None where an error of it is kept."""
        try:
            return step(*given, **named)
        except InputError as error:
            self.errors.append(error)
            return None


def _problem_file(folder: Path, found: _Collected) -> ProblemFile:
    """A problem.toml, without those of its keys that are not usable; their faults are kept."""
    path = folder / "problem.toml"
    data = load_toml(path)
    found.tried(check, ProblemFile, data, str(path))
    tables = data.get("measurements")
    good = {key: value for key, value in data.items() if _holds({key: value})}
    if isinstance(tables, list) and "measurements" not in good:
        some = [t for t in tables if isinstance(t, Mapping)]
        named = [t if _holds({"measurements": [t]}) else {"file": t.get("file")} for t in some]
        good["measurements"] = [t for t in named if _holds({"measurements": [t]})]
    return check(ProblemFile, {"casadical": 1, "title": "", **good}, str(path))


def _holds(some: Mapping[str, Any]) -> bool:
    return _Collected().tried(check, ProblemFile, {"casadical": 1, "title": "", **some}, "") is not None


def _is_robot(path: Path) -> bool:
    if path.suffix != ".toml":
        return path.suffix == ".urdf"
    try:
        return "joint" in load_toml(path)
    except InputError:
        return True


def _robot(found: _Collected, path: Path, urdf: UrdfTable) -> tuple[Robot | None, list[str]]:
    """A robot and the kinds of its joints; of a file that is not usable, the latter as far as it tells them."""
    robot = found.tried(robot_of_file, path, urdf)
    if robot is not None:
        return robot, [j.kind for j in robot.joints]
    try:
        joints = load_toml(path).get("joint", []) if path.suffix == ".toml" else []
        return None, [str(j.get("type", "revolute")) for j in joints]
    except (InputError, AttributeError):
        return None, []


def _beside(source: Path, table: Path, robot: Robot | None, joints: Sequence[str], later: bool) -> None:
    """As `_read`, of a table that is understood as those of a problem or robot file are."""
    raw = read_table(table, keep_text=False)
    try:
        data = table_like(source, raw, tables_of(source))
    except InputError:
        data = DataTable(file=table.name)
    _read(table, data, robot, joints, later)


def _read(path: Path, data: DataTable, robot: Robot | None, joints: Sequence[str], later: bool) -> None:
    """Raises InputError for what is wrong with a table; without a robot, for cells alone."""
    if path.is_file() and path.stat().st_size > 4_000_000:
        return
    raw = read_table(path, keep_text=False)
    of_file = [j if j in ("revolute", "prismatic") else "revolute" for j in joints]
    if robot is None and not of_file:
        return
    meaning = understood(raw, robot, data.sources, data.kind) if robot else understand(raw, of_file, data.sources)
    columns = Columns.of_file(raw).mapped({**meaning.sources, **data.sources}, data.point_from)
    columns = columns.without(data.leave_out, "leave_out")
    whole = columns.without(columns.lost_rows, "the table")
    observations = "|".join(k.pattern for k in kinds().values())
    steps = [partial((whole if later else columns).refuse_faults, of_file, observations)]
    if robot is not None and not meaning.questions:
        steps.append(partial(_refuse_ranges, robot, whole, data.kind))
    all_faults(steps)


def _refuse_ranges(robot: Robot, columns: Columns, kind: str | None) -> None:
    """Raises FaultsError for readings beyond the limits; what else no robot measures is a matter of the command."""
    try:
        check_against(robot, from_columns(columns, [j.kind for j in robot.joints], kind))
    except FaultsError:
        raise
    except (InputError, np.linalg.LinAlgError):
        return

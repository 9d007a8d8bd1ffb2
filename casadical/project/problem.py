"""A problem: a robot and its measurements, split into sets, read from a folder and checked."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
import pandas as pd

from casadical.core.basics import InputError, shown
from casadical.core.parts import GRAVITY_COLUMNS
from casadical.core.reporting.result import Shown
from casadical.identification.plausibility import refuse_undefined
from casadical.identification.prior import Prior, carry_over
from casadical.identification.residuals import AnyLoss
from casadical.measurements.arrangement import long
from casadical.measurements.columns import Columns, columns_used
from casadical.measurements.derived_columns import derive
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import SETS, TARGET_PREFIX, Measurements, without_poses
from casadical.measurements.raw_table import RawTable, read_table
from casadical.measurements.reading import from_columns, readings_alone, refuse_open, refuse_shared_rows
from casadical.project.faults import each_of, every_fault
from casadical.project.problem_file import (
    BaseMethod,
    CameraErrorsTable,
    DataTable,
    Paper,
    ProblemFile,
    SetsTable,
    UrdfTable,
    base_methods,
    file_with_tables,
    problem_file,
    robot_of_file,
    table_like,
    tables_of,
)
from casadical.project.recognition import understood
from casadical.project.robot_columns import as_poses, refuse_nameless, some_rows, with_coupled, with_target_positions
from casadical.project.targets import recognised
from casadical.robot.robot import Robot
from casadical.robot.robot_file import read_robot

if TYPE_CHECKING:
    from casadical.identification.result import Identification, LeftOut

# Function that takes the results of another campaign over into a robot, and returns that robot and
# the prior of the values (None without one).
Carried = Callable[[Robot], tuple[Robot, Prior | None]]


def nothing_carried(robot: Robot) -> tuple[Robot, Prior | None]:
    """Return the robot unchanged and no prior: the default of `Carried`."""
    return robot, None


def carried_from(path: Path, parts: Sequence[str], frozen: bool) -> Carried:
    """Return a function that takes parts of a robot file over into a robot (see `carry_over`)."""
    other = read_robot(path)
    return lambda robot: carry_over(robot, other, parts, frozen=frozen)


@dataclass(frozen=True, eq=False)
class Problem(Shown):
    """A robot and its measurements, split into named sets (identify, train, choose, report).

    folder : problem folder, or robot file, that it was read from
    title : title of reports
    data : whether the measurements are real or synthetic; None where it is not stated
    robot : nominal robot
    sets : measurements by set name, one `Measurements` for each table; no pose is in two sets
    methods : identification methods of `casadical calibrate`
    loss : name of the loss of the residuals in `casadical calibrate`
    geometry_prior : whether the geometry has a prior where the poses leave it open (see `identify`)
    urdf : file, base link and tip link where the robot is from a URDF
    networks : network methods that are trained on the residual of SKCM
    seed : seed of the split and of the networks
    paper : published figures and their source
    prior : prior from another campaign, where one is used
    set_column : column that names each pose's set; None where the split is drawn at random
    tables : how each table is interpreted (see `DataTable.interpretation`)
    robot_file : file that the robot was read from
    whole : all poses of each table, to which the written robots are fitted; () where these are of
        `identify`

    Examples
    --------
    >>> problem = casadical.read_problem("problems/planar")
    >>> problem.title
    'Planar arm of two links, to be read in five minutes'
    >>> [name for name, m in problem.parts()]
    ['identify', 'report']
    >>> try:
    ...     problem.calibrated_urdf(found.robot)
    ... except casadical.InputError as error:
    ...     print(str(error)[:60])
    problems/planar: its robot is not from a URDF; write its rob
    """

    line: ClassVar[str] = (
        " {{ it.folder.name }}: {{ it.robot.name }}; "
        "{% for name, m in it.parts() %}{{ name }} {{ m | length }}{{ '' if loop.last else ', ' }}{% endfor %}"
        " poses; {{ (it.methods | list + it.networks | list) | join(', ') }}"
    )

    folder: Path
    title: str
    data: Literal["real", "synthetic"] | None
    robot: Robot
    sets: Mapping[str, tuple[Measurements, ...]]
    methods: tuple[BaseMethod, ...]
    loss: AnyLoss
    urdf: tuple[Path, str | None, str | None] | None = None
    networks: tuple[str, ...] = ()
    seed: int = 0
    paper: Paper | None = None
    prior: Prior | None = None
    set_column: str | None = None
    tables: tuple[Mapping[str, Any], ...] = ()
    robot_file: Path = Path("robot.toml")
    whole: tuple[Measurements, ...] = ()
    geometry_prior: bool = True

    @property
    def origin(self) -> str:
        """Return the origin of the data, in words."""
        return f"{self.data} data" if self.data else "data of unstated origin"

    def parts(self) -> Iterator[tuple[str, Measurements]]:
        """Yield the name and the measurements of every table's part in every set.

        The name is SET; of several tables SET/KIND, and of several tables of one kind
        SET/KIND/FILE, with " (1)", " (2)" and so on where two would be the same.
        """
        for name, parts in self.sets.items():
            names = [name]
            if len(parts) > 1:
                alike = Counter(m.kind for m in parts)
                files = (f"/{Path(m.source).name}" if alike[m.kind] > 1 else "" for m in parts)
                names = [f"{name}/{m.kind}{file}" for m, file in zip(parts, files, strict=True)]
            for k, (each, m) in enumerate(zip(names, parts, strict=True)):
                yield each if names.count(each) == 1 else f"{each} ({names[: k + 1].count(each)})", m

    @cached_property
    def table(self) -> Measurements | None:
        """Return all poses of the only table in the order of its rows, as kind position.

        Measured orientations are included. None where there are several tables, or the kind has
        no positions.
        """
        parts = [part for _, part in self.parts()]
        first = parts[0]
        if any(part.source != first.source or part.position is None for part in parts):
            return None
        row = np.concatenate([part.row for part in parts])
        order = np.argsort(row)
        names = set.intersection(*(set(part.conditions) for part in parts))
        turns = [part.orientation for part in parts if part.orientation is not None]
        return replace(
            first.positions_alone()[np.zeros(len(row), dtype=np.int64)],
            q=np.concatenate([part.q for part in parts])[order],
            position=np.concatenate([part.position for part in parts if part.position is not None])[order],
            conditions={n: np.concatenate([part.conditions[n] for part in parts])[order] for n in sorted(names)},
            row=row[order],
            orientation=np.concatenate(turns)[order] if len(turns) == len(parts) else None,
        )

    @cached_property
    def unnamed_targets(self) -> str:
        """Return a sentence on several targets that the only table measured but does not name.

        It states the remedy; it is empty where there are none.
        """
        found = recognised(self.robot, self.table) if self.table is not None else None
        if self.table is None or not found or not found.turning:
            return ""
        return f"{found.in_words(self.table.source)}; casadical check {self.folder} --repair writes them"

    @property
    def unmeasured_targets(self) -> list[str]:
        """Return the targets of the robot file that no row names."""
        seen = {name for _, m in self.parts() for name in m.target_names}
        return [n for n in (self.robot.tool_name, *(t.name for t in self.robot.targets)) if n and n not in seen]

    @property
    def unfitted(self) -> list[str]:
        """Return a sentence for each target or session that the set identify lacks, with a remedy.

        No fitted pose then determines its point, or its base and tool.
        """
        used = self.sets.get("identify", ())
        fitted = {name for m in used for name in m.target_names if m.conditions[TARGET_PREFIX + name].any()}
        faults = []
        for name, parts in self.sets.items():
            for m in parts:
                for target in m.target_names:
                    rows = m.row[m.conditions[TARGET_PREFIX + target] > 0]
                    if target not in fitted and len(rows):
                        listed = some_rows(rows.tolist())
                        faults.append(
                            f"{m.source}: target {target!r} was measured in row {listed} only, of "
                            f"the set {name!r}; no pose that is fitted tells where it is: measure "
                            "it at three poses or more, or leave the rows out (leave_out = "
                            f"[{listed}] in problem.toml)"
                        )
        inside = {session for m in used for session in m.session_names}
        for name, parts in self.sets.items():
            for session in sorted({session for m in parts for session in m.session_names} - inside):
                faults.append(
                    f"session {session!r} has poses of the set {name!r} only; none that is fitted "
                    "tells where its base and tool are: put some of them into the set 'identify'"
                )
        return faults

    def used_poses(self, results: Mapping[str, "Identification"]) -> dict[str, Measurements]:
        """Return set, named as in `parts`, -> its measurements without outliers.

        In fitted sets they are the outliers of all methods, in the others those of the last method.

        results : identifications by method
        """
        inliers = iter(without_poses(self.sets["identify"], {p for r in results.values() for p in r.outliers}))
        fitted = {name: next(inliers) for name, _ in self.parts() if name.split("/")[0] == "identify"}
        held_out = self.outliers_by_set(list(results.values())[-1])
        return {name: fitted[name] if name in fitted else held_out[name][0] for name, _ in self.parts()}

    def outliers_by_set(self, last: "Identification") -> dict[str, tuple[Measurements, list["LeftOut"]]]:
        """Return set -> (its inlier poses, its outliers), for all sets that were not fitted.

        With the loss `linear` every row is an inlier.

        last : identification by the last method, which judges them
        """
        parts = {name: m for name, m in self.parts() if name.split("/")[0] != "identify"}
        counted = self.loss == "linear"
        return {name: (m, []) if counted else last.without_outliers(m) for name, m in parts.items()}

    def without_errors(self, errors: CameraErrorsTable) -> "Problem":
        """Return the problem, its only table without these camera errors, which it then names."""
        sets = {name: tuple(errors.taken_off(m) for m in parts) for name, parts in self.sets.items()}
        (table,) = self.tables
        tables = ({**table, "camera_errors": errors.model_dump(exclude_defaults=True)},)
        return replace(self, sets=sets, whole=tuple(errors.taken_off(m) for m in self.whole), tables=tables)

    def calibrated_urdf(self, robot: Robot) -> str:
        """Return the problem's URDF with the calibrated geometry and the measured point as a link.

        Where a camera measured poses, its frame is the link casadical_camera.

        Raises InputError where the robot is not from a URDF.
        """
        from casadical.robot.urdf import calibrated_urdf_text

        if self.urdf is None:
            raise InputError(f"{self.folder}: its robot is not from a URDF; write its robot file, or a new URDF")
        place = next((m.camera for _, m in self.parts() if m.camera), "")
        measured = "casadical_camera" if place == "in hand" else "casadical_measured_point"
        standing = "casadical_camera" if place == "to base" else None
        return calibrated_urdf_text(self.robot, robot, *self.urdf, measured_link=measured, measuring_link=standing)


def error_groups(names: Iterable[str]) -> dict[str, list[str]]:
    """Return group -> names of `Problem.parts` over whose poses errors are evaluated together.

    Tables of one kind form the group SET/KIND; each table is a group of its own, too.
    """
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault("/".join(name.split("/")[:2]), []).append(name)
    return groups | {name: [name] for several in groups.values() for name in several}


def read_problem(
    folder: str | Path,
    seed: int | None = None,
    carried: Carried = nothing_carried,
    tables: Sequence[str | Path] = (),
    *,
    campaign: bool = False,
) -> Problem:
    """Read a problem folder: robot and measurements, split into named sets.

    folder : problem folder, with its problem.toml; or with tables also a robot file
    seed : seed of the split in place of the one in the file; None: that of the file
    carried : function that puts values of another campaign into the robot (see
        `casadical.identification.prior.carry_over`)
    tables : measured poses in place of the folder's own, interpreted as these are (see
        `read_campaign`)
    campaign : whether the robot is that of a diagnosis (see `read_campaign_robot`); with `tables`
        it always is
    Raises InputError: a folder that is no problem; it names the file and what is wrong in it.

    Examples
    --------
    >>> problem = casadical.read_problem("problems/planar")
    >>> {name: len(m) for name, m in problem.parts()}
    {'identify': 25, 'report': 15}
    """
    try:
        return _problem(Path(folder), seed, carried, tables, campaign)
    except InputError as error:
        raise every_fault(error, [Path(folder), *map(Path, tables)]) from None


def _problem(folder: Path, seed: int | None, carried: Carried, tables: Sequence[str | Path], campaign: bool) -> Problem:
    """Read a problem as `read_problem` does; errors are those of the first unusable file alone."""
    file, path = file_with_tables(folder, tables), folder / "problem.toml"
    if not file.measurements and file.logs:
        raise InputError(f"{path}: holds joint logs, no measured poses; take casadical diagnose {shown(folder)}")
    if not file.measurements:
        raise InputError(
            f"{path}: measurements: is missing; a calibration needs at least one table: "
            "[[measurements]], or a CSV after the folder"
        )
    from casadical.compensator.trainers.registry import network_methods

    place, urdf = folder / (file.of_campaigns if campaign else file.robot), file.urdf or UrdfTable()
    robot, prior = carried(replace(robot_of_file(place, urdf), sessions=file.sessions))
    sets = file.sets if seed is None else file.sets.model_copy(update={"seed": seed})
    measured = each_of(partial(_read, folder, data, robot, sets) for data in file.measurements)
    split: dict[str, list[Measurements]] = {}
    refuse_shared_rows([whole for whole, _ in measured])
    named = any(whole.session_names for whole, _ in measured)
    if "sessions" in file.model_fields_set and not tables and not named:
        raise InputError(
            f"{path}: sessions: has no effect, no table names a session; take it out, or name "
            "sessions in a column `session` or a key of [[measurements]]"
        )
    for name, part in (item for _, parts in measured for item in parts.items()):
        split.setdefault(name, []).append(part)
    if "identify" not in split:
        raise InputError(f"{path}: sets: no poses are named 'identify'; there are {', '.join(split)}")
    robot = tool_as_measured(robot, folder, [m for parts in split.values() for m in parts])
    return Problem(
        folder=folder,
        title=file.title or f"{robot.name}: {', '.join(Path(t).name for t in tables)}",
        data=file.data,
        robot=robot,
        sets={name: tuple(parts) for name, parts in split.items()},
        methods=base_methods(file.methods),
        loss=file.loss,
        geometry_prior=file.geometry_prior,
        urdf=(place, urdf.base_link, urdf.tip_link) if place.suffix == ".urdf" else None,
        networks=tuple(m for m in network_methods() if m in file.methods),
        seed=sets.seed,
        paper=file.paper,
        prior=prior,
        set_column=sets.column,
        tables=tuple(data.interpretation for data in file.measurements),
        robot_file=place,
        whole=tuple(whole for whole, _ in measured) if sets.refit and len(split) > 1 else (),
    )


def read_problem_robot(folder: str | Path, *, campaign: bool = False) -> Robot:
    """Return the robot of a problem folder without its measurements. Raises InputError.

    campaign : whether it is the robot of diagnoses (`campaign_robot`), not that of calibrations
    """
    folder = Path(folder)
    file = problem_file(folder)
    name = file.of_campaigns if campaign else file.robot
    return replace(robot_of_file(folder / name, file.urdf or UrdfTable()), sessions=file.sessions)


def read_campaign_robot(folder: str | Path) -> Robot:
    """Return the robot of a diagnosis: the folder's `campaign_robot`, else its robot; or a file's.

    folder : problem folder, or a robot file (TOML or URDF); a URDF that the problem.toml next to it
        names is read as that says
    Raises InputError: no such file, or what is wrong in it.

    Examples
    --------
    >>> casadical.read_campaign_robot("problems/planar").name
    'Planar arm of two links'
    """
    folder = Path(folder)
    if not folder.is_file():
        return read_problem_robot(folder, campaign=True)
    if folder.suffix == ".urdf" and (folder.parent / "problem.toml").is_file():
        file = problem_file(folder.parent)
        if folder.name in (file.robot, file.of_campaigns):
            return robot_of_file(folder, file.urdf or UrdfTable())
    return robot_of_file(folder, UrdfTable())


def tool_as_measured(robot: Robot, source: Path, sets: Iterable[Measurements]) -> Robot:
    """Return the robot with the pose of its tool unknown, where orientations were measured.

    Only a URDF whose [urdf] does not say what is unknown of the tool is changed; else the robot is
    returned as it is.

    source : problem folder or robot file
    """
    file = problem_file(source) if source.is_dir() else ProblemFile(casadical=1, title="", robot=source.name)
    tools = file.urdf.tool if file.urdf else []
    said = not file.of_campaigns.endswith(".urdf") or any("unknown" in tool.model_fields_set for tool in tools)
    if said or not any(find_kind(m.kind).angles for m in sets):
        return robot
    return robot.with_unknown(tool="pose")


def read_campaign(
    folder: str | Path,
    path: str | Path,
    robot: Robot,
    *,
    readings_only: bool = False,
    later: bool = False,
    words: bool = False,
) -> Measurements:
    """Read a table of measured poses, its columns interpreted as those of the problem's own tables.

    The `columns`, `point_from` and `kind` are those of the [[measurements]] with this file; of
    another file, those of the first [[measurements]] whose own names for columns it has, as far as
    it has them.

    folder : problem folder, or a robot file, with the tables of its calibration in the result.json
        next to it; where there is neither, the headings must be casadical's own or understood by
        themselves
    path : table
    robot : robot as of `read_campaign_robot`
    readings_only : whether poses are planned but not measured: every position is zero
    later : whether the table checks a finished calibration: it need not name the measured target,
        and rows with an empty cell are omitted
    words : whether rows with a word in place of a number are omitted, too
    Raises InputError: the table is not usable.

    Examples
    --------
    >>> len(casadical.read_campaign("problems/planar", "data/planar/planar.csv", robot))
    40
    """
    folder, raw = Path(folder), read_table(path, keep_text=False)
    data = table_like(folder, raw, tables_of(folder))
    given, joints = _columns(raw, data, robot), [j.kind for j in robot.joints]
    lost = (given.lost_rows if words else given.empty_rows) if later else ()
    columns = with_coupled(given.without(lost, "the table"), robot)
    if readings_only:
        m = readings_alone(columns, joints)
    else:
        m = _poses(columns, joints, data, robot)
        touched = set() if m.label is None else set(m.label.tolist())
        m = m.with_separations(s for s in _separations(data) if touched.issuperset(s[:2]))
    m = replace(m, lost=lost)
    if not (readings_only or later):
        refuse_nameless(m, robot)
    return _with_conditions(m if later else with_target_positions(m, robot), robot)


def _poses(columns: Columns, joints: Sequence[str], data: DataTable, robot: Robot) -> Measurements:
    """Return the measurements of columns as their [[measurements]] declares them, with poses of the tool."""
    m = from_columns(columns, joints, data.kind, sigma_mm=data.sigma_mm, sigma_deg=data.sigma_deg)
    m = replace(m, datasheet=None if data.datasheet_mm is None else data.datasheet_mm * 1e-3)
    m = as_poses(m, robot, data.inverted, data.camera)
    if data.camera_errors and not m.camera:
        raise InputError(f"{m.source}: camera_errors: no camera is known that measured poses; say where it is: camera")
    return data.camera_errors.taken_off(m) if data.camera_errors else m


def _separations(data: DataTable) -> list[tuple[str, str, float]]:
    """Return the given distances between points as (point, point, distance [m])."""
    return [(s.between[0], s.between[1], s.distance_mm * 1e-3) for s in data.separation]


def _columns(raw: RawTable, data: DataTable, robot: Robot) -> Columns:
    """Return a table's columns under casadical's names, without rows in `leave_out`.

    Headings are interpreted as `data` declares, else by themselves and by the nominal robot.
    """
    raw = long(raw, [name for name, _ in columns_used(data.sources)])
    meaning = understood(raw, robot, data.sources, data.kind)
    refuse_open(raw, meaning)
    columns = Columns.of_file(raw).mapped({**meaning.sources, **data.sources}, data.point_from)
    columns = columns.with_tools(data.tools) if data.tools else columns
    if data.session:
        columns = replace(columns, table=columns.table.assign(session=data.session))
    if data.intrinsics:
        columns = replace(columns, table=columns.table.assign(**data.intrinsics.columns))
    return columns.without(data.leave_out, "leave_out")


def _read(folder: Path, data: DataTable, robot: Robot, sets: SetsTable) -> tuple[Measurements, dict[str, Measurements]]:
    """Return all poses of one [[measurements]], and its split into sets by name."""
    path = folder / data.file
    if not path.exists():
        raise InputError(f"{path}: no such file; it is named in {folder / 'problem.toml'}")
    columns = with_coupled(_columns(read_table(path, keep_text=False), data, robot), robot)
    joints = [j.kind for j in robot.joints]
    m = _poses(columns, joints, data, robot)
    if data.point_from and m.label is None:
        raise InputError(f"{path}: point_from: has no effect on kind {m.kind!r}; take it out of problem.toml")
    refuse_nameless(m, robot)
    # Before the split: progress and the direction of approach follow from the order of all poses.
    m = _with_conditions(with_target_positions(m, robot), robot).with_separations(_separations(data))
    if sets.column is None:
        return m, m.split(sets.sizes(), sets.seed)
    if sets.column not in columns.table:
        raise InputError(f"{m.source}: column {sets.column!r}, named in sets, is missing; there are {columns.names}")
    said = pd.Series(columns.table[sets.column].astype(str).to_numpy(), index=columns.row)
    names = said.loc[m.row]  # it lacks the copies of rows
    unknown = set(names) - set(SETS)
    if unknown:
        raise InputError(f"{m.source}: column {sets.column!r} holds {min(unknown)!r}; allowed: {', '.join(SETS)}")
    return m, {str(name): m[np.flatnonzero(names == name)] for name in names.unique()}


def _with_conditions(m: Measurements, robot: Robot) -> Measurements:
    """Return the measurements with the derived columns on which the robot's effects depend."""
    if robot.gravity_frame == "logged" and not {*GRAVITY_COLUMNS} <= m.conditions.keys():
        raise InputError(
            f'{m.source}: robot {robot.name!r} stands on what tilts ([gravity] frame = "logged"), and no columns say '
            f"how: log tilt_x_deg and tilt_y_deg of its base, or {', '.join(GRAVITY_COLUMNS)}"
        )
    if not robot.effects:
        return m
    derived, missing = derive(m, robot.conditions, robot.loads)
    for effect in robot.effects:
        lost = [c for c in effect.conditions if c in missing and not (c == "payload_kg" and robot.payload)]
        if lost:
            raise InputError(
                f"{m.source}: {effect.label} of robot {robot.name!r} follows {lost[0]}, which its "
                f"columns do not tell ({', '.join(effect.needs) or 'see docs/robot-file.md'}); log "
                "it, or take the effect out of the robot file"
            )
    refuse_undefined(robot, derived)
    return derived

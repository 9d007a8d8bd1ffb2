"""The file problem.toml: its schema, the interpretation of other tables by it, and results."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
import tomlkit
from pydantic import (
    AfterValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    field_serializer,
    field_validator,
    model_validator,
)

from casadical.core.basics import InputError, shown
from casadical.core.parts import Sessions
from casadical.core.reading import MAX_ITEMS, load_json, load_toml, missing, read_bytes
from casadical.core.schema import VALUE_FORMS, WHOLE_NUMBER, FaultError, TomlTable, Triple, check
from casadical.identification.residuals import AnyLoss
from casadical.measurements.columns import Source
from casadical.measurements.corners import INTRINSICS, CameraErrors
from casadical.measurements.kinds.registry import kinds
from casadical.measurements.measurements import SETS, Measurements
from casadical.measurements.raw_table import RawTable, read_table
from casadical.robot.robot import Robot
from casadical.robot.robot_file import read_robot, with_tools
from casadical.robot.robot_schema import ReadingsTable, RobotTables, ToolTable

# Name of a method that identifies the robot, without networks.
BaseMethod = Literal["KM", "SKCM"]
# Names of the methods that identify the robot, without networks.
BASE_METHODS: tuple[BaseMethod, ...] = get_args(BaseMethod)


class _Separation(TomlTable):
    """A given distance [mm] between two touched points."""

    between: list[str] = Field(min_length=2, max_length=2)
    distance_mm: float = Field(gt=0)


class _Source(TomlTable):
    """How a column is made (see `casadical.measurements.columns.Source`)."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True, populate_by_name=True, defer_build=True)

    name: str = Field(alias="from")
    times: float = 1.0
    plus: float = 0.0
    add: dict[str, float] = Field(default={})
    rows: int = 0

    @model_validator(mode="after")
    def _tells(self) -> _Source:
        """Refuse a declared source in which the total factor of its own column is zero."""
        if self.times + self.add.get(self.name, 0.0) == 0:
            key = "times" if "times" in self.model_fields_set else "add"
            raise FaultError(key, f"leaves nothing of column {self.name!r}; leave it out, or take another factor")
        return self


def _form(value: Any) -> str:
    """Return the entry of `VALUE_FORMS` by which a column's source is validated: text or table."""
    return VALUE_FORMS[isinstance(value, dict | _Source)]


# Declared source of a column: its name, or a table of how it is computed.
_Made = Annotated[Annotated[str, Tag(VALUE_FORMS[0])] | Annotated[_Source, Tag(VALUE_FORMS[1])], Discriminator(_form)]


class _Intrinsics(TomlTable):
    """Intrinsics of a camera [px], and k1, k2, p1, p2, k3 of its distortion as OpenCV has them."""

    fx: float = Field(gt=0)
    fy: float = Field(gt=0)
    cx: float
    cy: float
    distortion: list[float] = Field(default=[], max_length=5)

    @property
    def columns(self) -> dict[str, float]:
        """Return column -> its value in every row [px, 1]; coefficients not given are zero."""
        values = (self.fx, self.fy, self.cx, self.cy, *self.distortion, *[0.0] * (5 - len(self.distortion)))
        return dict(zip(INTRINSICS, values, strict=True))


class CameraErrorsTable(TomlTable):
    """Errors of a camera taken off its poses (see `corners.CameraErrors`); board centre [mm]."""

    focal: float = Field(default=0.0, gt=-0.2, lt=0.2)
    tilt: float = Field(default=0.0, gt=-0.2, lt=0.2)
    board: float = Field(default=0.0, gt=-0.2, lt=0.2)
    distortion: float = Field(default=0.0, gt=-1.0, lt=1.0)
    middle_mm: Triple = Field(default=[0.0, 0.0, 0.0])

    def taken_off(self, m: Measurements) -> Measurements:
        """Return the poses as a camera without these errors has them."""
        errors = CameraErrors(self.focal, self.tilt, self.board, self.distortion)
        return m.without_errors(errors, 1e-3 * np.array(self.middle_mm))


class DataTable(TomlTable):
    """[[measurements]] of problem.toml: a file with a table, and how it is interpreted.

    file, kind : path from the problem folder; kind of measurement, None: by the columns
    columns : source of each column, by casadical's name
    leave_out : rows of the file that are omitted
    session : name of the session of all rows
    tools : rows of the file at which each target was measured, by its name
    point_from : columns that together name the touched point
    separation : given distances between touched points
    sigma_mm, sigma_deg : one sigma of a coordinate and of an angle
    datasheet_mm : largest error of a point that the data sheet of the instrument states
    inverted : whether poses are those of the measuring frame in the tool; None: as `as_poses` finds
    camera : where the camera is, in hand or to base; empty: inferred from the poses
    intrinsics : of the camera in whose images corners are; camera_errors : taken off its poses
    """

    file: str
    kind: str | None = None
    columns: dict[Annotated[str, Field(min_length=1)], _Made] = Field(default={})
    leave_out: list[int] = Field(default=[])
    session: str = Field(default="", min_length=1)
    tools: dict[str, list[int]] = Field(default={})
    point_from: list[str] = Field(default=[])
    separation: list[_Separation] = Field(default=[])
    sigma_mm: float | None = Field(default=None, gt=0)
    sigma_deg: float | None = Field(default=None, gt=0)
    datasheet_mm: float | None = Field(default=None, gt=0)
    inverted: bool | None = None
    camera: Literal["", "in hand", "to base"] = ""
    intrinsics: _Intrinsics | None = None
    camera_errors: CameraErrorsTable | None = None

    @field_validator("kind")
    @classmethod
    def _registered(cls, kind: str | None) -> str | None:
        """Return the kind of measurement unchanged; refuse one that is not registered."""
        if kind is not None and kind not in kinds():
            raise ValueError(f"must be {', '.join(map(repr, kinds()))}")
        return kind

    @model_validator(mode="after")
    def _one_noise(self) -> DataTable:
        """Refuse sigma_mm and datasheet_mm together: both state the noise of a coordinate."""
        if self.sigma_mm is not None and self.datasheet_mm is not None:
            raise FaultError("datasheet_mm", "sigma_mm says more of the same; leave one of them out")
        return self

    @property
    def sources(self) -> dict[str, Source]:
        """Return casadical's column name -> its source, for the columns that are declared."""
        given = self.model_dump(include={"columns"}, by_alias=True)["columns"]
        return {ours: Source.read(source) for ours, source in given.items()}

    @property
    def noise(self) -> dict[str, float]:
        """Return those of sigma_mm, sigma_deg and datasheet_mm that are given, with their values.

        They declare the instrument's noise.
        """
        return self.model_dump(include={"sigma_mm", "sigma_deg", "datasheet_mm"}, exclude_none=True)

    @property
    def interpretation(self) -> dict[str, Any]:
        """Return the keys and values by which another table of the same origin is interpreted.

        They are those that were given among file, kind, columns, point_from, and of cameras.
        """
        keys = ("file", "kind", "columns", "point_from", "inverted", "camera", "intrinsics", "camera_errors")
        given = self.model_dump(include={*keys}, exclude_defaults=True, by_alias=True)
        return {key: given[key] for key in keys if key in given}

    def named_in(self, header: Sequence[str]) -> DataTable:
        """Return the declaration as it applies to another file with these headings.

        It has only the column sources that the headings provide, and no keys that refer to rows of
        its own file (leave_out, tools, session).
        """
        needs = {o: {g} if isinstance(g, str) else {g.name, *g.add} for o, g in self.columns.items()}
        columns = {ours: given for ours, given in self.columns.items() if needs[ours] <= set(header)}
        point_from = self.point_from if set(self.point_from) <= set(header) else []
        return self.model_copy(
            update={"columns": columns, "point_from": point_from, "leave_out": [], "tools": {}, "session": ""}
        )


class SetsTable(TomlTable):
    """[sets] of problem.toml: the split of the poses, by shares, by numbers or by a column.

    refit : whether the robots that are written are fitted to all poses, once judged
    """

    refit: bool = False
    seed: int = Field(default=0, ge=0, lt=2**63)
    column: str | None = None
    identify: float | None = Field(default=None, gt=0)
    train: float | None = Field(default=None, gt=0)
    choose: float | None = Field(default=None, gt=0)
    report: float | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _clear(self) -> SetsTable:
        """Refuse sizes next to a column, and those that are no share or whole number."""
        given = self.model_dump(include={*SETS}, exclude_none=True)
        if self.column is not None and given:
            raise FaultError("column", f"it names every pose's set; leave out {', '.join(given)}")
        for name, size in given.items():
            if size > 1 and size != int(size):
                raise FaultError(name, "allowed: a share below 1, or a whole number of poses")
        return self

    def sizes(self) -> dict[str, float]:
        """Return set -> share (below 1) or number of poses; 70 % identify, 30 % report by default.

        identify = 1 alone is the whole table.
        """
        given = self.model_dump(include={*SETS}, exclude_none=True)
        if given == {"identify": 1.0}:  # the whole table, not one pose
            return {"identify": math.nextafter(1.0, 0.0)}
        return given or {"identify": 0.7, "report": 0.3}


class UrdfTable(RobotTables):
    """[urdf] of problem.toml: which part of a URDF is the robot, and what a URDF cannot say of it.

    base_link, tip_link : ends of the chain; None: the only ones there are
    compliant : numbers of the joints whose compliance is identified
    tool : measured points in the tip link's frame; []: the tip link itself
    joint : joints by name whose angle differs from the controller's reading
    """

    base_link: str | None = None
    tip_link: str | None = None
    compliant: list[int] = Field(default=[])
    tool: list[ToolTable] = Field(default=[])
    joint: list[ReadingsTable] = Field(default=[])

    def added_to(self, robot: Robot) -> Robot:
        """Return the URDF's robot with all that these tables declare. Raises InputError."""
        robot, names = super().added_to(robot), [j.name for j in robot.joints]
        if unknown := [j.name for j in self.joint if j.name not in names]:
            raise InputError(f"problem.toml: urdf.joint: name {unknown[0]!r}; allowed: {', '.join(names)}")
        made = {j.name: j.made_of() for j in self.joint}
        joints = tuple(replace(j, readings=made.get(j.name, j.readings)) for j in robot.joints)
        return with_tools(replace(robot, joints=joints), self.tool) if self.tool else replace(robot, joints=joints)


def robot_of_file(path: Path, urdf: UrdfTable) -> Robot:
    """Return the robot of a robot file or URDF.

    urdf : [urdf] of problem.toml, which applies to a URDF alone
    Raises InputError for a file that is no robot.
    """
    if path.suffix == ".urdf":
        from casadical.robot.urdf import read_urdf

        return urdf.added_to(read_urdf(path, urdf.base_link, urdf.tip_link, compliant=urdf.compliant))
    return read_robot(path)


def as_toml(source: Source) -> Any:
    """Return a column's source as a value of TOML: its name, or an inline table."""
    if isinstance(said := source.table, str):
        return tomlkit.string(said)
    made = tomlkit.inline_table()
    made.update(said)
    return made


def all_methods() -> tuple[str, ...]:
    """Return all calibration methods: identifications, then the networks of all trainers."""
    from casadical.compensator.trainers.registry import network_methods

    return (*BASE_METHODS, *network_methods())


def _checked_method(name: str) -> str:
    """Return a method's name unchanged. Raises ValueError where there is no such method."""
    if name not in BASE_METHODS and name not in all_methods():
        raise ValueError(f"allowed: {', '.join(all_methods())}")
    return name


class Paper(TomlTable):
    """[paper] of problem.toml: published figures to compare with.

    source : of the figures
    calibration, validation : (mean, max, std) [mm] by method, "before" among them, of the two
        tables of the paper
    """

    source: str
    calibration: dict[str, Triple] = Field(default={})
    validation: dict[str, Triple] = Field(default={})

    @field_serializer("calibration", "validation")
    def _named(self, table: dict[str, Triple]) -> dict[str, dict[str, float]]:
        """Return method -> its published figures by the JSON keys mean_mm, max_mm and std_mm."""
        return {m: dict(zip(("mean_mm", "max_mm", "std_mm"), f, strict=True)) for m, f in table.items()}

    @model_validator(mode="after")
    def _methods(self) -> Paper:
        """Refuse published figures of unknown methods."""
        for table in ("calibration", "validation"):
            for name in getattr(self, table):
                if name not in ("before", *all_methods()):
                    raise FaultError((table, name), f"allowed: before, {', '.join(all_methods())}")
        return self


class LogsTable(TomlTable):
    """[logs] of problem.toml: files of joint logs.

    identify : whole motions that may be fitted
    report : motions that are held out
    """

    identify: list[str] = Field(min_length=1)
    report: list[str] = Field(default=[])

    @model_validator(mode="after")
    def _apart(self) -> LogsTable:
        """Refuse a log that is both fitted and held out."""
        if both := {*self.identify} & {*self.report}:
            raise FaultError("report", f"{min(both)} is in identify, too; keep it in one of them")
        return self


class ProblemFile(TomlTable):
    """The contents of problem.toml (docs/problem-folder.md lists the keys)."""

    casadical: Annotated[Literal[1], WHOLE_NUMBER]
    title: str
    data: Literal["real", "synthetic"] | None = None
    robot: str = "robot.toml"
    campaign_robot: str | None = None
    urdf: UrdfTable | None = None
    methods: list[Annotated[str, AfterValidator(_checked_method)]] = Field(default=["KM", "SKCM"], min_length=1)
    loss: AnyLoss = "auto"
    geometry_prior: bool = True
    paper: Paper | None = None
    measurements: list[DataTable] = Field(default=[], max_length=MAX_ITEMS)
    logs: LogsTable | None = None
    sets: SetsTable = SetsTable()
    sessions: Sessions = Sessions()

    @property
    def of_campaigns(self) -> str:
        """Return the name of the robot file with which campaigns are diagnosed."""
        return self.campaign_robot or self.robot


def base_methods(methods: Sequence[str]) -> tuple[BaseMethod, ...]:
    """Return those of KM and SKCM that the methods need; networks learn the residual of SKCM."""
    needed = {*methods, "SKCM"} if set(methods) - {*BASE_METHODS} else {*methods}
    return tuple(m for m in BASE_METHODS if m in needed)


def problem_file(folder: Path) -> ProblemFile:
    """Return the contents of a folder's problem.toml. Raises InputError where it is not valid."""
    if not folder.exists():
        raise missing(folder, "robot file" if folder.suffix in (".toml", ".urdf") else "problem folder")
    if not folder.is_dir():
        raise InputError(
            f"{shown(folder)}: is a file; give the problem folder, which holds problem.toml and a robot file"
        )
    path = folder / "problem.toml"
    file = check(ProblemFile, load_toml(path), str(path))
    if file.urdf is not None and ".urdf" not in (Path(file.robot).suffix, Path(file.of_campaigns).suffix):
        raise InputError(
            f"{path}: urdf: has no effect, robot = {file.robot!r} is no .urdf; take it out, or name the URDF"
        )
    return file


def file_with_tables(source: Path, tables: Sequence[str | Path]) -> ProblemFile:
    """Return the problem.toml of a folder, with the given tables, if any, in place of its own.

    For a robot file the result is as if a problem.toml named this robot and the tables, and asked
    for a refit to all poses. With tables the robot is that of diagnoses. Raises InputError.
    """
    if not tables:
        return problem_file(source)
    if source.is_file():
        file = ProblemFile(casadical=1, title="", robot=str(source.resolve()), sets=SetsTable(refit=True))
    else:
        file = problem_file(source)
        file = file.model_copy(update={"robot": file.of_campaigns, "title": "", "paper": None})
    own = tables_of(source)
    measured = [
        table_like(source, read_table(t, keep_text=False), own).model_copy(update={"file": str(Path(t).resolve())})
        for t in tables
    ]
    return file.model_copy(update={"measurements": measured, "data": None})


def own_tables(source: Path) -> list[Path]:
    """Return the paths of a problem folder's tables. Raises InputError for none or a robot file."""
    if source.is_file():
        raise InputError(f"{shown(source)}: a robot file has no measurements; give their tables after it")
    if source.is_dir() and not (source / "problem.toml").exists():
        raise InputError(f"{shown(source)}: no problem.toml is in it, which would name tables; give them after it")
    paths = [source / table.file for table in problem_file(source).measurements]
    if not paths:
        raise InputError(f"{shown(source / 'problem.toml')}: no [[measurements]]; give tables after the folder")
    return paths


def tables_of(folder: Path) -> Sequence[DataTable]:
    """Return the [[measurements]] of a problem, or those of a robot file's calibration or diagnosis.

    [] where there is neither problem.toml nor the JSON file of the results.

    folder : problem folder, or a robot file with the JSON file of its results next to it
    """
    if (folder / "problem.toml").exists():
        return problem_file(folder).measurements
    try:
        diagnosed = folder.name in ("diagnosed.robot.toml", "discovered.robot.toml")
        listed = load_json(folder.parent / ("diagnosis.json" if diagnosed else "result.json"))["tables"]
        return [check(DataTable, table, "result.json") for table in listed]
    except (OSError, ValueError, KeyError, TypeError, InputError):
        return []


def table_like(folder: Path, raw: RawTable, tables: Sequence[DataTable]) -> DataTable:
    """Return the [[measurements]] by which a table is interpreted, from those of a problem.

    A copy of one of these tables is interpreted as that one; another table by the first whose
    columns it has, else only by kind and noise that all of them share.

    folder : of the problem
    tables : declarations of the problem's own tables
    """
    for data in tables:
        own = folder / data.file
        if own.resolve() == raw.path.resolve() or (own.is_file() and read_bytes(own) == read_bytes(raw.path)):
            return data
    others = [data.named_in(raw.header) for data in tables]
    turned = "u_px" in raw.header or any(k.angles and k.matches({*raw.header}) for k in kinds().values())
    for like in others:
        if like.columns or like.point_from or (like.camera and turned):
            return like
    said = {data.kind for data in tables}
    kind = said.pop() if len(said) == 1 else None
    shown = [k.name for k in kinds().values() if k.matches({*raw.header})]  # by exact names
    if (kind or "position") not in (shown or ("position", "pose")):
        return DataTable(file=raw.path.name)
    noises = [data.noise for data in tables]
    noise = noises[0] if noises and all(own == noises[0] for own in noises) else {}
    return DataTable.model_validate({"file": raw.path.name, "kind": kind, **noise})


def result_in(folder: Path) -> Path:
    """Return the path of the last method's robot file in a folder of results; a file is unchanged.

    Without result.json it is the only robot file there. Raises InputError where neither is there.
    """
    if not folder.is_dir():
        return folder
    fault = "no result.json of a calibration is in it"
    try:
        methods = list(load_json(folder / "result.json")["methods"])
        return folder / f"{methods[-1]}.robot.toml"
    except InputError as error:
        fault = str(error) if (folder / "result.json").exists() else fault
    except (KeyError, TypeError, IndexError):
        pass
    if (folder / "problem.toml").exists():
        raise InputError(
            f"{shown(folder)}: is a problem folder; give its results: casadical calibrate {shown(folder)} --out results"
        )
    files = sorted(folder.glob("*.robot.toml"))
    if len(files) == 1:
        return files[0]
    raise InputError(f"{shown(folder)}: {fault}, and {len(files)} robot files: give a robot file")

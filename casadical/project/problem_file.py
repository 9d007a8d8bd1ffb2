"""The file problem.toml: its tables and keys, and what they may hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator, model_validator

from casadical.compensator import network_methods
from casadical.core.errors import InputError
from casadical.core.parts import Sessions
from casadical.core.schema import FaultError, check, load_toml
from casadical.identification.residuals import AnyLoss
from casadical.measurements.column_map import Source
from casadical.measurements.kinds.registry import kinds
from casadical.measurements.measurements import SETS
from casadical.robot.robot_schema import ToolTable

BaseMethod = Literal["KM", "SKCM"]
BASE_METHODS: tuple[BaseMethod, ...] = get_args(BaseMethod)

# auto: huber where it finds outliers, else linear.

Three = Annotated[list[float], Field(min_length=3, max_length=3)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)


class _Separation(_Strict):
    between: list[str] = Field(min_length=2, max_length=2)
    distance_mm: float = Field(gt=0)


class _Source(_Strict):
    """How a column is made (see `casadical.measurements.column_map.Source`)."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True, populate_by_name=True)

    name: str = Field(alias="from")
    times: float = 1.0
    plus: float = 0.0
    add: dict[str, float] = {}
    rows: int = 0


class DataTable(_Strict):
    """One of [[measurements]]."""

    file: str
    kind: str | None = None
    columns: dict[str, str | _Source] = {}
    leave_out: list[int] = []
    session: str = ""
    tools: dict[str, list[int]] = {}
    point_from: list[str] = []
    separation: list[_Separation] = []
    sigma_mm: float | None = Field(default=None, gt=0)
    sigma_deg: float | None = Field(default=None, gt=0)

    @field_validator("kind")
    @classmethod
    def _known(cls, kind: str | None) -> str | None:
        if kind is not None and kind not in kinds():
            raise ValueError(f"must be {', '.join(map(repr, kinds()))}")
        return kind

    @property
    def sources(self) -> dict[str, str | Source]:
        """Where each named column comes from."""
        return {
            ours: given if isinstance(given, str) else Source(**given.model_dump())
            for ours, given in self.columns.items()
        }

    @property
    def understood(self) -> dict[str, Any]:
        """What another table of the same origin is understood by."""
        keys = ("file", "kind", "columns", "point_from")
        given = self.model_dump(include={*keys}, exclude_defaults=True, by_alias=True)
        return {key: given[key] for key in keys if key in given}

    def named_in(self, header: Sequence[str]) -> DataTable:
        """With only those of its own names for columns that a header has, without rows of its file."""
        needs = {o: {g} if isinstance(g, str) else {g.name, *g.add} for o, g in self.columns.items()}
        columns = {ours: given for ours, given in self.columns.items() if needs[ours] <= set(header)}
        point_from = self.point_from if set(self.point_from) <= set(header) else []
        return self.model_copy(
            update={"columns": columns, "point_from": point_from, "leave_out": [], "tools": {}, "session": ""}
        )


class SetsTable(_Strict):
    """How the poses are split."""

    seed: int = Field(default=0, ge=0, lt=2**63)
    column: str | None = None
    identify: float | None = Field(default=None, gt=0)
    train: float | None = Field(default=None, gt=0)
    choose: float | None = Field(default=None, gt=0)
    report: float | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _clear(self) -> SetsTable:
        given = self.model_dump(include={*SETS}, exclude_none=True)
        if self.column is not None and given:
            raise FaultError("column", f"it names every pose's set; leave out {', '.join(given)}")
        for name, size in given.items():
            if size > 1 and size != int(size):
                raise FaultError(name, "allowed: a share below 1, or a whole number of poses")
        return self

    def sizes(self) -> dict[str, float]:
        """Of the sets, shares or numbers of poses; identify = 1 alone is the whole table."""
        given = self.model_dump(include={*SETS}, exclude_none=True)
        if given == {"identify": 1.0}:  # the whole table, not one pose
            return {"identify": math.nextafter(1.0, 0.0)}
        return given or {"identify": 0.7, "report": 0.3}


class SessionsTable(_Strict):
    """What is found again in each session."""

    base: Literal["own", "shared"] = "own"
    tool: Literal["own", "shared"] = "own"
    zeros: Literal["own", "shared"] = "shared"

    def sessions(self) -> Sessions:
        return Sessions(self.base, self.tool, self.zeros)


class UrdfTable(_Strict):
    """Which part of a URDF is the robot; written again when it is calibrated.

    tool : measured points in the frame of the tip link, where there are several
    """

    base_link: str | None = None
    tip_link: str | None = None
    compliant: list[int] = []
    tool: list[ToolTable] = []


def all_methods() -> tuple[str, ...]:
    """Every method of a calibration: identifications, then the networks of all trainers."""
    return (*BASE_METHODS, *network_methods())


def _known_method(name: str) -> str:
    if name not in all_methods():
        raise ValueError(f"allowed: {', '.join(all_methods())}")
    return name


class Paper(_Strict):
    """Published figures: (mean, max, std) [mm] by method, "before" among them, of both of the paper's tables."""

    source: str
    calibration: dict[str, Three] = {}
    validation: dict[str, Three] = {}

    @model_validator(mode="after")
    def _known(self) -> Paper:
        for table in ("calibration", "validation"):
            for name in getattr(self, table):
                if name not in ("before", *all_methods()):
                    raise FaultError((table, name), f"allowed: before, {', '.join(all_methods())}")
        return self


class ProblemFile(_Strict):
    """The whole file."""

    casadical: Literal[1]
    title: str
    data: Literal["real", "synthetic"] | None = None
    robot: str = "robot.toml"
    campaign_robot: str | None = None
    urdf: UrdfTable | None = None
    methods: list[Annotated[str, AfterValidator(_known_method)]] = Field(default=["KM", "SKCM"], min_length=1)
    loss: AnyLoss = "auto"
    paper: Paper | None = None
    measurements: list[DataTable] = []
    sets: SetsTable = SetsTable()
    sessions: SessionsTable = SessionsTable()

    @property
    def of_campaigns(self) -> str:
        """The robot file that campaigns are diagnosed with."""
        return self.campaign_robot or self.robot


def base_methods(methods: Sequence[str]) -> tuple[BaseMethod, ...]:
    """The identifications that these methods need: networks learn what SKCM leaves."""
    needed = {*methods, "SKCM"} if set(methods) - {*BASE_METHODS} else {*methods}
    return tuple(m for m in BASE_METHODS if m in needed)


def problem_file(folder: Path) -> ProblemFile:
    """The problem.toml of a folder. Raises InputError."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such problem folder; it must hold problem.toml and a robot file")
    path = folder / "problem.toml"
    return check(ProblemFile, load_toml(path), str(path))

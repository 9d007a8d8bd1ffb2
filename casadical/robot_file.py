"""A robot as a TOML file: read with units in its keys, checked key by key, written again after calibration.

Lengths, angles and masses carry their unit in the key (`a_mm`, `alpha_deg`, `mass_kg`); millimetres or metres, degrees
or radians are taken by name. See docs/robot-file.md for every key.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import tomlkit
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from .errors import InputError
from .files import write_whole
from .robot import STANDARD_GRAVITY, WIDTHS, Body, FourBar, Joint, Placement, Robot, Width
from .transforms import Array, frame, from_rpy, to_rpy

_UNITS = {"_mm": 1e-3, "_m": 1.0, "_deg": np.pi / 180, "_rad": 1.0, "_mrad": 1e-3}

Schema = TypeVar("Schema", bound=BaseModel)
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Range = Annotated[list[float], Field(min_length=2, max_length=2)]


def _to_si(value: Any, factor: float) -> Any:
    if isinstance(value, list):
        return [_to_si(v, factor) for v in value]
    return value * factor if isinstance(value, int | float) and not isinstance(value, bool) else value


class _Table(BaseModel):
    """A TOML table whose keys carry units; its fields are SI."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _units(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        found: dict[str, Any] = {}
        for key, value in data.items():
            stem, _, unit = key.rpartition("_")
            named = stem in cls.model_fields and f"_{unit}" in _UNITS
            name = stem if named else key
            if name in found:
                raise ValueError(f"{name!r} is given twice, with different units; keep one")
            found[name] = _to_si(value, _UNITS[f"_{unit}"]) if named else value
        return found


class _Body(_Table):
    mass_kg: float = Field(ge=0)
    com: Vector = [0.0, 0.0, 0.0]

    def body(self) -> Body:
        return Body(self.mass_kg, np.array(self.com))


class _Joint(_Table):
    alpha: float = 0.0
    a: float = 0.0
    theta: float = 0.0
    d: float = 0.0
    beta: float | None = None
    b: float | None = None
    type: Literal["revolute", "prismatic"] = "revolute"
    limits: Range | None = None
    compliant: bool = False
    stiffness_Nm_per_rad: float | None = Field(default=None, gt=0)
    body: _Body | None = None

    @model_validator(mode="after")
    def _ordered(self) -> _Joint:
        if self.limits and self.limits[0] >= self.limits[1]:
            raise ValueError(f"limits: the lower one must come first, got {self.limits} (SI)")
        return self


class _Frame(_Table):
    xyz: Vector = [0.0, 0.0, 0.0]
    rpy: Vector = [0.0, 0.0, 0.0]
    unknown: Literal["none", "position", "pose"] = "none"

    def placement(self) -> Placement:
        return Placement(frame(from_rpy(np.array(self.rpy)), np.array(self.xyz)), self.unknown)


class _FourBar(_Table):
    driven: int
    carrier: int
    crank: float = Field(gt=0)
    coupler: float = Field(gt=0)
    rocker: float = Field(gt=0)
    offset: float = 0.0


class _Gravity(_Table):
    frame: Literal["measuring", "base"] = "measuring"
    vector_m_per_s2: Vector = [0.0, 0.0, -STANDARD_GRAVITY]


class _Width(_Table):
    length_bound: float | None = Field(default=None, gt=0)
    angle_bound: float | None = Field(default=None, gt=0)
    length_prior: float | None = Field(default=None, gt=0)
    angle_prior: float | None = Field(default=None, gt=0)


class _Widths(_Table):
    base: _Width = _Width()
    geometry: _Width = _Width()
    loop: _Width = _Width()
    tool: _Width = _Width()
    compliance: _Width = _Width()

    def widths(self) -> dict[str, Width]:
        given = {group: getattr(self, group).model_dump(exclude_none=True) for group in WIDTHS}
        return {group: replace(default, **given[group]) for group, default in WIDTHS.items()}


class _RobotFile(_Table):
    casadical: Literal[1]
    name: str = Field(min_length=1)
    convention: Literal["modified", "standard"] = "modified"
    notes: list[str] = []
    base: _Frame = _Frame()
    tool: _Frame = _Frame()
    gravity: _Gravity = _Gravity()
    payload: _Body | None = None
    joint: list[_Joint] = Field(min_length=1)
    four_bar: list[_FourBar] = []
    width: _Widths = _Widths()

    def robot(self) -> Robot:
        joints = [_joint(row) for row in self.joint]
        tool = self.tool.placement()
        payload = self.payload.body() if self.payload else None
        if self.convention == "standard":
            joints, flange = _from_standard(joints)
            tool = replace(tool, T=flange @ tool.T)
            payload = payload and _moved(payload, flange)
        return Robot(
            name=self.name,
            joints=tuple(joints),
            base=self.base.placement(),
            tool=tool,
            loops=tuple(FourBar(**loop.model_dump()) for loop in self.four_bar),
            gravity=np.array(self.gravity.vector_m_per_s2),
            gravity_frame=self.gravity.frame,
            payload=payload,
            widths=self.width.widths(),
            notes=tuple(self.notes),
        )


def _joint(row: _Joint) -> Joint:
    default = (-2 * np.pi, 2 * np.pi) if row.type == "revolute" else (-10.0, 10.0)
    lower, upper = row.limits or default
    compliance = 1 / row.stiffness_Nm_per_rad if row.stiffness_Nm_per_rad else 0.0 if row.compliant else None
    return Joint(
        row.alpha, row.a, row.theta, row.d, row.beta, row.b, row.type, lower, upper, compliance,
        row.body.body() if row.body else None,
    )  # fmt: skip


def _from_standard(rows: list[Joint]) -> tuple[list[Joint], Array]:
    """Modified rows for standard ones, and the transform that the last a and alpha leave behind the last joint.

    Mass centres of bodies, given in the standard frames, are moved along.
    Standard: Rot_z(theta) Trans_z(d) Trans_x(a) Rot_x(alpha); a row's a and alpha are the next modified row's.
    """
    shifted = [Joint(), *rows[:-1]]
    tails = [frame(from_rpy(np.array([row.alpha, 0.0, 0.0])), np.array([row.a, 0.0, 0.0])) for row in rows]
    joints = [
        replace(row, alpha=before.alpha, a=before.a, body=row.body and _moved(row.body, tail))
        for row, before, tail in zip(rows, shifted, tails, strict=True)
    ]
    return joints, tails[-1]


def _moved(body: Body, T: Array) -> Body:
    return Body(body.mass, T[:3, :3] @ body.com + T[:3, 3])


def read_robot(path: str | Path) -> Robot:
    """A robot from its TOML file.

    Raises InputError that names the file, the key, the value and what is allowed.
    """
    path = Path(path)
    return robot_from(load_toml(path), path.name)


def robot_from(data: Mapping[str, Any], source: str) -> Robot:
    """A robot from the tables of a TOML file; `source` names it in messages."""
    return check(_RobotFile, data, source).robot()


def load_toml(path: Path) -> dict[str, Any]:
    """Tables of a TOML file. Raises InputError."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not valid TOML: {error}") from None


def check(schema: type[Schema], data: Mapping[str, Any], source: str) -> Schema:
    """Data checked against a schema, with an InputError that lists every fault by key."""
    try:
        return schema.model_validate(data)
    except ValidationError as error:
        faults = [f"  {_key(e['loc'])}: {_fault(schema, e)}" for e in error.errors()]
        raise InputError(f"{source}: {len(faults)} fault(s)\n" + "\n".join(faults)) from None


def _key(location: tuple[int | str, ...]) -> str:
    text = "".join(f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in location)
    return text.lstrip(".") or "file"


def _fault(schema: type[BaseModel], error: Any) -> str:
    given = error["input"]
    shown = "" if isinstance(given, dict) else f" (given: {given!r})"
    if error["type"] == "extra_forbidden":
        table = schema if len(error["loc"]) == 1 else _table(schema, error["loc"][:-1])
        return (
            f"not a known key; allowed: {', '.join(table.model_fields)} (lengths with _mm or _m, angles _deg or _rad)"
        )
    if error["type"] == "missing":
        return "is missing"
    return f"{error['msg']}{shown}"


def _table(schema: type[BaseModel], location: tuple[int | str, ...]) -> type[BaseModel]:
    """The schema of the table at a location."""
    for part in location:
        if isinstance(part, str) and part in schema.model_fields:
            inner = schema.model_fields[part].annotation
            candidates = [inner, *getattr(inner, "__args__", ())]
            schema = next((c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel)), schema)
    return schema


def write_robot(robot: Robot, path: str | Path, comment: str = "") -> None:
    """Write a robot as TOML that `read_robot` reads again; the file appears whole or not at all."""
    write_whole(Path(path), to_toml(robot, comment))


def to_toml(robot: Robot, comment: str = "") -> str:
    """The robot as the text of a TOML file, in millimetres and degrees at full precision.

    Raises InputError if it holds effects, for which a robot file has no place.
    """
    if robot.effects:
        raise InputError("a robot with effects cannot be written as a robot file; write the base robot")
    document = tomlkit.document()
    for line in comment.splitlines():
        document.add(tomlkit.comment(line))
    document.add("casadical", tomlkit.item(1))
    document.add("name", tomlkit.item(robot.name))
    if robot.notes:
        document.add("notes", tomlkit.item(list(robot.notes)))
    document.add("base", tomlkit.item(_frame_table(robot.base)))
    document.add("tool", tomlkit.item(_frame_table(robot.tool)))
    document.add(
        "gravity", tomlkit.item({"frame": robot.gravity_frame, "vector_m_per_s2": [float(g) for g in robot.gravity]})
    )
    if robot.payload:
        document.add("payload", tomlkit.item(_body_table(robot.payload)))
    document.add("width", tomlkit.item(_width_tables(robot)))
    rows = tomlkit.aot()
    for joint in robot.joints:
        rows.append(tomlkit.item(_joint_table(joint)))
    document.add("joint", rows)
    if robot.loops:
        loops = tomlkit.aot()
        for loop in robot.loops:
            loops.append(tomlkit.item(_loop_table(loop)))
        document.add("four_bar", loops)
    return tomlkit.dumps(document)


def _mm(value: float) -> float:
    return float(value * 1e3)


def _deg(value: float) -> float:
    return float(np.rad2deg(value))


def _frame_table(placement: Placement) -> dict[str, Any]:
    return {
        "xyz_mm": [_mm(v) for v in placement.T[:3, 3]],
        "rpy_deg": [_deg(v) for v in to_rpy(placement.T[:3, :3])],
        "unknown": placement.unknown,
    }


def _body_table(body: Body) -> dict[str, Any]:
    return {"mass_kg": float(body.mass), "com_mm": [_mm(v) for v in body.com]}


def _joint_table(joint: Joint) -> dict[str, Any]:
    table: dict[str, Any] = {"alpha_deg": _deg(joint.alpha), "a_mm": _mm(joint.a)}
    if joint.beta is not None:
        table["beta_deg"] = _deg(joint.beta)
    if joint.b is not None:
        table["b_mm"] = _mm(joint.b)
    table |= {"theta_deg": _deg(joint.theta), "d_mm": _mm(joint.d)}
    if joint.kind == "prismatic":
        table |= {"type": "prismatic", "limits_mm": [_mm(joint.lower), _mm(joint.upper)]}
    else:
        table["limits_deg"] = [_deg(joint.lower), _deg(joint.upper)]
    if joint.compliance is not None:
        table["compliant"] = True
        if joint.compliance > 0:
            table["stiffness_Nm_per_rad"] = float(1 / joint.compliance)
    if joint.body:
        table["body"] = _body_table(joint.body)
    return table


def _loop_table(loop: FourBar) -> dict[str, Any]:
    return {
        "driven": loop.driven,
        "carrier": loop.carrier,
        "crank_mm": _mm(loop.crank),
        "coupler_mm": _mm(loop.coupler),
        "rocker_mm": _mm(loop.rocker),
        "offset_deg": _deg(loop.offset),
    }


def _width_tables(robot: Robot) -> dict[str, Any]:
    return {
        group: {
            "length_bound_mm": _mm(w.length_bound),
            "angle_bound_deg": _deg(w.angle_bound),
            "length_prior_mm": _mm(w.length_prior),
            "angle_prior_deg": _deg(w.angle_prior),
        }
        for group, w in robot.widths.items()
        if w != WIDTHS[group]
    }

"""A robot as a TOML file: read with units in its keys, checked key by key, written again after calibration.

Lengths, angles and masses carry their unit in the key (`a_mm`, `alpha_deg`, `mass_kg`); millimetres or metres, degrees
or radians are taken by name. See docs/robot-file.md for every key.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tomlkit
from pydantic import AfterValidator, Field, model_validator

from casadical import __version__
from casadical.core.arm import STANDARD_GRAVITY
from casadical.core.arrays import Array
from casadical.core.errors import InputError, shown
from casadical.core.files import write_whole
from casadical.core.parts import WIDTHS, Body, BodyWidth, Coupling, FourBar, Joint, Placement, Target, Width
from casadical.core.schema import (
    ANGLE,
    LENGTH,
    READING,
    Angle,
    FaultError,
    Length,
    Pair,
    TomlTable,
    Triple,
    check,
    load_toml,
)
from casadical.core.transforms import frame, from_rpy
from casadical.effects import Effect, Session, find_effect
from casadical.robot.effect_tables import BoundTable, CovarianceTable, EffectTable, LearntTable, knowledge_of, text_of
from casadical.robot.error_bound import refuse_other
from casadical.robot.robot import Robot
from casadical.robot.robot_tables import body_table, frame_table, joint_table, loop_table, tool_tables, width_tables

Bar = Annotated[float, LENGTH, Field(gt=0)]
# Of the newest files that are read; from 2 on with effects and what is known of their values.
VERSION = 2


def _stiff(value: float | None) -> float | None:
    if value is not None and value < 1:
        raise ValueError("must be at least 1; leave it out for a joint of unknown stiffness")
    return value


Stiffness = Annotated[float | None, Field(gt=0, le=1e15), AfterValidator(_stiff)]
HalfLength = Annotated[float | None, LENGTH, Field(gt=0)]
HalfAngle = Annotated[float | None, ANGLE, Field(gt=0)]


class _Body(TomlTable):
    mass_kg: float = Field(ge=0, le=1e6)
    com: Annotated[Triple, LENGTH] = Field(default=[0.0, 0.0, 0.0])

    def body(self) -> Body:
        return Body(self.mass_kg, np.array(self.com))


class _Joint(TomlTable):
    alpha: Angle = 0.0
    a: Length = 0.0
    theta: Angle = 0.0
    d: Length = 0.0
    beta: Annotated[float | None, ANGLE] = None
    b: Annotated[float | None, LENGTH] = None
    type: Literal["revolute", "prismatic"] = "revolute"
    limits: Annotated[Pair | None, READING] = None
    compliant: bool = False
    stiffness_Nm_per_rad: Stiffness = None
    stiffness_N_per_m: Stiffness = None
    body: _Body | None = None
    follows: list[tuple[int, float]] = Field(default=[])
    at: Annotated[float | None, READING] = None

    @model_validator(mode="before")
    @classmethod
    def _pairs(cls, data: Any) -> Any:
        """Pairs are arrays in TOML, and a factor may be whole."""

        def pair(given: Any) -> Any:
            if not isinstance(given, list) or len(given) != 2:
                return given
            joint, factor = given
            return (joint, float(factor) if type(factor) is int else factor)

        listed = data.get("follows") if isinstance(data, dict) else None
        return {**data, "follows": [pair(given) for given in listed]} if isinstance(listed, list) else data

    @model_validator(mode="before")
    @classmethod
    def _own_units(cls, data: Any) -> Any:
        """A revolute joint's range and stiffness are angular, a prismatic one's are not."""
        if not isinstance(data, dict):
            return data
        kind, foreign = data.get("type", "revolute"), [f"limits{u}" for u in LENGTH.factors]
        foreign, own = [*foreign, "stiffness_N_per_m"], "limits_deg, stiffness_Nm_per_rad"
        if kind == "prismatic":
            foreign, own = (
                [*(f"limits{u}" for u in ANGLE.factors), "stiffness_Nm_per_rad"],
                "limits_mm, stiffness_N_per_m",
            )
        wrong = [key for key in foreign if key in data]
        if wrong:
            raise FaultError(wrong[0], f"not for a {kind} joint; allowed: {own}")
        return data

    @model_validator(mode="after")
    def _consistent(self) -> _Joint:
        if self.limits and self.limits[0] >= self.limits[1]:
            raise FaultError("limits", "the lower one must come first")
        if self.b is not None and self.beta is None:
            raise FaultError("b", "stands in row 1 beside beta only, where six numbers are the base frame; give both")
        return self

    def joint(self) -> Joint:
        default = (-2 * np.pi, 2 * np.pi) if self.type == "revolute" else (-10.0, 10.0)
        lower, upper = self.limits or default
        stiffness = self.stiffness_Nm_per_rad or self.stiffness_N_per_m
        compliance = 1 / stiffness if stiffness else 0.0 if self.compliant else None
        return Joint(
            self.alpha, self.a, self.theta, self.d, self.beta, self.b, self.type, lower, upper, compliance,
            self.body.body() if self.body else None,
            Coupling(tuple(self.follows), self.at or 0.0) if self.follows or self.at is not None else None,
        )  # fmt: skip


class _Frame(TomlTable):
    xyz: Annotated[Triple, LENGTH] = Field(default=[0.0, 0.0, 0.0])
    rpy: Annotated[Triple, ANGLE] = Field(default=[0.0, 0.0, 0.0])
    unknown: Literal["none", "position", "pose"] = "none"

    def placement(self) -> Placement:
        return Placement(frame(from_rpy(np.array(self.rpy)), np.array(self.xyz)), self.unknown)


class ToolTable(_Frame):
    """One of several [[tool]]."""

    name: str = ""


class _FourBar(TomlTable):
    driven: int
    carrier: int
    crank: Bar
    coupler: Bar
    rocker: Bar
    offset: Angle = 0.0


class _Gravity(TomlTable):
    frame: Literal["measuring", "base", "logged"] = "measuring"
    vector_m_per_s2: Triple = Field(default=[0.0, 0.0, -STANDARD_GRAVITY])


class _Width(TomlTable):
    length_bound: HalfLength = None
    angle_bound: HalfAngle = None
    length_prior: HalfLength = None
    angle_prior: HalfAngle = None


class _BodyWidth(TomlTable):
    mass_share: float = Field(default=BodyWidth().share, ge=0)
    com: Annotated[float, LENGTH, Field(ge=0)] = BodyWidth().centre


class _Widths(TomlTable):
    base: _Width = _Width()
    geometry: _Width = _Width()
    loop: _Width = _Width()
    tool: _Width = _Width()
    compliance: _Width = _Width()
    body: _BodyWidth = _BodyWidth()

    def widths(self) -> dict[str, Width]:
        given = {group: getattr(self, group).model_dump(exclude_none=True) for group in WIDTHS}
        return {group: replace(default, **given[group]) for group, default in WIDTHS.items()}


class _RobotFile(TomlTable):
    casadical: Literal[1, 2]
    written_by: str = ""
    name: str = Field(min_length=1)
    convention: Literal["modified", "standard"] = "modified"
    notes: list[str] = Field(default=[])
    masses: Literal["declared", "estimated"] = "declared"
    base: _Frame = _Frame()
    tool: _Frame = _Frame()
    tool_name: str = ""
    further_tool: list[ToolTable] = Field(default=[])
    gravity: _Gravity = _Gravity()
    payload: _Body | None = None
    joint: list[_Joint] = Field(min_length=1)
    four_bar: list[_FourBar] = Field(default=[])
    width: _Widths = _Widths()
    effect: list[EffectTable] = Field(default=[])
    learnt: LearntTable = LearntTable()
    covariance: list[CovarianceTable] = Field(default=[])
    bound: BoundTable | None = None

    @model_validator(mode="after")
    def _rows(self) -> _RobotFile:
        for key in ("effect", "learnt", "covariance", "bound"):
            if self.casadical == 1 and key in self.model_fields_set:
                raise FaultError(key, "belongs to files of version 2; write casadical = 2")
        for i, row in enumerate(self.joint):
            if row.beta is not None and self.convention == "standard":
                raise FaultError(
                    ("joint", i, "beta"), "belongs to modified rows; into standard ones it is put by itself"
                )
            if row.b is not None and i > 0:
                raise FaultError(("joint", i, "b"), "stands in row 1 only, where six numbers are the base frame")
        return self

    def robot(self, own: Sequence[type[Effect]]) -> Robot:
        joints = [row.joint() for row in self.joint]
        tool = self.tool.placement()
        points = [np.array(further.xyz) for further in self.further_tool]
        payload = self.payload.body() if self.payload else None
        if self.convention == "standard":
            joints, flange = _from_standard(joints)
            tool = replace(tool, T=flange @ tool.T)
            points = [flange[:3, :3] @ point + flange[:3, 3] for point in points]
            payload = payload and _moved(payload, flange)
        effects, values, errors = self._effects(own)
        robot = Robot(
            name=self.name,
            joints=tuple(joints),
            base=self.base.placement(),
            tool=tool,
            loops=tuple(FourBar(**loop.model_dump()) for loop in self.four_bar),
            gravity=np.array(self.gravity.vector_m_per_s2),
            gravity_frame=self.gravity.frame,
            payload=payload,
            widths=self.width.widths(),
            body_width=BodyWidth(self.width.body.mass_share, self.width.body.com),
            tool_name=self.tool_name,
            targets=tuple(Target(f.name, point) for f, point in zip(self.further_tool, points, strict=True)),
            masses=self.masses,
            effects=effects,
            effect_values=values,
            notes=tuple(self.notes),
        )
        names = robot.parameters.names
        known = knowledge_of(robot, names, self.learnt, self.covariance, errors)
        bound = self.bound.bound() if self.bound else None
        if bound:
            refuse_other(robot, bound)
        return replace(robot, knowledge=known, bound=bound)

    def _effects(self, own: Sequence[type[Effect]]) -> tuple[tuple[Effect, ...], dict[str, float], dict[str, float]]:
        """Effects, values and standard errors of their parameters. Raises InputError by key."""
        effects, values, errors = [], {}, {}
        for k, table in enumerate(self.effect, 1):
            try:
                effect = table.effect(own)
            except InputError as error:
                raise InputError(f"effect[{k}].{error}") from None
            effects.append(effect)
            for name, given in table.values.items():
                values[f"{effect.label}.{name}"] = given.value
                if given.std_error is not None:
                    errors[f"{effect.label}.{name}"] = given.std_error
        return tuple(effects), values, errors


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


def read_robot(path: str | Path, effects: Sequence[type[Effect]] = ()) -> Robot:
    """A robot from its TOML file, with its effects and what is known of their values.

    Parameters
    ----------
    path : str | Path
        robot file
    effects : Sequence[type[Effect]], default ()
        classes of your own, besides those that are installed (see `casadical.effects.find_effect`); a file runs no
        other code

    Returns
    -------
    Robot
        the nominal robot, or a calibrated one, effects and what is known of their values included

    Raises
    ------
    InputError
        a file that is no robot; it names the file, the key, the value and what is allowed

    Examples
    --------
    >>> arm = casadical.read_robot("problems/planar/robot.toml")
    >>> arm.n, arm.name
    (2, 'Planar arm of two links')
    """
    path = Path(path)
    return robot_from(load_toml(path), path.name, effects)


def robot_from(data: Mapping[str, Any], source: str, effects: Sequence[type[Effect]] = ()) -> Robot:
    """A robot from the tables of a TOML file; `source` names it in messages. Raises InputError."""
    version = data.get("casadical")
    if isinstance(version, int) and version > VERSION:
        raise InputError(
            f"{source}: casadical = {version}: a file of version {version}, written by "
            f"{data.get('written_by', 'a newer casadical')}; this is casadical {__version__}, which reads files up to "
            f"version {VERSION}: install the newer one"
        )
    file = check(_RobotFile, _with_tools_apart(data), source)
    try:
        return file.robot(effects)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


def _with_tools_apart(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Of several [[tool]] the first under `tool`, the others under a key of their own."""
    tools = data.get("tool")
    if not isinstance(tools, list) or not tools or not all(isinstance(t, dict) for t in tools):
        return data
    first = {key: value for key, value in tools[0].items() if key != "name"}
    return {**data, "tool": first, "tool_name": tools[0].get("name", ""), "further_tool": tools[1:]}


def with_tools(robot: Robot, tools: Sequence[ToolTable]) -> Robot:
    """The robot with these measured points in place of its tool, given in the tool's frame. Raises InputError.

    What is unknown of them is what was unknown of the tool, unless the first says so.
    """
    first, *further = tools
    T = robot.tool.T
    targets = tuple(Target(t.name, T[:3, :3] @ np.array(t.xyz) + T[:3, 3]) for t in further)
    unknown = first.unknown if "unknown" in first.model_fields_set else robot.tool.unknown
    tool = Placement(T @ first.placement().T, unknown)
    return replace(robot, tool=tool, tool_name=first.name if further else "", targets=targets)


def write_robot(robot: Robot, path: str | Path, comment: str = "", effects: Sequence[type[Effect]] = ()) -> None:
    """Write a robot as TOML that `read_robot` reads again; the file appears whole or not at all.

    Parameters
    ----------
    robot : Robot
        the robot
    path : str | Path
        file to write; one that is there is replaced
    comment : str, default ""
        text of the comment at the file's head
    effects : Sequence[type[Effect]], default ()
        classes of your own, as of `read_robot`

    Raises
    ------
    InputError
        an effect that is not installed, and so could not be read again

    Examples
    --------
    >>> casadical.write_robot(found.robot, "calibrated.toml", "after the crash of May")
    >>> bool(casadical.read_robot("calibrated.toml").parameters["a1"].value == found.robot.parameters["a1"].value)
    True
    """
    write_whole(Path(path), to_toml(robot, comment, effects))


def to_toml(robot: Robot, comment: str = "", effects: Sequence[type[Effect]] = ()) -> str:
    """The robot as the text of a TOML file, in millimetres and degrees at full precision; effects in SI.

    Sessions belong to their measurements: base and tool are those of the first one.

    effects and errors as of `write_robot` (Raises InputError). Without effects and bound it is version 1.
    """
    if any(isinstance(e, Session) for e in robot.effects):
        robot = robot.with_only(e for e in robot.effects if not isinstance(e, Session))
    for effect in robot.effects:
        if find_effect(effect.name, effects) is not type(effect):
            raise InputError(f"{effect.label}: another effect of this name is installed; rename yours")
    more = bool(robot.effects or robot.knowledge or robot.bound)
    document = tomlkit.document()
    for line in comment.splitlines():
        document.add(tomlkit.comment(shown(line)))
    tables = {
        "casadical": 2 if more else 1,
        "written_by": f"casadical {__version__}" if more else None,
        "name": robot.name,
        "notes": list(robot.notes) or None,
        "masses": robot.masses if robot.masses != "declared" else None,
        "base": frame_table(robot.base),
        "tool": tool_tables(robot) if robot.targets else frame_table(robot.tool),
        "gravity": {"frame": robot.gravity_frame, "vector_m_per_s2": [float(g) for g in robot.gravity]},
        "payload": body_table(robot.payload) if robot.payload else None,
        "width": width_tables(robot),
        "joint": [joint_table(joint) for joint in robot.joints],
        "four_bar": [loop_table(loop) for loop in robot.loops] or None,
    }
    document.update({key: value for key, value in tables.items() if value is not None})
    text = tomlkit.dumps(document)
    if not more:
        return _readable(text, robot)
    known = robot.knowledge
    if known:  # of parameters that it had before a change, nothing is kept
        known = known.without(set(known.std_errors) - set(robot.parameters.names))
    return _readable(
        "\n".join([text.rstrip("\n"), *text_of(robot, robot.effects, robot.effect_values, known, robot.bound), ""]),
        robot,
    )


def _readable(text: str, robot: Robot) -> str:
    """The text, if its values are ones that a file may hold. Raises InputError."""
    check(_RobotFile, _with_tools_apart(tomllib.loads(text)), f"robot {shown(robot.name)!r} cannot be written")
    return text

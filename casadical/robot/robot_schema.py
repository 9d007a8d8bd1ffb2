"""The schema of a robot file, key by key with its unit, and the robot that a file describes.

Lengths, angles and masses have their unit in the key (`a_mm`, `alpha_deg`, `mass_kg`); millimetres
or metres, degrees or radians are chosen by name. See docs/robot-file.md for every key.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from casadical.core import parts
from casadical.core.basics import Array, InputError
from casadical.core.drive import Drive
from casadical.core.parts import STANDARD_GRAVITY
from casadical.core.reading import MAX_ITEMS
from casadical.core.schema import (
    ANGLE,
    LENGTH,
    READING,
    WHOLE_NUMBER,
    Angle,
    FaultError,
    Length,
    Pair,
    TomlTable,
    Triple,
)
from casadical.core.transforms import frame, from_rpy
from casadical.effects import Effect
from casadical.effects.definition import Definition
from casadical.robot import effect_tables
from casadical.robot.kinematics import assembly_sides
from casadical.robot.robot import Robot, with_joint_harmonics

# Maximum number of joints, and of four-bars, in a robot file or a URDF chain.
MAX_JOINTS = 100

# A positive length [m].
Bar = Annotated[float, LENGTH, Field(gt=0)]


def _stiff(value: float | None) -> float | None:
    """Return a stiffness `value` unchanged. Raises ValueError below 1 N m/rad or N/m."""
    if value is not None and value < 1:
        raise ValueError("must be at least 1; leave it out for a joint of unknown stiffness")
    return value


# A stiffness, 1 to 1e15 [N m/rad or N/m], or None.
Stiffness = Annotated[float | None, Field(gt=0, le=1e15), AfterValidator(_stiff)]
# A name in Unicode's composed form, as the names of a table are.
Spelt = Annotated[str, AfterValidator(partial(unicodedata.normalize, "NFC"))]
# Half width of a length's bounds, or prior standard deviation of a length, positive [m], or None.
HalfLength = Annotated[float | None, LENGTH, Field(gt=0)]
# Half width of an angle's bounds, or prior standard deviation of an angle, positive [rad], or None.
HalfAngle = Annotated[float | None, ANGLE, Field(gt=0)]


class _Body(TomlTable):
    """A body or payload in a file; com in the frame of its link, flange or tool [m]."""

    mass_kg: float = Field(ge=0, le=1e6)
    com: Annotated[Triple, LENGTH] = Field(default=[0.0, 0.0, 0.0])
    inertia_kgm2: Annotated[list[float] | None, Field(min_length=6, max_length=6)] = None

    @model_validator(mode="after")
    def _possible(self) -> _Body:
        """Refuse moments of inertia that no body has."""
        if self.inertia_kgm2 is not None and not parts.possible_inertia(_moments(self.inertia_kgm2)):
            allowed = "ixx, ixy, ixz, iyy, iyz, izz, no principal moment greater than the other two together"
            raise FaultError("inertia_kgm2", f"no body has such moments; allowed: {allowed}")
        return self

    def body(self) -> parts.Body:
        """Return the body of the table: mass [kg], mass centre [m], inertia [kg m^2] or None."""
        inertia = None if self.inertia_kgm2 is None else _moments(self.inertia_kgm2)
        return parts.Body(self.mass_kg, np.array(self.com), inertia)


def _moments(six: list[float]) -> Array:
    """Return the inertia matrix, shape (3, 3), of ixx, ixy, ixz, iyy, iyz, izz [kg m^2]."""
    xx, xy, xz, yy, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


class ReadingsTable(TomlTable):
    """How the variable of a joint's row follows from the controller's readings.

    name : of the joint
    """

    readings: list[tuple[int, float]] = Field(default=[])
    offset: Annotated[float, READING] = 0.0
    name: str = ""

    @model_validator(mode="before")
    @classmethod
    def _pairs(cls, data: Any) -> Any:
        """Convert arrays [joint, factor] of `follows` and `readings` to tuples, factors to floats."""

        def pair(given: Any) -> Any:
            """Return the tuple (joint, factor) for an array of two, or anything else unchanged."""
            if not isinstance(given, list) or len(given) != 2:
                return given
            joint, factor = given
            return (joint, float(factor) if type(factor) is int else factor)

        if not isinstance(data, dict):
            return data
        listed = {key: data[key] for key in ("follows", "readings") if isinstance(data.get(key), list)}
        return {**data, **{key: [pair(given) for given in pairs] for key, pairs in listed.items()}}

    @model_validator(mode="after")
    def _whole(self) -> Self:
        """Refuse an offset that is added to nothing."""
        if self.offset and not self.readings:
            raise FaultError("offset", "belongs to `readings`, of which the row's variable is made; give both")
        return self

    def made_of(self) -> parts.Coupling | None:
        """Return how the row's variable follows from the readings; None: it is its own reading."""
        return parts.Coupling(tuple(self.readings), self.offset) if self.readings else None


class _Joint(ReadingsTable):
    """A joint with its row in a file [m, rad]; see `parts.Joint`."""

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
    def _own_units(cls, data: Any) -> Any:
        """Refuse limits and stiffness in the units of the other kind of joint."""
        if not isinstance(data, dict):
            return data
        kind = data.get("type", "revolute")
        units, stiffness, own = LENGTH, "stiffness_N_per_m", "limits_deg, stiffness_Nm_per_rad"
        if kind == "prismatic":
            units, stiffness, own = ANGLE, "stiffness_Nm_per_rad", "limits_mm, stiffness_N_per_m"
        wrong = [key for key in (*(f"limits{u}" for u in units.factors), stiffness) if key in data]
        if wrong:
            raise FaultError(wrong[0], f"not for a {kind} joint; allowed: {own}")
        return data

    @model_validator(mode="after")
    def _consistent(self) -> _Joint:
        """Refuse limits in the wrong order, a stiffness with compliant = false, b without beta."""
        if self.limits and self.limits[0] >= self.limits[1]:
            raise FaultError("limits", "the lower one must come first")
        stiffness = self.stiffness_Nm_per_rad or self.stiffness_N_per_m
        if stiffness and not self.compliant and "compliant" in self.model_fields_set:
            raise FaultError("compliant", "a joint with a stiffness is compliant; leave one of the two out")
        if self.b is not None and self.beta is None:
            raise FaultError("b", "stands in row 1 beside beta only, where six numbers are the base frame; give both")
        return self

    def joint(self) -> parts.Joint:
        """Return the joint that the table describes [SI], with default limits +-2 pi or +-10 m.

        Compliant without a stiffness it has the nominal compliance 0.
        """
        default = (-2 * np.pi, 2 * np.pi) if self.type == "revolute" else (-10.0, 10.0)
        lower, upper = self.limits or default
        stiffness = self.stiffness_Nm_per_rad or self.stiffness_N_per_m
        compliance = 1 / stiffness if stiffness else 0.0 if self.compliant else None
        return parts.Joint(
            self.alpha,
            self.a,
            self.theta,
            self.d,
            self.beta,
            self.b,
            self.type,
            lower,
            upper,
            compliance,
            self.body.body() if self.body else None,
            parts.Coupling(tuple(self.follows), self.at or 0.0) if self.follows or self.at is not None else None,
            self.name,
            readings=self.made_of(),
        )


class _Frame(TomlTable):
    """A base or tool frame in a file, xyz [m] and rpy [rad], and what of it is unknown."""

    xyz: Annotated[Triple, LENGTH] = Field(default=[0.0, 0.0, 0.0])
    rpy: Annotated[Triple, ANGLE] = Field(default=[0.0, 0.0, 0.0])
    unknown: Literal["none", "position", "pose"] = "none"

    def placement(self) -> parts.Placement:
        """Return the base or tool frame that the table describes, and what of it is unknown."""
        return parts.Placement(frame(from_rpy(np.array(self.rpy)), np.array(self.xyz)), self.unknown)


class ToolTable(_Frame):
    """One of several [[tool]] tables, with the name of the measured point."""

    name: Spelt = ""


class _FourBar(TomlTable):
    """A four-bar in a file [m, rad]; see `parts.FourBar`."""

    driven: int
    carrier: int
    crank: Bar
    coupler: Bar
    rocker: Bar
    offset: Angle = 0.0


class _Gravity(TomlTable):
    """Gravity in a file: its vector, and the frame of the vector."""

    frame: Literal["measuring", "base", "logged"] = "measuring"
    vector_m_per_s2: Triple = Field(default=[0.0, 0.0, -STANDARD_GRAVITY])

    @model_validator(mode="after")
    def _possible(self) -> _Gravity:
        """Refuse gravity that is too large, as in another unit."""
        if np.linalg.norm(self.vector_m_per_s2) > 30.0:
            allowed = f"at most 30 m/s2, on Earth {STANDARD_GRAVITY:.3g}"
            raise FaultError("vector_m_per_s2", f"no planet has that; allowed: {allowed}")
        return self


class _Width(TomlTable):
    """Bounds and priors of one group of parameters in a file."""

    length_bound: HalfLength = None
    angle_bound: HalfAngle = None
    length_prior: HalfLength = None
    angle_prior: HalfAngle = None


class _Widths(TomlTable):
    """Bounds and priors of all groups in a file."""

    base: _Width = _Width()
    geometry: _Width = _Width()
    loop: _Width = _Width()
    tool: _Width = _Width()
    compliance: _Width = _Width()
    body: parts.BodyWidth = parts.BodyWidth()

    def widths(self) -> dict[str, parts.Width]:
        """Return group of parameters -> its bounds and priors, the default ones where not given."""
        given = {group: getattr(self, group).model_dump(exclude_none=True) for group in parts.WIDTHS}
        return {group: replace(default, **given[group]) for group, default in parts.WIDTHS.items()}


class RobotTables(TomlTable):
    """Tables of a robot file that problem.toml may have, too, as a URDF has no place for them."""

    masses: Literal["declared", "estimated"] = "declared"
    gravity: _Gravity = _Gravity()
    payload: _Body | None = None
    drive: Drive | None = None
    width: _Widths = _Widths()

    def added_to(self, robot: Robot) -> Robot:
        """Return a robot, as of `read_urdf`, with what the tables declare; the rest stays.

        The gravity vector is in the measuring frame, the payload in the tool frame.
        """
        given, R = self.model_fields_set, robot.base.T[:3, :3]
        made: dict[str, Any] = {name: getattr(self, name) for name in ("masses", "drive") if name in given}
        if "gravity" in given:
            own, frame = robot.gravity, self.gravity.frame
            if "vector_m_per_s2" in self.gravity.model_fields_set:
                own = R.T @ np.array(self.gravity.vector_m_per_s2)
            made |= {"gravity": R @ own if frame == "measuring" else own, "gravity_frame": frame}
        if self.payload is not None:
            made["payload"] = self.payload.body().moved(robot.tool.T)
        if "width" in given:
            made |= {"widths": self.width.widths(), "body_width": self.width.body}
        return replace(robot, **made)


class RobotFile(RobotTables):
    """The schema of a robot file; values are in SI units when it is read."""

    casadical: Annotated[Literal[1, 2], WHOLE_NUMBER]
    written_by: str = ""
    name: str = Field(min_length=1)
    convention: Literal["modified", "standard"] = "modified"
    notes: list[str] = Field(default=[])
    base: _Frame = _Frame()
    tool: _Frame = _Frame()
    tool_name: Spelt = ""
    further_tool: list[ToolTable] = Field(default=[], max_length=MAX_ITEMS)
    joint: list[_Joint] = Field(min_length=1, max_length=MAX_JOINTS)
    four_bar: list[_FourBar] = Field(default=[], max_length=MAX_JOINTS)
    definition: list[Definition] = Field(default=[], max_length=MAX_ITEMS)
    effect: list[effect_tables.EffectTable] = Field(default=[], max_length=MAX_ITEMS)
    learnt: effect_tables.LearntTable = effect_tables.LearntTable()
    covariance: list[effect_tables.CovarianceTable] = Field(default=[])
    remaining: effect_tables.RemainingTable | None = None

    @model_validator(mode="after")
    def _rows(self) -> RobotFile:
        """Refuse contradictions between tables: version, convention, joint names, drive data.

        Twists that look like radians under a key of degrees are refused, too.
        """
        for key in ("definition", "effect", "learnt", "covariance", "remaining"):
            if self.casadical == 1 and key in self.model_fields_set:
                raise FaultError(key, "belongs to files of version 2; write casadical = 2")
        for i, row in enumerate(self.joint):
            if row.beta is not None and self.convention == "standard":
                raise FaultError(
                    ("joint", i, "beta"), "belongs to modified rows; into standard ones it is put by itself"
                )
            if row.b is not None and i > 0:
                raise FaultError(("joint", i, "b"), "stands in row 1 only, where six numbers are the base frame")
        names = [row.name for row in self.joint if row.name]
        for i in (i for i, row in enumerate(self.joint) if names.count(row.name) > 1):
            raise FaultError(("joint", i, "name"), "another joint has this name; each needs one of its own")
        twists = np.array([abs(row.alpha) for row in self.joint])
        # The twists [rad] of a right or a straight angle in radians that is read as degrees.
        twists_read_as_degrees = np.deg2rad([np.pi / 2, np.pi])
        # Twists that differ by less than this [rad] from these are refused.
        twist_tolerance = np.deg2rad(1e-3)
        in_radians = np.flatnonzero((np.abs(twists[:, None] - twists_read_as_degrees) < twist_tolerance).any(axis=1))
        if (
            len(in_radians) > 1 and (twists < twists_read_as_degrees[1] + twist_tolerance).all()
        ):  # a single one may be a coincidence
            raise FaultError(("joint", int(in_radians[0]), "alpha"), "looks like radians; write them as alpha_rad")
        if self.drive:
            self.drive.refuse_other(len(self.joint))
        return self

    def robot(self, own: Sequence[type[Effect]], folder: Path) -> Robot:
        """Return the robot that the file describes.

        own : classes of effects in addition to the installed ones; folder : of the file
        Raises InputError for values that do not fit each other.
        """
        joints = [row.joint() for row in self.joint]
        tool = self.tool.placement()
        points = [np.array(further.xyz) for further in self.further_tool]
        payload = self.payload.body() if self.payload else None
        if self.convention == "standard":
            joints, flange = _from_standard(joints)
            tool = replace(tool, T=flange @ tool.T)
            points = [flange[:3, :3] @ point + flange[:3, 3] for point in points]
            payload = payload and payload.moved(flange)
        effects, values, errors = effect_tables.effects_of(self.effect, self.definition, own)
        robot = Robot(
            name=self.name,
            joints=tuple(joints),
            base=self.base.placement(),
            tool=tool,
            loops=tuple(parts.FourBar(**loop.model_dump()) for loop in self.four_bar),
            gravity=np.array(self.gravity.vector_m_per_s2),
            gravity_frame=self.gravity.frame,
            payload=payload,
            widths=self.width.widths(),
            body_width=self.width.body,
            tool_name=self.tool_name,
            targets=tuple(parts.Target(f.name, point) for f, point in zip(self.further_tool, points, strict=True)),
            masses=self.masses,
            drive=self.drive,
            effects=effects,
            effect_values=values,
            notes=tuple(self.notes),
        )
        names = robot.parameters.names
        knowledge = effect_tables.knowledge_of(robot, names, self.learnt, self.covariance, errors, folder)
        remaining = self.remaining.errors() if self.remaining else None
        if remaining:
            allowed = with_joint_harmonics(robot).parameters.names
            for name in (n for n in remaining.names if n not in allowed):
                raise InputError(f"remaining: no parameter {name!r}; there are {', '.join(allowed)}")
        robot = replace(robot, knowledge=knowledge, remaining=remaining)
        if effects:
            _refuse_undefined(robot)
        assembly_sides(robot)  # raises InputError for a loop that does not close
        if far := far_centre(robot):
            number, words = far
            raise InputError(f"joint[{number}].body.com: {words}. Is it in the unit that the key says?")
        return robot


def far_centre(robot: Robot) -> tuple[int, str] | None:
    """Return the first joint, from 1, whose mass centre is too far away, and how far in words.

    Too far from its frame's origin is more than twice the arm's reach plus 1 m, as for one in the
    wrong unit. None is returned where none is too far.
    """
    most = 2 * robot.reach + 1.0
    for i, joint in enumerate(robot.joints, 1):
        away = float(np.linalg.norm(joint.body.com)) if joint.body else 0.0
        if away > most:
            words = f"{away:.4g} m from the origin of its frame, of an arm that reaches {robot.reach:.4g} m"
            return i, f"{words}; allowed: up to {most:.4g} m"
    return None


def _refuse_undefined(robot: Robot) -> None:
    """Refuse effects that give no finite position at one of two trial poses. Raises InputError."""
    lower, upper = robot.limits
    for share in (0.37, 0.71):
        q = lower + share * (upper - lower)
        try:
            point = np.array(robot.position(q, robot.parameters.values))
        except (ArithmeticError, RuntimeError, IndexError) as error:
            why = str(error).splitlines()[-1]
            raise InputError(f"effect: {robot.effects_in_words}: the model cannot be computed: {why}") from None
        if not np.isfinite(point).all():
            raise InputError(f"effect: {robot.effects_in_words}: no finite position at readings {q.round(3).tolist()}")


def _from_standard(rows: list[parts.Joint]) -> tuple[list[parts.Joint], Array]:
    """Return modified DH rows for standard ones, and the flange frame in the last modified frame.

    That frame, shape (4, 4) [m], is the transform of the last row's a and alpha. Bodies, given in
    the standard frames, are transformed too. Standard: Rot_z(theta) Trans_z(d)
    Trans_x(a) Rot_x(alpha); a row's a and alpha are the next modified row's.
    """
    shifted = [parts.Joint(), *rows[:-1]]
    tails = [frame(from_rpy(np.array([row.alpha, 0.0, 0.0])), np.array([row.a, 0.0, 0.0])) for row in rows]
    joints = [
        replace(row, alpha=before.alpha, a=before.a, body=row.body and row.body.moved(tail))
        for row, before, tail in zip(rows, shifted, tails, strict=True)
    ]
    return joints, tails[-1]

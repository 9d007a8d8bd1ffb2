"""A robot's structure as plain data: joints, bodies, loops, frames, payload, gravity, and priors.

It contains neither a kinematic model nor parameters. It also estimates unknown link masses from the
reach: between light arms (UR10e, Panda: 4 to 7 kg per cubic metre of reach) and heavy ones (KR 210,
HH800: 16 to 19 kg) the moving links weigh 10 kg times the cube of `Arm.reach` [m]; each link
weighs half of the one before, with its mass centre in its middle; the prior standard deviation is
twice the mass. Gravity deflects joints by compliance times torque, so that a common scale of all
masses is equivalent to the joints' stiffness: such masses do not determine the stiffness, but the
deflection.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Literal, TypeVar

import numpy as np
from pydantic import ConfigDict, Field

from casadical.core.basics import Array, InputError
from casadical.core.drive import Drive
from casadical.core.schema import LENGTH, TomlTable

# Smallest angle between consecutive joint axes that are not nearly parallel [rad]; below it the
# parameter beta replaces d.
NEAR_PARALLEL_RAD = np.deg2rad(5.0)


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body in the frame of its link.

    mass : mass of the link or load [kg]
    com : mass centre in the link's frame, shape (3,) [m]
    inertia : inertia matrix about the mass centre, along the axes of the link's frame, shape (3, 3)
        [kg m^2]; None: unknown

    Examples
    --------
    >>> casadical.Body(5.0, np.array([0.2, 0.0, 0.0])).mass
    5.0
    """

    mass: float
    com: Array
    inertia: Array | None = None

    def moved(self, T: Array) -> Body:
        """Return the same body in another frame, in which its present frame has the pose T.

        T : shape (4, 4) [m]
        """
        R = T[:3, :3]
        inertia = None if self.inertia is None else R @ self.inertia @ R.T
        return Body(self.mass, R @ self.com + T[:3, 3], inertia)

    @property
    def likely_inertia(self) -> Array:
        """Return the inertia about the mass centre, shape (3, 3) [kg m^2], estimated if unknown.

        The estimate is isotropic, with a radius of gyration of 0.1 m plus 0.3 times the distance of
        the mass centre from the frame's origin.
        """
        if self.inertia is not None:
            return self.inertia
        return np.asarray(self.mass * (0.1 + 0.3 * np.linalg.norm(self.com)) ** 2 * np.eye(3))

    @staticmethod
    def joined(parts: Sequence[Body]) -> Body:
        """Return one body with the masses of several in the same frame (parallel axis theorem).

        Its inertia is unknown (None) if that of any of them is.
        """
        masses = np.array([part.mass for part in parts])
        com = masses @ np.array([part.com for part in parts]) / masses.sum()
        moments = np.zeros((3, 3))
        for part in parts:
            if part.inertia is None:
                return Body(float(masses.sum()), com)
            arm = part.com - com
            moments += part.inertia + part.mass * ((arm @ arm) * np.eye(3) - np.outer(arm, arm))
        return Body(float(masses.sum()), com, moments)


def possible_inertia(moments: Array) -> bool:
    """Return whether an inertia matrix, shape (3, 3), is physically possible.

    Up to a share of 1e-6, none of its principal moments is negative or above the others' sum.
    """
    smallest, middle, largest = np.linalg.eigvalsh(moments)
    return bool(np.isfinite(largest) and smallest >= -1e-6 * largest and largest <= (1 + 1e-6) * (smallest + middle))


@dataclass(frozen=True)
class Coupling:
    """A value made of joint readings: at + sum of factor * reading.

    follows : (number of a joint, from 1, factor of its reading) for each reading; empty for a
        locked joint
    at : constant term [rad or m]
    """

    follows: tuple[tuple[int, float], ...] = ()
    at: float = 0.0


@dataclass(frozen=True, eq=False)
class Joint:
    """One row of the modified DH table and the joint that it carries; SI units.

    alpha : angle from the axis before to this one, about the x axis of the link before [rad]
    a : length of the link before, along its x axis [m]
    theta : angle about the joint's z axis where the row's variable is zero [rad]
    d : offset along the joint's z axis [m]
    beta : rotation about y where the axes are nearly parallel [rad]; None: d is the parameter there
    b : offset along y where the axes are nearly parallel [m]; None: as of beta
    kind : revolute (the variable is added to theta), or prismatic (it is added to d)
    lower, upper : lower and upper limit of the row's variable [rad or m]
    compliance : compliance of the drive train [rad/(N m) or m/N]; None: rigid
    body : mass properties of the link that the joint moves, in its frame; None: massless
    coupling : how its reading follows from others, for a mimic, passive or locked joint; None
        otherwise
    name : name that tables of measurements may give its readings
    leader : joint outside of the chain that drives it, in a URDF: its name, its kind, the factor of
        its reading and the offset [rad or m]; None: the joint moves by itself
    readings : how the row's variable follows from the controller's readings, where the controller
        counts otherwise than the row; None: it is its own reading

    Examples
    --------
    >>> shoulder = casadical.Joint(a=0.4, lower=-2.0, upper=2.0, compliance=1e-6)
    >>> shoulder.kind, shoulder.a
    ('revolute', 0.4)
    """

    alpha: float = 0.0
    a: float = 0.0
    theta: float = 0.0
    d: float = 0.0
    beta: float | None = None
    b: float | None = None
    kind: Literal["revolute", "prismatic"] = "revolute"
    lower: float = -np.pi
    upper: float = np.pi
    compliance: float | None = None
    body: Body | None = None
    coupling: Coupling | None = None
    name: str = ""
    leader: tuple[str, str, float, float] | None = None
    readings: Coupling | None = None


def refuse_joint(robot: str, i: int, joint: Joint) -> None:
    """Check kind, limits, compliance and mass of a joint, and that numbers are finite.

    robot : name of the robot, for the message; i : number of the joint, from 1. Raises InputError.
    """
    if joint.kind not in ("revolute", "prismatic"):
        raise InputError(f"robot {robot!r}, joint {i}: kind {joint.kind!r}; allowed: revolute, prismatic")
    for name in ("alpha", "a", "theta", "d", "beta", "b", "lower", "upper", "compliance"):
        value = getattr(joint, name)
        if value is not None and not np.isfinite(value):
            raise InputError(f"robot {robot!r}, joint {i}: {name} is {value}; it must be a finite number")
    if joint.lower >= joint.upper:
        raise InputError(
            f"robot {robot!r}, joint {i}: range [{joint.lower:.6g}, {joint.upper:.6g}]; lower must be below upper"
        )
    if joint.compliance is not None and joint.compliance < 0:
        raise InputError(f"robot {robot!r}, joint {i}: compliance {joint.compliance:.6g}; it must be zero or more")
    if joint.body is not None and not joint.body.mass >= 0:
        raise InputError(f"robot {robot!r}, joint {i}: mass {joint.body.mass:.6g} kg; it must be zero or more")


@dataclass(frozen=True)
class FourBar:
    """A closed four-bar loop, by which one joint drives the next.

    The variable of joint `driven` plus its row's theta is the crank's angle in the plane of joint
    `carrier`. The ground bar is the link between the joints (its length is the driven row's a). The
    driven link's angle against it is: direction of the rocker - that of the ground bar + offset.

    driven, carrier : numbers of the two neighbouring joints, from 1
    crank, coupler, rocker : length of the bar [m]
    offset : angle between rocker and driven link [rad]

    Examples
    --------
    >>> casadical.FourBar(driven=3, carrier=2, crank=0.4, coupler=1.2, rocker=0.4)
    FourBar(driven=3, carrier=2, crank=0.4, coupler=1.2, rocker=0.4, offset=0.0)
    """

    driven: int
    carrier: int
    crank: float
    coupler: float
    rocker: float
    offset: float = 0.0


@dataclass(frozen=True, eq=False)
class Placement:
    """The nominal pose of the robot's base or tool frame, and the part of it to identify.

    T : pose, shape (4, 4) [m]: of the base in the measuring frame, or of the tool in the last
        link's frame
    unknown : what is identified: nothing, the position, or position and orientation

    Examples
    --------
    >>> tool = casadical.Placement(np.eye(4), unknown="position")
    >>> tool.unknown
    'position'
    """

    T: Array
    unknown: Literal["none", "position", "pose"] = "none"


@dataclass(frozen=True, eq=False)
class Target:
    """An additional measured point on the flange.

    name : name of the point, as in the column `tool`
    point : its position in the last link's frame, shape (3,) [m]
    """

    name: str
    point: Array

    @property
    def column(self) -> str:
        """Return the name of the column that is 1 where this point was measured, else 0."""
        return f"tool_{self.name}"

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the parameters of its coordinates x, y, z."""
        return tuple(f"{self.column}_{c}" for c in "xyz")


@dataclass(frozen=True)
class Width:
    """Bounds and priors of the deviations of one group of parameters.

    length_bound, angle_bound : largest absolute deviation of a length [m] and of an angle [rad]
    length_prior, angle_prior : prior standard deviation of a length [m] and of an angle [rad]
    """

    length_bound: float
    angle_bound: float
    length_prior: float
    angle_prior: float


# Default bounds and priors of deviations from nominal, by group of parameters.
WIDTHS: Mapping[str, Width] = {
    "base": Width(1.0, np.deg2rad(20), 0.1, 0.05),
    "geometry": Width(0.03, np.deg2rad(6), 0.003, 0.01),
    "loop": Width(0.02, np.deg2rad(6), 0.002, 0.01),
    "tool": Width(0.3, np.deg2rad(30), 0.05, 0.1),
    # For compliance the numbers are deflections under the peak torque of the joint.
    "compliance": Width(0.02, 0.05, 0.001, 0.001),
}


class BodyWidth(TomlTable):
    """Prior standard deviations of the masses and mass centres of links, declared or estimated.

    It is the table [width.body] of a robot file, too.

    mass_share : relative standard deviation of a mass
    com : standard deviation of each coordinate of a mass centre [m]
    """

    model_config = ConfigDict(frozen=True)

    mass_share: float = Field(default=0.2, ge=0)
    com: Annotated[float, LENGTH, Field(ge=0)] = 0.03


class Sessions(TomlTable):
    """Which parameters are identified anew in each session of a campaign (own) or once (shared).

    It is the table [sessions] of problem.toml, too.

    base, tool : parameters of the base's and the tool's frame
    zeros : joint zero offsets
    """

    model_config = ConfigDict(frozen=True)

    base: Literal["own", "shared"] = "own"
    tool: Literal["own", "shared"] = "own"
    zeros: Literal["own", "shared"] = "shared"


def parallel(joints: tuple[Joint, ...], i: int) -> bool:
    """Return whether the axes of the joints of index i and i + 1, from 0, are nearly parallel.

    Opposite directions count as parallel; it is False for the last joint.
    """
    return i + 1 < len(joints) and abs(np.sin(joints[i + 1].alpha)) < np.sin(NEAR_PARALLEL_RAD)


# Standard acceleration of gravity [m/s^2] (ISO 80000-3).
STANDARD_GRAVITY = 9.80665
# Columns of the direction of gravity in the robot's base frame, where it was logged at every pose.
GRAVITY_COLUMNS = ("gravity_x", "gravity_y", "gravity_z")


@dataclass(frozen=True, eq=False)
class Arm:
    """Structure of a serial robot, with closed four-bar loops if it has any (fields as in `Robot`).

    name : name of the robot
    joints : DH rows and joints in their order
    base : pose of the base in the measuring frame; tool : pose of the tool in the last link's frame
    loops : four-bars
    gravity : acceleration of gravity, shape (3,) [m/s^2], in the frame `gravity_frame`
    gravity_frame : measuring frame, base frame, or "logged": then the norm of `gravity` applies to
        the logged directions, and poses without one have this vector in the base frame
    payload : declared payload in the last link's frame; poses may have another mass (column
        payload_kg)
    widths : bounds and priors of deviations, by group of parameters
    body_width : prior standard deviations of the links' masses and mass centres
    tool_name : name of the tool's measured point; targets : additional measured points; the column
        `tool` names the measured one
    masses : whether the links' masses are declared or estimated from the reach
    drive : properties of the drives; None: unknown
    sessions : parameters that are identified anew in each session
    Raises InputError for a structure that cannot be built.
    """

    name: str
    joints: tuple[Joint, ...]
    base: Placement = field(default_factory=lambda: Placement(np.eye(4)))
    tool: Placement = field(default_factory=lambda: Placement(np.eye(4)))
    loops: tuple[FourBar, ...] = ()
    gravity: Array = field(default_factory=lambda: np.array([0.0, 0.0, -STANDARD_GRAVITY]))
    gravity_frame: Literal["measuring", "base", "logged"] = "measuring"
    payload: Body | None = None
    widths: Mapping[str, Width] = field(default_factory=lambda: dict(WIDTHS))
    body_width: BodyWidth = field(default_factory=BodyWidth)
    tool_name: str = ""
    targets: tuple[Target, ...] = ()
    masses: Literal["declared", "estimated"] = "declared"
    drive: Drive | None = None
    sessions: Sessions = field(default_factory=Sessions)

    def __post_init__(self) -> None:
        if not self.joints:
            raise InputError(f"robot {self.name!r} has no joints; at least one row is needed")
        for i, joint in enumerate(self.joints, 1):
            refuse_joint(self.name, i, joint)
        # Rows whose axis is nearly parallel to the one before have Hayati's parameter beta.
        lacking = [i > 0 and j.beta is None and parallel(self.joints, i - 1) for i, j in enumerate(self.joints)]
        rows = (replace(j, beta=0.0) if lacks else j for j, lacks in zip(self.joints, lacking, strict=True))
        object.__setattr__(self, "joints", tuple(rows))
        for i, joint in enumerate(self.joints, 1):
            for other, _ in joint.coupling.follows if joint.coupling else ():
                if other not in self.numbers or other == i or self.joints[other - 1].coupling:
                    own = [str(k) for k, j in enumerate(self.joints, 1) if not j.coupling and k != i]
                    allowed = f"{', '.join(own)}, which are not coupled"
                    raise InputError(f"joint[{i}].follows: joint {other}; allowed: {allowed}")
            for other, _ in joint.readings.follows if joint.readings else ():
                if other not in self.numbers:
                    raise InputError(f"joint[{i}].readings: joint {other}; allowed: 1 to {self.n}")
        if self.counts_otherwise and abs(np.linalg.det(self.reading_map[0])) < 1e-9:
            raise InputError("joint.readings: several positions of the arm have the same readings; each needs its own")
        for k, loop in enumerate(self.loops, 1):
            _refuse_unbuildable(self, k, loop)
        if self.drive:
            self.drive.refuse_other(self.n)
        names = [self.tool_name, *(t.name for t in self.targets)]
        if self.targets and (len(set(names)) < len(names) or not all(names)):
            raise InputError(f"tool: names {', '.join(map(repr, names))}; each tool needs a name of its own")

    @property
    def n(self) -> int:
        """Return the number of joints."""
        return len(self.joints)

    @property
    def numbers(self) -> range:
        """Return the joint numbers, from 1."""
        return range(1, self.n + 1)

    @property
    def revolute(self) -> tuple[int, ...]:
        """Return the numbers of the revolute joints, from 1."""
        return tuple(i for i in self.numbers if self.joints[i - 1].kind == "revolute")

    @property
    def units(self) -> tuple[str, ...]:
        """Return the SI unit of each joint's reading, rad or m."""
        return tuple("rad" if j.kind == "revolute" else "m" for j in self.joints)

    @property
    def reading_units(self) -> dict[str, float]:
        """Return the column name of each joint reading (q1_deg, q2_mm) and its factor to SI."""
        units = {"revolute": ("deg", np.pi / 180), "prismatic": ("mm", 1e-3)}
        return {f"q{i}_{units[j.kind][0]}": units[j.kind][1] for i, j in enumerate(self.joints, 1)}

    @property
    def limits(self) -> tuple[Array, Array]:
        """Return lower and upper limits of the rows' variables, each shape (n,) [rad or m]."""
        lower, upper = np.array([(j.lower, j.upper) for j in self.joints]).T
        return lower, upper

    def coupled(self, q: Array, *, readings: bool = False) -> Array:
        """Return the variables with those of coupled and locked joints computed, as q is.

        q : the rows' variables, with `readings` the controller's, (poses, n) [rad or m]
        """
        made = np.array(q if readings else self.readings_of(q), dtype=float)
        for i, joint in enumerate(self.joints):
            if joint.coupling is not None:
                made[:, i] = joint.coupling.at + sum(k * made[:, j - 1] for j, k in joint.coupling.follows)
        return made if readings else self.variables_of(made)

    @property
    def counts_otherwise(self) -> bool:
        """Return whether the controller's readings differ from the variables of the rows."""
        return any(joint.readings is not None for joint in self.joints)

    @cached_property
    def reading_map(self) -> tuple[Array, Array]:
        """Return A, (n, n), and b, (n,): DH variables of the joints are A (controller's readings) + b."""
        A, b = np.eye(self.n), np.zeros(self.n)
        for i, joint in enumerate(self.joints):
            if joint.readings is not None:
                A[i], b[i] = 0.0, joint.readings.at
                for j, k in joint.readings.follows:
                    A[i, j - 1] += k
        return A, b

    def variables_of(self, readings: Array) -> Array:
        """Return the rows' variables of the controller's readings, shape (poses, n) [rad or m]."""
        A, b = self.reading_map
        return readings @ A.T + b if self.counts_otherwise else readings

    def readings_of(self, variables: Array) -> Array:
        """Return the controller's readings of the rows' variables, shape (poses, n) [rad or m]."""
        A, b = self.reading_map
        return np.linalg.solve(A, (variables - b).T).T if self.counts_otherwise else variables

    @property
    def reading_limits(self) -> tuple[Array, Array]:
        """Return least and greatest controller readings within `limits`, each (n,) [rad or m]."""
        lower, upper = self.limits
        if not self.counts_otherwise:
            return lower, upper
        centre, half = self.readings_of(np.array([(lower + upper) / 2]))[0], (upper - lower) / 2
        reach = np.abs(np.linalg.inv(self.reading_map[0])) @ half
        return centre - reach, centre + reach

    @property
    def readings_in_words(self) -> str:
        """Return how the rows' variables q follow from the controller's readings J; "" if equal."""
        made = []
        for i, (joint, row) in enumerate(zip(self.joints, self.reading_map[0], strict=True), 1):
            if joint.readings is not None:
                factor, unit = (180 / np.pi, "deg") if joint.kind == "revolute" else (1e3, "mm")
                signs = {1.0: "+", -1.0: "-"}
                terms = [f"{signs.get(k, f'{k:+g} ')}J{j}" for j, k in enumerate(row, 1) if k]
                terms += [f"{factor * joint.readings.at:+.6g} {unit}"] if joint.readings.at else []
                made.append(f"q{i} = {' '.join(terms)}")
        return ", ".join(made)

    def near(self, joint: int) -> tuple[int, ...]:
        """Return the numbers, from 1, of up to two joints before a joint and two after it."""
        return tuple(i for i in (joint - 2, joint - 1, joint + 1, joint + 2) if i in self.numbers)

    @cached_property
    def reach(self) -> float:
        """Return the sum of |a|, |d|, strokes and tool length [m]: it bounds the reach if b = 0."""
        links = sum(
            abs(j.a) + abs(j.d) + max(map(abs, (j.lower, j.upper))) * (j.kind == "prismatic") for j in self.joints
        )
        return float(links + np.linalg.norm(self.tool.T[:3, 3]))


def _refuse_unbuildable(arm: Arm, number: int, loop: FourBar) -> None:
    """Check that a four-bar connects two successive revolute joints with parallel, distinct axes.

    number : number of the four-bar, from 1, for the message
    """
    where = f"four_bar[{number}]: carrier = {loop.carrier}, driven = {loop.driven}"
    if not 1 <= loop.carrier < loop.driven <= arm.n or loop.driven - loop.carrier != 1:
        raise InputError(
            f"{where}: must be two neighbouring joints of this robot, the carrier before the driven one (1..{arm.n})"
        )
    joint = arm.joints[loop.driven - 1]
    if not parallel(arm.joints, loop.carrier - 1) or not joint.a:
        raise InputError(
            f"{where}: their axes must be parallel and apart; row {loop.driven} has "
            f"alpha_deg = {np.rad2deg(joint.alpha):.6g}, a_mm = {1e3 * joint.a:.6g}"
        )
    if {arm.joints[loop.carrier - 1].kind, joint.kind} != {"revolute"}:
        raise InputError(f"{where}: both must be revolute joints")
    if [other.driven for other in arm.loops].count(loop.driven) > 1:
        raise InputError(f"{where}: joint {loop.driven} is driven by two loops; keep one")


A = TypeVar("A", bound=Arm)


def lacks_masses(arm: Arm) -> bool:
    """Return whether no link has a mass above zero, declared or estimated."""
    return not any(j.body and j.body.mass > 0 for j in arm.joints)


def with_estimated_masses(robot: A) -> A:
    """Return the robot with masses [kg] and mass centres of all links estimated from its reach.

    It is marked by `masses`. The prior standard deviation of each coordinate of a mass centre is a
    tenth of the reach; for the masses and their prior see the module's docstring.
    """
    shares = 0.5 ** np.arange(robot.n)
    masses = 10.0 * robot.reach**3 * shares / shares.sum()
    # The mass centre of a link is half way to the next link's origin, of the last one to the tool.
    ends = [np.array([j.a, -np.sin(j.alpha) * j.d, np.cos(j.alpha) * j.d]) for j in robot.joints[1:]]
    joints = tuple(
        replace(joint, body=Body(float(f"{mass:.3g}"), np.asarray(end / 2)))
        for joint, mass, end in zip(robot.joints, masses, [*ends, robot.tool.T[:3, 3]], strict=True)
    )
    com = float(f"{0.1 * robot.reach:.2g}")
    width = BodyWidth.model_validate({"mass_share": 2.0, "com_m": com})
    return replace(robot, joints=joints, masses="estimated", body_width=width)

"""The robot as an immutable object: modified DH rows (Craig) with Hayati's beta, loops, bodies, frames, compliances.

Row i places frame i in frame i-1:  Rot_x(alpha) Trans_x(a) Rot_y(beta) Trans_y(b) Rot_z(theta + q) Trans_z(d).
`beta` stands where neighbouring axes are nearly parallel (Hayati and Mirmirani 1985), `b` only in the first row, where
the six numbers together place the robot in the measuring frame (paper, Table 1).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import casadi as ca
import numpy as np

from .errors import InputError
from .parameters import Parameter, Parameters
from .transforms import Array, frame, small_frame, to_rpy

if TYPE_CHECKING:
    from .effects import Effect
    from .model import Model

STANDARD_GRAVITY = 9.80665
NEAR_PARALLEL = np.deg2rad(5.0)
NEAR_PARALLELOGRAM = 0.02
# Share of the greatest torque for which the smallest gear of a robot is made.
SMALLEST_GEAR = 0.05


@dataclass(frozen=True, eq=False)
class Body:
    """Mass [kg] and mass centre, shape (3,) [m], in its link's frame."""

    mass: float
    com: Array


@dataclass(frozen=True, eq=False)
class Joint:
    """One row of the modified DH table and the joint that it carries; SI units.

    kind : revolute, or prismatic (then the reading is added to d)
    lower, upper : range of the reading [rad or m]
    compliance : of the drive train [rad/(N m) or m/N]; None: taken as rigid
    body : of the link that the joint moves
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


def _refuse_joint(robot: str, i: int, joint: Joint) -> None:
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
    """A closed loop: the reading of joint `driven` is the crank's angle in the plane of joint `carrier` (1-based).

    The ground bar is the link between the two joints (its length is the driven row's a). The driven link's angle
    against the carrier is: direction of the rocker - angle of the carrier + offset. Lengths in metres.
    """

    driven: int
    carrier: int
    crank: float
    coupler: float
    rocker: float
    offset: float = 0.0


@dataclass(frozen=True, eq=False)
class Placement:
    """A frame given by its nominal transform T, shape (4, 4) [m], and what of it is to be identified."""

    T: Array
    unknown: Literal["none", "position", "pose"] = "none"


@dataclass(frozen=True)
class Width:
    """Half width of bounds and one sigma of the prior, for the lengths [m] and angles [rad] of one group."""

    length_bound: float
    angle_bound: float
    length_prior: float
    angle_prior: float


WIDTHS: Mapping[str, Width] = {
    "base": Width(1.0, np.deg2rad(20), 0.1, 0.05),
    "geometry": Width(0.03, np.deg2rad(6), 0.003, 0.01),
    "loop": Width(0.02, np.deg2rad(6), 0.002, 0.01),
    "tool": Width(0.3, np.deg2rad(30), 0.05, 0.1),
    # Compliance: deflection under the joint's greatest torque.
    "compliance": Width(0.02, 0.05, 0.001, 0.001),
}


@dataclass(frozen=True, eq=False)
class Robot:
    """A serial robot, with closed four-bar loops where it has them.

    joints : the rows, from base to flange
    base : T_M0, robot base in the measuring frame; tool : T_nE, measured point in the last link's frame
    gravity : shape (3,) [m/s^2], given in `gravity_frame`
    payload : declared mass and mass centre in the last link's frame; poses may carry another mass (column payload_kg)
    effects, effect_values : what was added to the base model (see `with_effect`)
    notes : what a reader of results must know (assumed masses, sources)
    """

    name: str
    joints: tuple[Joint, ...]
    base: Placement = field(default_factory=lambda: Placement(np.eye(4)))
    tool: Placement = field(default_factory=lambda: Placement(np.eye(4)))
    loops: tuple[FourBar, ...] = ()
    gravity: Array = field(default_factory=lambda: np.array([0.0, 0.0, -STANDARD_GRAVITY]))
    gravity_frame: Literal["measuring", "base"] = "measuring"
    payload: Body | None = None
    widths: Mapping[str, Width] = field(default_factory=lambda: dict(WIDTHS))
    effects: tuple[Effect, ...] = ()
    effect_values: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.joints:
            raise InputError(f"robot {self.name!r} has no joints; at least one row is needed")
        for i, joint in enumerate(self.joints, 1):
            _refuse_joint(self.name, i, joint)
        object.__setattr__(self, "joints", _with_hayati(self.joints))
        for k, loop in enumerate(self.loops, 1):
            _refuse_unbuildable(self, k, loop)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @cached_property
    def conditions(self) -> tuple[str, ...]:
        """Logged columns that the model uses, besides the joint readings."""
        own = ("payload_kg",) if self.payload else ()
        return tuple(dict.fromkeys((*own, *(c for e in self.effects for c in e.conditions))))

    @cached_property
    def declared(self) -> Array:
        """Values of `conditions` where nothing was logged, shape (k,) [of the column]: declared payload, else zero."""
        return np.array([self.payload.mass if c == "payload_kg" and self.payload else 0.0 for c in self.conditions])

    @cached_property
    def parameters(self) -> Parameters:
        """Every parameter of the model, with its nominal value, bounds and prior."""
        return Parameters(_parameters(self))

    @cached_property
    def reach(self) -> float:
        """Sum of all link lengths and the tool [m]; no point can lie farther from the base."""
        links = sum(
            abs(j.a) + abs(j.d) + max(map(abs, (j.lower, j.upper))) * (j.kind == "prismatic") for j in self.joints
        )
        return float(links + np.linalg.norm(self.tool.T[:3, 3]))

    @cached_property
    def torque_scale(self) -> Array:
        """Great gravity torques on each joint, shape (n,) [N m or N]: 95 % quantile over its range, full payload.

        At least a twentieth of the greatest: a gear whose axis is upright is made for the forces of motion.
        """
        bare = replace(self, effects=(), effect_values={})
        lower, upper = np.array([(j.lower, j.upper) for j in self.joints]).T
        q = np.random.default_rng(0).uniform(lower, upper, (512, self.n))
        tau = np.abs(bare.torque.map(512)(q.T, bare.parameters.values).full())
        great = np.nanquantile(tau, 0.95, axis=1)
        return np.asarray(np.maximum(great, SMALLEST_GEAR * max(1e-9, float(np.nanmax(great)))))

    @cached_property
    def model(self) -> Model:
        """The symbolic model and its CasADi functions."""
        from .model import build

        return build(self)

    @cached_property
    def position(self) -> ca.Function:
        """position:(q[n] rad, phi)->(p[3] m) of the measured point in the measuring frame, declared payload."""
        return self.model.at_declared("position", ("p",))

    @cached_property
    def pose(self) -> ca.Function:
        """pose:(q[n] rad, phi)->(p[3] m, R[3x3]) of the tool frame in the measuring frame, declared payload."""
        return self.model.at_declared("pose", ("p", "R"))

    @cached_property
    def torque(self) -> ca.Function:
        """torque:(q[n] rad, phi)->(tau[n] N m) of gravity on the actuated joints, declared payload."""
        return self.model.at_declared("torque", ("tau",))

    def with_effect(self, *effects: Effect) -> Robot:
        """A robot whose model holds these effects too."""
        return replace(self, effects=(*self.effects, *effects))

    def with_values(self, values: Mapping[str, float]) -> Robot:
        """A robot whose nominal values are these, by parameter name [SI]."""
        for name in values:
            self.parameters.index_of(name)
        v = {p.name: float(values.get(p.name, p.value)) for p in self.parameters}
        effect_names = {p.name for e in self.effects for p in e.parameters()}
        return replace(
            self,
            joints=tuple(_joint_with(j, i, v) for i, j in enumerate(self.joints, 1)),
            loops=tuple(_loop_with(loop, k, v) for k, loop in enumerate(self.loops, 1)),
            base=replace(self.base, T=self.base.T @ np.array(small_frame(*(v.get(n, 0.0) for n in _SIX["base"])))),
            tool=replace(self.tool, T=_tool_with(self.tool.T, v)),
            effect_values={n: v[n] for n in effect_names},
        )

    def values_of(self, other: Robot) -> Array:
        """Parameters of this robot, shape (P,) [SI], that make it the other one, whose base may stand elsewhere."""
        values = dict(zip(other.parameters.names, other.parameters.values, strict=True))
        moved = np.linalg.solve(self.base.T, other.base.T)
        turn = (np.arctan2(-moved[1, 2], moved[2, 2]), np.arcsin(moved[0, 2]), np.arctan2(-moved[0, 1], moved[0, 0]))
        values |= {n: v for n, v in zip(_SIX["base"], (*moved[:3, 3], *turn), strict=True) if n in values}
        return np.array([values[n] for n in self.parameters.names])


def _refuse_unbuildable(robot: Robot, number: int, loop: FourBar) -> None:
    """A four-bar drives one joint from the one before it, both turning about parallel axes a ground bar apart."""
    where = f"four_bar[{number}]: carrier = {loop.carrier}, driven = {loop.driven}"
    if not 1 <= loop.carrier < loop.driven <= robot.n or loop.driven - loop.carrier != 1:
        raise InputError(
            f"{where}: must be two neighbouring joints of this robot, the carrier before the driven one (1..{robot.n})"
        )
    joint = robot.joints[loop.driven - 1]
    if not _parallel(robot.joints, loop.carrier - 1) or not joint.a:
        raise InputError(
            f"{where}: their axes must be parallel and apart; row {loop.driven} has "
            f"alpha_deg = {np.rad2deg(joint.alpha):.6g}, a_mm = {1e3 * joint.a:.6g}"
        )
    if {robot.joints[loop.carrier - 1].kind, joint.kind} != {"revolute"}:
        raise InputError(f"{where}: both must be revolute joints")
    if [other.driven for other in robot.loops].count(loop.driven) > 1:
        raise InputError(f"{where}: joint {loop.driven} is driven by two loops; keep one")


_SIX = {w: tuple(f"{w}_{c}" for c in ("x", "y", "z", "rx", "ry", "rz")) for w in ("base", "tool")}


def _bar_names(number: int) -> dict[str, str]:
    suffix = "" if number == 1 else f"_{number}"
    return {"crank": f"L5{suffix}", "coupler": f"L4{suffix}", "rocker": f"L3{suffix}"}


def _joint_with(joint: Joint, i: int, v: Mapping[str, float]) -> Joint:
    return replace(
        joint,
        alpha=v[f"alpha{i - 1}"],
        a=v[f"a{i - 1}"],
        beta=v.get(f"beta{i - 1}"),
        b=v.get(f"b{i - 1}"),
        theta=v[f"theta{i}"],
        d=v[f"d{i}"],
        compliance=v.get(f"c{i}"),
    )


def _loop_with(loop: FourBar, k: int, v: Mapping[str, float]) -> FourBar:
    names = _bar_names(k)
    return replace(loop, crank=v[names["crank"]], coupler=v[names["coupler"]], rocker=v[names["rocker"]])


def _tool_with(T: Array, v: Mapping[str, float]) -> Array:
    x, y, z, rx, ry, rz = (v.get(n, default) for n, default in zip(_SIX["tool"], (*T[:3, 3], 0, 0, 0), strict=True))
    turned = np.array(small_frame(0, 0, 0, rx, ry, rz))[:3, :3]
    return frame(T[:3, :3] @ turned, np.array([x, y, z]))


def _parallel(joints: tuple[Joint, ...], i: int) -> bool:
    """Whether the axes of joints i and i+1 (0-based rows) are nearly parallel or antiparallel."""
    return i + 1 < len(joints) and abs(np.sin(joints[i + 1].alpha)) < np.sin(NEAR_PARALLEL)


def _with_hayati(joints: tuple[Joint, ...]) -> tuple[Joint, ...]:
    """Insert beta in every row whose axis is nearly parallel to the one before."""
    return tuple(
        replace(j, beta=0.0) if i > 0 and j.beta is None and _parallel(joints, i - 1) else j
        for i, j in enumerate(joints)
    )


def _parameters(robot: Robot) -> Iterable[Parameter]:
    """All parameters, those first that identifiability prefers: placement, rows, loops, compliance, effects."""
    for which, placement in (("base", robot.base), ("tool", robot.tool)):
        yield from _placement(robot, which, placement)
    for i, joint in enumerate(robot.joints, 1):
        yield from _row(robot, i, joint)
    for k, loop in enumerate(robot.loops, 1):
        yield from _loop(robot, k, loop)
    for i, joint in enumerate(robot.joints, 1):
        if joint.compliance is not None:
            yield _compliance(robot, i, joint.compliance)
    for effect in robot.effects:
        for p in effect.parameters():
            yield replace(p, value=robot.effect_values.get(p.name, p.value))


def _number(robot: Robot, name: str, group: str, unit: str, value: float, held: str = "") -> Parameter:
    width = robot.widths[group]
    bound = width.length_bound if unit == "m" else width.angle_bound
    prior = width.length_prior if unit == "m" else width.angle_prior
    return Parameter(name, group, unit, value, 1e-3, value - bound, value + bound, prior, held)


def _placement(robot: Robot, which: str, placement: Placement) -> Iterable[Parameter]:
    count = {"none": 0, "position": 3, "pose": 6}[placement.unknown]
    start = placement.T[:3, 3] if which == "tool" else np.zeros(3)
    for name, value in list(zip(_SIX[which], (*start, 0.0, 0.0, 0.0), strict=True))[:count]:
        yield _number(robot, name, which, "rad" if "_r" in name else "m", float(value))


def _row(robot: Robot, i: int, joint: Joint) -> Iterable[Parameter]:
    # A first row with all six numbers is the base frame itself, as in the paper's Table 1.
    group = "base" if i == 1 and joint.b is not None else "geometry"
    yield _number(robot, f"alpha{i - 1}", group, "rad", joint.alpha)
    yield _number(robot, f"a{i - 1}", group, "m", joint.a)
    if joint.beta is not None:
        yield _number(robot, f"beta{i - 1}", group, "rad", joint.beta)
    if joint.b is not None:
        yield _number(robot, f"b{i - 1}", group, "m", joint.b)
    held = ""
    if _slides_together(robot, i):
        held = f"axes {i} and {i + 1} are nearly parallel: d{i} moves the tool as d{i + 1} does"
    elif i > 1 and robot.base.unknown != "none" and all(_slides_together(robot, k) for k in range(1, i)):
        held = f"axes 1 to {i} are nearly parallel: d{i} moves the tool as the base does"
    yield _number(robot, f"d{i}", group, "m", joint.d, held)
    yield _number(robot, f"theta{i}", group, "rad", joint.theta)


def _slides_together(robot: Robot, i: int) -> bool:
    """Whether joints i and i+1 (1-based) turn about nearly parallel axes, so that their d are one."""
    return _parallel(robot.joints, i - 1) and all(j.kind == "revolute" for j in robot.joints[i - 1 : i + 1])


def _loop(robot: Robot, k: int, loop: FourBar) -> Iterable[Parameter]:
    names = _bar_names(k)
    ground = abs(robot.joints[loop.driven - 1].a)
    parallelogram = (
        abs(loop.crank - loop.rocker) < NEAR_PARALLELOGRAM * loop.rocker
        and abs(loop.coupler - ground) < NEAR_PARALLELOGRAM * ground
    )
    scale = f"only the difference {names['crank']} - {names['rocker']} turns the driven link of a parallelogram"
    for bar, name in names.items():
        held = scale if bar == "rocker" and parallelogram else ""
        yield _number(robot, name, "loop", "m", getattr(loop, bar), held)


def _compliance(robot: Robot, i: int, value: float) -> Parameter:
    width = robot.widths["compliance"]
    rotary = robot.joints[i - 1].kind == "revolute"
    bound, prior = (width.angle_bound, width.angle_prior) if rotary else (width.length_bound, width.length_prior)
    load = _greatest_load(robot, i)
    unit = "rad/(N m)" if rotary else "m/N"
    return Parameter(f"c{i}", "compliance", unit, value, 1e-3 / load, 0.0, value + bound / load, prior / load)


def _greatest_load(robot: Robot, i: int) -> float:
    """Roughly the greatest torque [N m] (or force [N]) at joint i: all weight beyond it at half the reach beyond."""
    beyond = robot.joints[i - 1 :]
    mass = sum(j.body.mass for j in beyond if j.body) + (robot.payload.mass if robot.payload else 0.0)
    reach = sum(abs(j.a) + abs(j.d) for j in beyond) + float(np.linalg.norm(robot.tool.T[:3, 3]))
    lever = 1.0 if robot.joints[i - 1].kind == "prismatic" else max(0.5 * reach, 0.05)
    return max(mass * float(np.linalg.norm(robot.gravity)) * lever, 1e-3)


def modified_dh(robot: Robot) -> list[dict[str, float | str | None]]:
    """The modified DH table in millimetres and degrees, a dict per row."""

    def deg(x: float | None) -> float | None:
        return None if x is None else float(np.rad2deg(x))

    def mm(x: float | None) -> float | None:
        return None if x is None else 1e3 * x

    return [
        {
            "joint": i,
            "alpha_deg": deg(j.alpha),
            "a_mm": mm(j.a),
            "beta_deg": deg(j.beta),
            "b_mm": mm(j.b),
            "theta_deg": deg(j.theta),
            "d_mm": mm(j.d),
        }
        for i, j in enumerate(robot.joints, 1)
    ]


def describe_frame(T: Array) -> str:
    """A transform in words: position in mm, roll-pitch-yaw in degrees."""
    x, y, z = 1e3 * T[:3, 3]
    roll, pitch, yaw = np.rad2deg(to_rpy(T[:3, :3]))
    return f"xyz ({x:.3f}, {y:.3f}, {z:.3f}) mm, rpy ({roll:.4f}, {pitch:.4f}, {yaw:.4f}) deg"

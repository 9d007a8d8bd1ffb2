"""The robot as an immutable object: modified DH rows (Craig) with Hayati's beta, loops, bodies, frames, compliances.

Row i places frame i in frame i-1:  Rot_x(alpha) Trans_x(a) Rot_y(beta) Trans_y(b) Rot_z(theta + q) Trans_z(d).
`beta` stands where neighbouring axes are nearly parallel (Hayati and Mirmirani 1985), `b` only in the first row, where
the six numbers together place the robot in the measuring frame (paper, Table 1).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import casadi as ca
import numpy as np

from casadical.core.errors import InputError
from casadical.core.parameters import Parameters
from casadical.core.parts import (
    NEAR_PARALLEL,
    WIDTHS,
    Body,
    FourBar,
    Joint,
    Placement,
    Width,
    parallel,
    refuse_joint,
    with_hayati,
)
from casadical.core.transforms import Array, frame, small_frame, to_rpy
from casadical.robot.parameter_list import SIX, bar_names, parameters_of

if TYPE_CHECKING:
    from casadical.effects import Effect
    from casadical.robot.model import Model

__all__ = [
    "NEAR_PARALLEL",
    "STANDARD_GRAVITY",
    "WIDTHS",
    "Body",
    "FourBar",
    "Joint",
    "Placement",
    "Robot",
    "Width",
    "describe_frame",
    "modified_dh",
]

STANDARD_GRAVITY = 9.80665
# Share of the greatest torque for which the smallest gear of a robot is made.
SMALLEST_GEAR = 0.05


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
            refuse_joint(self.name, i, joint)
        object.__setattr__(self, "joints", with_hayati(self.joints))
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
        return Parameters(parameters_of(self))

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
        from casadical.robot.model import build

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
            base=replace(self.base, T=self.base.T @ np.array(small_frame(*(v.get(n, 0.0) for n in SIX["base"])))),
            tool=replace(self.tool, T=_tool_with(self.tool.T, v)),
            effect_values={n: v[n] for n in effect_names},
        )

    def values_of(self, other: Robot) -> Array:
        """Parameters of this robot, shape (P,) [SI], that make it the other one, whose base may stand elsewhere."""
        values = dict(zip(other.parameters.names, other.parameters.values, strict=True))
        moved = np.linalg.solve(self.base.T, other.base.T)
        turn = (np.arctan2(-moved[1, 2], moved[2, 2]), np.arcsin(moved[0, 2]), np.arctan2(-moved[0, 1], moved[0, 0]))
        values |= {n: v for n, v in zip(SIX["base"], (*moved[:3, 3], *turn), strict=True) if n in values}
        return np.array([values[n] for n in self.parameters.names])


def _refuse_unbuildable(robot: Robot, number: int, loop: FourBar) -> None:
    """A four-bar drives one joint from the one before it, both turning about parallel axes a ground bar apart."""
    where = f"four_bar[{number}]: carrier = {loop.carrier}, driven = {loop.driven}"
    if not 1 <= loop.carrier < loop.driven <= robot.n or loop.driven - loop.carrier != 1:
        raise InputError(
            f"{where}: must be two neighbouring joints of this robot, the carrier before the driven one (1..{robot.n})"
        )
    joint = robot.joints[loop.driven - 1]
    if not parallel(robot.joints, loop.carrier - 1) or not joint.a:
        raise InputError(
            f"{where}: their axes must be parallel and apart; row {loop.driven} has "
            f"alpha_deg = {np.rad2deg(joint.alpha):.6g}, a_mm = {1e3 * joint.a:.6g}"
        )
    if {robot.joints[loop.carrier - 1].kind, joint.kind} != {"revolute"}:
        raise InputError(f"{where}: both must be revolute joints")
    if [other.driven for other in robot.loops].count(loop.driven) > 1:
        raise InputError(f"{where}: joint {loop.driven} is driven by two loops; keep one")


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
    names = bar_names(k)
    return replace(loop, crank=v[names["crank"]], coupler=v[names["coupler"]], rocker=v[names["rocker"]])


def _tool_with(T: Array, v: Mapping[str, float]) -> Array:
    x, y, z, rx, ry, rz = (v.get(n, default) for n, default in zip(SIX["tool"], (*T[:3, 3], 0, 0, 0), strict=True))
    turned = np.array(small_frame(0, 0, 0, rx, ry, rz))[:3, :3]
    return frame(T[:3, :3] @ turned, np.array([x, y, z]))


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

"""What each effect does to the measured position: its columns of the Jacobian, at zero effect.

The chain rule at the seams: a column is the position's derivative by the seam's variables (joint variables, a twist
behind each link, at the base and in the tool, the measured point) times those variables' derivative by the effect's
parameter. The first factor is the same for all effects and the second is a few operations, so that thousands of
candidates cost little more than one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar

import casadi as ca
import numpy as np

from casadical.core.transforms import Array, Symbolic, small_frame
from casadical.effects import Context, Effect
from casadical.measurements.measurements import Measurements
from casadical.robot.model import rigid_context
from casadical.robot.robot import Robot
from casadical.robot.statics import deflections, gravity_torques

_TWIST = ("x", "y", "z", "rx", "ry", "rz")


class _Probe(Effect):
    """An effect with every variable of every seam as a parameter."""

    name: ClassVar[str] = "probe"

    def __init__(self, robot: Robot, conditions: tuple[str, ...]) -> None:
        object.__setattr__(self, "joint", None)
        object.__setattr__(self, "_conditions", conditions)
        names = [f"q{i}" for i in range(1, robot.n + 1)]
        for seam in (*(f"link{i}" for i in range(1, robot.n + 1)), "base", "tool"):
            names += [f"{seam}_{c}" for c in _TWIST]
        object.__setattr__(self, "names", (*names, "point_x", "point_y", "point_z"))

    @property
    def conditions(self) -> tuple[str, ...]:
        return self._conditions  # type: ignore[attr-defined,no-any-return]

    def sizes(self) -> dict[str, tuple[float, str]]:
        return dict.fromkeys(self.names, (1.0, ""))  # type: ignore[attr-defined]

    def joint_angle(self, context: Context) -> Symbolic:
        return ca.vertcat(*(self.value(context, f"q{i}") for i in range(1, context.arm.n + 1)))

    def _frame(self, context: Context, seam: str) -> Symbolic:
        return small_frame(*(self.value(context, f"{seam}_{c}") for c in _TWIST))

    def link(self, number: int, context: Context) -> Symbolic:
        return self._frame(context, f"link{number}")

    def base(self, context: Context) -> Symbolic:
        return self._frame(context, "base")

    def tool(self, context: Context) -> Symbolic:
        return self._frame(context, "tool")

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        return point + ca.vertcat(*(self.value(context, f"point_{c}") for c in "xyz"))


@dataclass(frozen=True, eq=False)
class _Seams:
    """A robot at its seams, no effect in it: what every effect's columns are made from."""

    context: Context
    point: ca.SX
    J: ca.SX
    S: ca.SX
    inputs: tuple[ca.SX, ca.SX, ca.SX]


@lru_cache(maxsize=16)
def _seams(robot: Robot, conditions: tuple[str, ...]) -> _Seams:
    """The derivatives of the position by the base parameters and by every seam's variables, at zero of these."""
    probed = robot.with_effect(_Probe(robot, conditions))
    model = probed.model
    w = dict(zip(probed.conditions, ca.vertsplit(model.w), strict=True))
    count = len(robot.parameters)
    phi, seams = model.phi[:count], model.phi[count:]
    parts = [model.p, ca.jacobian(model.p, phi), ca.jacobian(model.p, seams)]
    point, J, S = ca.substitute(parts, [seams], [ca.SX.zeros(seams.numel())])
    values = dict(zip(robot.parameters.names, ca.vertsplit(phi), strict=True))
    context = rigid_context(robot, robot.torque_scale, model.q, w, values, ca.DM(robot.base.T))
    return _Seams(replace(context, torque=gravity_torques(context)), point, J, S, (model.q, model.w, phi))


@lru_cache(maxsize=16)
def signature_function(robot: Robot, effects: tuple[Effect, ...]) -> tuple[ca.Function, tuple[str, ...]]:
    """signatures:(q, w, phi)->(E[3, all parameters], J[3, phi], Jq[3, n]) and the names of the conditions w.

    phi : of `robot`, which must hold no effects itself. Units of columns: m per unit of parameter.
    """
    conditions = tuple(dict.fromkeys((*robot.conditions, *(c for e in effects for c in e.conditions))))
    s = _seams(robot, conditions)
    columns = [s.S @ _seam_derivative(effect, s.context, s.point) for effect in effects]
    parts = [ca.horzcat(ca.SX(3, 0), *columns), s.J, s.S[:, : robot.n]]
    dense = [ca.densify(part) for part in parts]
    return ca.Function("signatures", [*s.inputs], dense, ["q", "w", "phi"], ["E", "J", "Jq"]), conditions


def _seam_derivative(effect: Effect, context: Context, point: ca.SX) -> ca.SX:
    """Derivative of all seam variables by the effect's parameters at zero, shape (seams, parameters)."""
    parameters = effect.parameters()
    theta = ca.SX.sym("theta", len(parameters))
    own = dict(zip((p.name for p in parameters), ca.vertsplit(theta), strict=True))
    context = replace(context, values={**context.values, **own})
    angle = ca.SX(effect.joint_angle(context))
    energy = ca.SX(effect.energy(replace(context, torque=None)))
    if ca.depends_on(energy, theta):
        angle += deflections(context.arm, gravity_torques(context, energy), context.values)
    seams, n = [angle], context.arm.n
    seams += [_twist(effect.link(i, context)) for i in range(1, n + 1)] if _acts(effect, "link") else [ca.SX(6 * n, 1)]
    seams += [_twist(effect.base(context)) if _acts(effect, "base") else ca.SX(6, 1)]
    seams += [_twist(effect.tool(context)) if _acts(effect, "tool") else ca.SX(6, 1)]
    seams += [effect.measurement(point, context) - point if _acts(effect, "measurement") else ca.SX(3, 1)]
    derivative = ca.jacobian(ca.vertcat(*seams), theta)
    return ca.substitute(derivative, theta, ca.SX.zeros(theta.numel()))


def _acts(effect: Effect, seam: str) -> bool:
    """Whether the effect overrides a seam."""
    return getattr(type(effect), seam) is not getattr(Effect, seam)


def _twist(T: ca.SX) -> ca.SX:
    """The six numbers of a transform near identity, to first order."""
    T = ca.SX(T)
    turn = 0.5 * ca.vertcat(T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1])
    return ca.vertcat(T[:3, 3], turn)


def signatures(robot: Robot, effects: Sequence[Effect], m: Measurements, values: Array) -> tuple[Array, Array, Array]:
    """Columns of the effects, of the base model's parameters and of the joint variables at the measured poses.

    Shapes (n, 3, all effects' parameters), (n, 3, P), (n, 3, joints), at the parameter values given, shape (P,) [SI].
    m : with every condition that the effects need (see `casadical.measurements.derived_columns.derive`)
    """
    function, conditions = signature_function(robot, tuple(effects))
    declared = np.array([robot.payload.mass if c == "payload_kg" and robot.payload else 0.0 for c in conditions])
    w = m.condition_matrix(conditions, declared)
    parts = function.map(len(m))(m.q.T, w.T, values)
    return tuple(p.full().reshape(3, len(m), p.shape[1] // len(m)).transpose(1, 0, 2) for p in parts)

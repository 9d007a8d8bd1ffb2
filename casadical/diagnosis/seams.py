"""Derivatives of the model at its seams, the insertion points at which an effect may enter it.

They are derivatives of the measured position, or of the residual of another kind of measurement.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar

import casadi as ca
import numpy as np

from casadical.core.basics import Array
from casadical.core.mapped_function import call
from casadical.core.transforms import Symbolic, small_frame
from casadical.effects import Context, Effect
from casadical.measurements.kinds.base import MeasurementKind, PoseExpression
from casadical.robot.kinematics import gravity_torques
from casadical.robot.model import Structure, expressions, rigid_context
from casadical.robot.robot import Robot

# Largest number of poses at which a mapped CasADi function is evaluated in one call.
POSES_PER_CALL = 512
# Names of the seam variables of a frame: translation [m] and rotation [rad].
_TWIST = ("x", "y", "z", "rx", "ry", "rz")


class _Probe(Effect):
    """Effect whose parameters are the variables of all seams, for derivatives by them."""

    name: ClassVar[str] = "probe"

    def __init__(self, robot: Robot) -> None:
        object.__setattr__(self, "joint", None)
        names = [f"q{i}" for i in range(1, robot.n + 1)]
        for seam in (*(f"link{i}" for i in range(1, robot.n + 1)), "base", "tool"):
            names += [f"{seam}_{c}" for c in _TWIST]
        object.__setattr__(self, "names", (*names, "point_x", "point_y", "point_z"))

    def sizes(self) -> dict[str, tuple[float, str]]:
        """Return size 1 and an empty unit for every seam variable, by name."""
        return dict.fromkeys(self.names, (1.0, ""))  # type: ignore[attr-defined]

    def joint_angle(self, context: Context) -> Symbolic:
        """Return the seam variables of the joints, shape (n,) [rad or m]."""
        return ca.vertcat(*(self.value(context, f"q{i}") for i in range(1, context.arm.n + 1)))

    def _frame(self, context: Context, seam: str) -> Symbolic:
        """Return the transform (4, 4) [m] by the six variables of a frame's seam."""
        return small_frame(*(self.value(context, f"{seam}_{c}") for c in _TWIST))

    def link(self, number: int, context: Context) -> Symbolic:
        """Return the transform (4, 4) [m] by the seam variables of link `number` (1-based)."""
        return self._frame(context, f"link{number}")

    def base(self, context: Context) -> Symbolic:
        """Return the transform (4, 4) [m] by the seam variables of the base."""
        return self._frame(context, "base")

    def tool(self, context: Context) -> Symbolic:
        """Return the transform (4, 4) [m] by the seam variables of the tool."""
        return self._frame(context, "tool")

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        """Return `point` displaced by its seam variables, (3,) [m], both in the measuring frame."""
        return point + ca.vertcat(*(self.value(context, f"point_{c}") for c in "xyz"))


@dataclass(frozen=True, eq=False)
class Seams:
    """Derivatives of the measured position at the seams of robots of one structure.

    Candidate effects are zero.
    key : text that identifies the structure
    function : (q, w, phi, constants)->(J[3, P], S[3, seams], seen): derivatives by the parameters
        and by the seam variables, and the quantities that effects depend on: measured point,
        gravity torques, gravity and frames
    exact : context of the model's own expressions; free : the same, with the symbols `seen` in it
    inputs : symbols q, w, phi and constants; seen : of the quantities that effects depend on
    point : symbols of the measured point among these, in the measuring frame [m]
    """

    key: str
    function: ca.Function
    exact: Context
    free: Context
    inputs: tuple[ca.SX, ca.SX, ca.SX, ca.SX]
    seen: ca.SX
    point: ca.SX


def seams_of(robot: Robot) -> Seams:
    """Return the derivatives at a robot's seams, cached for all robots of its structure."""
    return _seams(robot.with_effect(_Probe(robot)).structure, len(robot.parameters))


def observed_at_seams(robot: Robot, kind: MeasurementKind, point: bool) -> tuple[ca.Function, tuple[str, ...]]:
    """Return residual and derivatives of a kind of measurement at a robot's seams, and their data.

    The function is (q, w, phi, constants, data)->(r, J[numbers, P], S[numbers, seams of each end],
    U[numbers, 3 or 0], seen and q of each end); r is model minus measurement; J, S and U are its
    derivatives by parameters, seam variables and the unknown point; see `Seams` for seen. A
    measurement involves one or two poses, its ends. The names are those of the observed quantities
    in the order of the function's data.

    point : whether the measured target is an unknown point
    """
    return _observed(robot.with_effect(_Probe(robot)).structure, len(robot.parameters), kind, point)


def over_poses(f: ca.Function, q: Array, w: Array, shared: Sequence[Array], *data: Array) -> list[Array]:
    """Return each output of a function of one pose at all n poses, shape (n, rows, columns) each.

    f : function of q, w, parameters, constants and data
    q, w, data : joint variables, conditions and additional inputs, shape (n, numbers) each
    shared : parameters and constants, equal at all poses
    """
    parts = []
    for first in range(0, len(q), POSES_PER_CALL):
        own, conditions, *rest = (values[first : first + POSES_PER_CALL].T for values in (q, w, *data))
        outputs, n = call(_mapped(f, own.shape[1]), own, conditions, *shared, *rest), own.shape[1]
        parts.append([out.reshape(len(out), n, out.shape[1] // n).transpose(1, 0, 2) for out in outputs])
    # The results are contiguous in memory pose by pose.
    return [np.concatenate(some, out=np.empty((len(q), *some[0].shape[1:]))) for some in zip(*parts, strict=True)]


@lru_cache(maxsize=128)
def _mapped(f: ca.Function, n: int) -> ca.Function:
    """Return a function mapped over n poses; its inputs 2 and 3, counted from 0, are shared."""
    return f.map("poses", "serial", n, [2, 3], [])


@lru_cache(maxsize=16)
def _observed(
    structure: Structure, count: int, kind: MeasurementKind, point: bool
) -> tuple[ca.Function, tuple[str, ...]]:
    """Return the composed residual and derivatives of `observed_at_seams`, and names of their data.

    structure : includes the probe; count : number of base parameters, P
    point : whether the measured target is an unknown point
    """
    model, own = expressions(structure, False), _seams(structure, count)
    phi, probes = model.phi[:count], model.phi.numel() - count
    position = model.function("p", "R")
    ends: list[tuple[ca.SX, ca.SX]] = []

    def at(q: Symbolic) -> tuple[Symbolic, Symbolic]:
        """Return position (3,) [m] and rotation (3, 3) in the measuring frame at joint variables.

        Each call is an end of the measurement and gets seam variables of its own.
        """
        ends.append((ca.SX(q), ca.SX.sym(f"end{len(ends)}", probes)))
        whole = ca.vertcat(phi, ends[-1][1])
        p, R = position(q, model.w, whole, model.constants, whole)
        return p, R

    u = ca.SX.sym("u", 3 if point else 0)
    pose = PoseExpression(at, model.q, u if point else None)
    r = kind.residual(pose)
    seams = [end for _, end in ends]
    zero = [ca.SX.zeros(probes) for _ in ends]
    parts = [r, ca.jacobian(r, phi), ca.jacobian(r, ca.vertcat(*seams)), ca.jacobian(r, u)]
    parts = ca.substitute(parts, [*seams, u], [*zero, ca.SX.zeros(u.numel())])
    seen = ca.horzcat(*(own.function(q, model.w, phi, model.constants)[2] for q, _ in ends))
    observed = ca.SX(ca.vertcat(*pose.observed.values()))
    inputs: list[ca.SX] = [model.q, model.w, ca.SX(phi), model.constants, observed]
    every = [*parts, seen, ca.horzcat(*(q for q, _ in ends))]
    outputs: list[ca.SX] = [ca.SX(ca.densify(part)) for part in every]
    return ca.Function("observed", inputs, outputs), tuple(pose.observed)


@lru_cache(maxsize=16)
def _seams(structure: Structure, count: int) -> Seams:
    """Return the composed derivatives of the position by parameters and by the seam variables.

    They are taken at zero of the seam variables.
    structure : includes the probe, whose parameters are last; count : number of the others, P
    """
    model, arm = expressions(structure, False), structure.arm
    phi, seams = model.phi[:count], model.phi[count:]
    zero = ca.SX.zeros(seams.numel())
    parts = ca.substitute([model.p, ca.jacobian(model.p, phi), ca.jacobian(model.p, seams)], [seams], [zero])
    # The loads are those at the robot's own parameters.
    point, J, S = ca.substitute(parts, [model.loaded], [ca.vertcat(phi, zero)])
    conditions = dict(zip(structure.conditions, ca.vertsplit(model.w) if structure.conditions else [], strict=True))
    values = dict(zip(structure.parameters.names[:count], ca.vertsplit(phi), strict=True))
    base = ca.vertcat(ca.reshape(model.constants[:12], 3, 4), ca.DM([[0, 0, 0, 1]]))
    exact = rigid_context(arm, model.constants[24:], model.q, conditions, values, base)
    others = [e.energy(exact) for e in structure.effects]
    exact = replace(exact, torque=gravity_torques(exact, sum(others)))
    frames = [ca.reshape(T[:3, :], 12, 1) for T in exact.frames]
    looked_at = ca.vertcat(point, ca.SX(exact.torque), ca.SX(exact.gravity), *map(ca.SX, frames))
    seen = ca.SX.sym("seen", looked_at.numel())
    torque, gravity = seen[3 : 3 + arm.n], seen[3 + arm.n : 6 + arm.n]
    parts = ca.vertsplit(seen[6 + arm.n :], 12)
    rigid = tuple(ca.vertcat(ca.reshape(part, 3, 4), ca.DM([[0, 0, 0, 1]])) for part in parts)
    free = replace(exact, torque=torque, gravity=gravity, frames=rigid)
    inputs = (model.q, model.w, phi, model.constants)
    outputs = [ca.densify(part) for part in (J, S, looked_at)]
    function = ca.Function("seams", [*inputs], outputs, ["q", "w", "phi", "constants"], ["J", "S", "seen"])
    return Seams(f"{structure.key} {count}", function, exact, free, inputs, seen, seen[:3])

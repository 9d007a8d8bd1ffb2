"""Residuals of every kind of measurement and their Jacobian, pose by pose, as mapped CasADi functions.

A kernel sees one pose. Its variables z = (x, u) are the departures x of the chosen parameters from the robot's nominal
values in units of their scale (mm, mrad) and, where the kind has an unknown point, that point's departure u [mm]. Its
residual is in units of sigma.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.mapped_function import MAX_CHUNK_POINTS, MappedFunction
from casadical.measurements.kinds.base import MeasurementKind, PoseExpression
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.robot.model import Expressions, expressions
from casadical.robot.robot import Robot

Loss = Literal["linear", "huber", "soft_l1"]
# auto : huber where it finds outliers, else linear
AnyLoss = Literal["auto", Loss]

LOSSES: tuple[Loss, ...] = ("linear", "huber", "soft_l1")
ALL_LOSSES: tuple[AnyLoss, ...] = ("auto", *LOSSES)
POINT_SCALE = 1e-3
# Of so many poses the data of the kernel are kept; of more they are put together again where they are evaluated.
HELD = 100_000

# Square of the normalised residual at which a robust loss leaves the parabola: the 95 % quantile of a chi-squared
# distribution with as many degrees of freedom as the kind observes.
KNEE = {1: 3.84, 2: 5.99, 3: 7.81, 4: 9.49, 5: 11.07, 6: 12.59}


def _huber(s: Array, knee: float) -> tuple[Array, Array]:
    root = np.sqrt(np.maximum(s, knee) * knee)
    return np.where(s <= knee, s, 2 * root - knee), knee / root


def _soft_l1(s: Array, knee: float) -> tuple[Array, Array]:
    root = np.sqrt(1 + s / knee)
    return 2 * knee * (root - 1), 1 / root


# Cost rho(s) of a squared residual s, and its slope (Triggs et al. 2000; the second-order term is left out).
_LOSS: dict[Loss, Callable[[Array, float], tuple[Array, Array]]] = {
    "linear": lambda s, _: (s, np.ones_like(s)),
    "huber": _huber,
    "soft_l1": _soft_l1,
}


class PoseFunctions:
    """The residual of one pose and its Jacobian; shared by all robots of one structure.

    A pose's numbers are its data (see `data_columns`) and u; those shared by all are x and the robot's (see
    `robot_numbers`).

    residual : the residual r, shape (m,), in units of sigma, without the loss, and the transpose of its Jacobian by z,
        shape (z, m); value : r alone, a fifth of it
    point : whether z ends with an unknown point; observed : names of the observed arrays in data, in their order
    """

    def __init__(
        self, model: Expressions, kind: MeasurementKind, point: bool, chosen: tuple[int, ...], fixed_loads: bool
    ) -> None:
        self.kind, self.point, self.fixed_loads = kind, point, fixed_loads
        x = ca.SX.sym("x", len(chosen))
        u = ca.SX.sym("u", 3 if point else 0)
        nominal = ca.SX.sym("nominal", model.phi.numel())
        constants = ca.SX.sym("constants", model.constants.numel())
        scale = ca.SX.sym("scale", len(chosen))
        phi = ca.SX(nominal)
        for k, index in enumerate(chosen):
            phi[index] += scale[k] * x[k]
        q, w = ca.SX.sym("q", model.q.numel()), ca.SX.sym("w", model.w.numel())
        function, loaded = model.function("p", "R"), nominal if fixed_loads else phi
        pose = PoseExpression(lambda at: function(at, w, phi, constants, loaded), q, POINT_SCALE * u if point else None)
        r = kind.residual(pose)
        if r.numel() != kind.numbers:
            raise InputError(f"kind {kind.name!r}: its residual has {r.numel()} numbers; it observes {kind.numbers}")
        inverse, root = ca.SX.sym("inverse", 2 if kind.angles else 1), ca.SX.sym("root")
        sigmas = [inverse[0]] * kind.lengths + [inverse[-1]] * kind.angles
        self.observed = tuple(pose.observed)
        r = r * ca.vertcat(*sigmas) * root
        of_pose = ca.vertcat(q, w, *pose.observed.values(), inverse, root, u)
        shared = ca.vertcat(x, nominal, constants, scale)
        self.residual = MappedFunction("residual", of_pose, shared, [r, ca.jacobian(r, ca.vertcat(x, u)).T])
        self.value = MappedFunction("value", of_pose, shared, [r])


_kernel = lru_cache(maxsize=64)(PoseFunctions)


def kernel(
    robot: Robot, kind: MeasurementKind, point: bool, names: tuple[str, ...], fixed_loads: bool = False
) -> PoseFunctions:
    """The kernel of one kind of measurement for the chosen parameters of a robot.

    fixed_loads : whether gravity torques are those of the nominal geometry (see `Model`)
    """
    chosen = tuple(robot.parameters.index_of(name) for name in names)
    return _kernel(expressions(robot.structure, fixed_loads), kind, point, chosen, fixed_loads)


def robot_numbers(robot: Robot, names: Sequence[str]) -> Array:
    """The input `robot` of a kernel: nominal parameters [SI], the model's constants, scales of the chosen ones."""
    scale = [robot.parameters[n].scale for n in names]
    return np.concatenate([robot.parameters.values, robot.constants, scale])


def data_columns(
    robot: Robot, m: Measurements, observed: Sequence[str], points: Array, sigma: float, sigma_angle: float
) -> Array:
    """A kernel's data, shape (numbers, n): readings, conditions, observed arrays, 1/sigma, root of the weight.

    observed : as of the kernel; points : start of each pose's unknown point, shape (n, 3) [m]
    """
    arrays = {**m.arrays, "point": points}
    sigmas = [sigma, sigma_angle] if find_kind(m.kind).angles else [sigma]
    inverse = np.tile(1 / np.array(sigmas), (len(m), 1))
    conditions = m.condition_matrix(robot.conditions, robot.declared)
    parts = [m.q, conditions, *(arrays[name] for name in observed), inverse, np.sqrt(m.weight)]
    return np.concatenate([np.asarray(p, dtype=float).reshape(len(m), -1) for p in parts], axis=1).T


@dataclass(frozen=True, eq=False)
class Block:
    """One set of measurements, ready to be evaluated for the chosen parameters.

    data : of some poses, shape (numbers, k); group : index of each pose's point among all unknown points, shape (n,)
    robot : see `robot_numbers`
    """

    kernel: PoseFunctions
    data: Callable[[slice], Array]
    group: Array
    robot: Array

    def with_names(self, robot: Robot, names: tuple[str, ...]) -> "Block":
        """The same measurements for other parameters of the robot."""
        k = self.kernel
        return replace(
            self, kernel=kernel(robot, k.kind, k.point, names, k.fixed_loads), robot=robot_numbers(robot, names)
        )

    def evaluate(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Residuals, shape (n, m), and Jacobians, shape (n, m, z); x : (p,), u : (K, 3) in solver units."""
        parts = [part for _, *part in self.parts(x, u)]
        r, J = (np.concatenate(both) if len(parts) > 1 else both[0] for both in zip(*parts, strict=True))
        return r, J

    def parts(self, x: Array, u: Array) -> Iterator[tuple[slice, Array, Array]]:
        """As `evaluate`, some poses at a time: which, their residuals and their Jacobians."""
        for some, (r, J) in self._called(self.kernel.residual, x, u):
            yield some, r.T, J.T.reshape(*r.T.shape, -1)

    def residuals(self, x: Array, u: Array) -> Iterator[Array]:
        """As `parts`, the residuals alone; machine code of both is faster than CasADi is with the residual."""
        both, value = self.kernel.residual, self.kernel.value
        for _, (r, *_) in self._called(both if both.is_compiled else value, x, u):
            yield r.T

    def _called(self, function: MappedFunction, x: Array, u: Array) -> Iterator[tuple[slice, list[Array]]]:
        """Outputs of one of the kernel's functions, some poses at a time."""
        shared = np.concatenate([x, self.robot])
        for start in range(0, len(self.group), MAX_CHUNK_POINTS):
            some = slice(start, min(start + MAX_CHUNK_POINTS, len(self.group)))
            data = self.data(some)
            yield some, function(np.concatenate([data, u[self.group[some]].T]) if self.kernel.point else data, shared)


def make_block(
    robot: Robot,
    m: Measurements,
    names: Sequence[str],
    sigma: float,
    sigma_angle: float,
    points: Array,
    group: Array,
    *,
    fixed_loads: bool = False,
    held: int = HELD,
) -> Block:
    """Measurements as a block; points : shape (K, 3) [m], all points' starts; group, fixed_loads : see above.

    held : most poses whose data are kept
    """
    kind = find_kind(m.kind)
    compiled = kernel(robot, kind, bool(kind.point_names(m.arrays)), tuple(names), fixed_loads)

    def data(m: Measurements, at: slice) -> Array:
        start = points[group[at]] if len(points) else np.zeros((len(m), 3))
        return data_columns(robot, m, compiled.observed, start, sigma, sigma_angle)

    whole = data(m, slice(None)) if len(m) <= held else None
    of_some = (lambda at: whole[:, at]) if whole is not None else (lambda at: data(m[at], at))
    return Block(compiled, of_some, group, robot_numbers(robot, names))


def loss_value(loss: Loss, r: Array) -> Array:
    """Square of each pose's residual through the loss, shape (n,), for residuals r, shape (n, m), in units of sigma."""
    return _LOSS[loss](np.einsum("ij,ij->i", r, r), KNEE[r.shape[1]])[0]


def loss_slope(loss: Loss, r: Array) -> Array:
    """Weight that the loss gives each pose, shape (n,), for residuals r, shape (n, m), in units of sigma."""
    return _LOSS[loss](np.einsum("ij,ij->i", r, r), KNEE[r.shape[1]])[1]

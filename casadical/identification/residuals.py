"""Residuals of every kind of measurement with their Jacobian, as mapped CasADi functions.

A kernel evaluates one pose. Its variables z = (x, u) are the departures x of the free parameters
from the robot's nominal values in units of their scale (mm, mrad) and, where the kind has an
unknown point, that point's departure u [mm]. Its residual is in units of sigma.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Any, Literal

import casadi as ca
import numpy as np

from casadical.core.basics import M_PER_MM, Array, InputError
from casadical.core.mapped_function import MAX_CHUNK_POINTS, MappedFunction
from casadical.measurements.kinds.base import MeasurementKind, PoseExpression
from casadical.measurements.kinds.position import Position
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.robot.model import Expressions, expressions, is_rigid, rigid_chain
from casadical.robot.robot import Robot

# Name of a loss: the cost of a pose as a function of the squared norm of its residuals.
Loss = Literal["linear", "huber", "soft_l1"]
# Name of a loss, or "auto": huber where that finds outliers, else linear.
AnyLoss = Literal["auto", Loss]

# Names of all losses of a pose's squared residual, and "auto", as an identification accepts them.
ALL_LOSSES: tuple[AnyLoss, ...] = ("auto", "linear", "huber", "soft_l1")
# The inputs of the residual function are cached for sets of up to this number of poses; those of
# larger sets are assembled again at each evaluation.
MAX_CACHED_DATA_POSES = 100_000

# Number of residuals of a pose -> squared norm at which a robust loss departs from the parabola:
# the 95 % quantile of a chi-squared distribution with as many degrees of freedom.
LOSS_KNEE_SQUARE = {1: 3.84, 2: 5.99, 3: 7.81, 4: 9.49, 5: 11.07, 6: 12.59}


def loss_and_slope(loss: Loss, r: Array) -> tuple[Array, Array]:
    """Return the loss rho(s) of each pose and its slope rho'(s), shape (n,) each.

    s is the squared norm of the pose's residuals. "huber" is s up to the knee of `LOSS_KNEE_SQUARE`
    and beyond it grows as the norm; "soft_l1" is a smooth form of it, 2 k (sqrt(1 + s / k) - 1)
    with the knee k (Triggs et al. 2000, without the second-order term).

    r : residuals of n poses, shape (n, m), in units of sigma
    """
    s, knee = np.einsum("ij,ij->i", r, r), LOSS_KNEE_SQUARE[r.shape[1]]
    if loss == "huber":
        root = np.sqrt(np.maximum(s, knee) * knee)
        return np.where(s <= knee, s, 2 * root - knee), knee / root
    if loss == "soft_l1":
        root = np.sqrt(1 + s / knee)
        return 2 * knee * (root - 1), 1 / root
    return s, np.ones_like(s)


class PoseFunctions:
    """Residual and Jacobian of one pose as CasADi functions, for robots of one structure.

    The inputs of a pose are its data (see `data_columns`) and u; those shared by all poses are x
    and the robot's numbers (see `robot_numbers`).

    kind : of the measurement; point : whether z ends with an unknown point
    fixed_loads : whether gravity torques are those of the nominal geometry
    residual : function of the residual r, shape (m,), in units of sigma, times the root of the
        pose's weight, without the loss, and the transpose of its Jacobian by z, shape (z, m)
    observed : names of the measured arrays in a pose's data, in their order
    """

    residual: Any

    def __init__(
        self, model: Expressions, kind: MeasurementKind, point: bool, chosen: tuple[int, ...], fixed_loads: bool
    ) -> None:
        """Build the functions for the model of a robot; other arguments are as of the class.

        chosen : indices of the free parameters among all
        """
        self.kind, self.point, self.fixed_loads = kind, point, fixed_loads
        x = ca.SX.sym("x", len(chosen))
        u = ca.SX.sym("u", 3 if point else 0)
        nominal = ca.SX.sym("nominal", model.phi.numel())
        constants = ca.SX.sym("constants", model.constants.numel())
        scale = ca.SX.sym("scale", len(chosen))
        phi = ca.SX(nominal)
        phi[[*chosen]] += scale * x
        q, w = ca.SX.sym("q", model.q.numel()), ca.SX.sym("w", model.w.numel())
        function, loaded = model.function("p", "R"), nominal if fixed_loads else phi
        pose = PoseExpression(lambda at: function(at, w, phi, constants, loaded), q, M_PER_MM * u if point else None)
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
        self._value = partial(MappedFunction, "value", of_pose, shared, [r])

    @cached_property
    def value(self) -> Any:
        """Function of the residual r alone, which takes a fifth of the time of both."""
        return self._value()


class RigidPositions(PoseFunctions):
    """Residual and Jacobian of a measured position of a rigid chain, without graphs of CasADi."""

    def __init__(self, robot: Robot, kind: MeasurementKind, chosen: tuple[int, ...], fixed_loads: bool) -> None:
        """Take the chain of a robot; other arguments are as of `PoseFunctions`."""
        self.kind, self.point, self.fixed_loads = kind, False, fixed_loads
        self.observed, self._n, self._chosen = ("position",), robot.n, chosen
        self.residual, self.value = (partial(self._evaluated, both) for both in (True, False))
        kinds = tuple(joint.kind for joint in robot.joints)
        self._count = len(robot.parameters)
        self._chain = rigid_chain(kinds, robot.parameters.names, chosen)

    def _evaluated(self, derivatives: bool, points: Array, shared: Array) -> list[Array]:
        """Return the residual, shape (3, n), and the transposed Jacobian, (z, 3 n), in sigmas.

        derivatives : whether the Jacobian is computed; if not, its shape is (0, 3 n)
        points, shared : inputs of n poses and of all, as of `PoseFunctions`, shapes (k, n) and (l,)
        """
        free = len(self._chosen)
        edges = [free, free + self._count, len(shared) - free]
        x, phi, constants, scale = np.split(shared, edges)
        phi, weight = phi.copy(), points[-1] * points[-2]
        phi[[*self._chosen]] += scale * x
        p, _, J = self._chain(points[: self._n], phi, constants, scale if derivatives else None, weight)
        return [(p - points[-5:-2]) * weight, J.reshape(len(J), 3 * len(weight))]


# Return the `PoseFunctions` for the same arguments; they are cached, because building takes long.
_kernel = lru_cache(maxsize=64)(PoseFunctions)


def kernel(
    robot: Robot, kind: MeasurementKind, point: bool, names: tuple[str, ...], fixed_loads: bool = False
) -> PoseFunctions:
    """Return the residual and Jacobian functions of one pose of a kind of measurement.

    point : whether the pose has an unknown point
    names : free parameters of the robot, by which Jacobians are taken
    fixed_loads : whether gravity torques are those of the nominal geometry (see `expressions`)
    """
    chosen = tuple(robot.parameters.index_of(name) for name in names)
    rigid = is_rigid(robot.structure, robot.parameters.values, chosen)
    if rigid and type(kind) is Position and not point:
        return RigidPositions(robot, kind, chosen, fixed_loads)
    return _kernel(expressions(robot.structure, fixed_loads), kind, point, chosen, fixed_loads)


def robot_numbers(robot: Robot, names: Sequence[str]) -> Array:
    """Return the inputs of a kernel that all poses share, except x, as one vector.

    These are the nominal values of all parameters [SI], the model's constants (see `constants_of`)
    and the scales of the free parameters `names` [SI].
    """
    scale = [robot.parameters[n].scale for n in names]
    return np.concatenate([robot.parameters.values, robot.constants, scale])


def data_columns(
    robot: Robot, m: Measurements, observed: Sequence[str], points: Array, sigma: float, sigma_angle: float
) -> Array:
    """Return a kernel's inputs that differ between poses, shape (numbers, n), a column per pose.

    These are joint variables, conditions, measured arrays, 1/sigma and the root of a pose's weight.

    observed : names of the measured arrays, as of the kernel
    points : initial position of each pose's unknown point in the measuring frame, shape (n, 3) [m]
    sigma, sigma_angle : standard deviations of a length [m] and an angle [rad]
    """
    arrays = {**m.arrays, "point": points}
    sigmas = [sigma, sigma_angle] if find_kind(m.kind).angles else [sigma]
    inverse = np.tile(1 / np.array(sigmas), (len(m), 1))
    conditions = m.condition_matrix(robot.conditions, robot.declared)
    parts = [m.q, conditions, *(arrays[name] for name in observed), inverse, np.sqrt(m.weight)]
    return np.concatenate([np.asarray(p, dtype=float).reshape(len(m), -1) for p in parts], axis=1).T


@dataclass(frozen=True, eq=False)
class Block:
    """One set of measurements, ready to be evaluated for some free parameters.

    kernel : residual and Jacobian functions of a pose
    data : slice of k poses -> the kernel's inputs that differ between poses, shape (numbers, k)
    group : index of each pose's point among all unknown points, shape (n,); zeros without any
    robot : the kernel's inputs that all poses share, except x, see `robot_numbers`
    """

    kernel: PoseFunctions
    data: Callable[[slice], Array]
    group: Array
    robot: Array

    def with_names(self, robot: Robot, names: tuple[str, ...]) -> "Block":
        """Return the block of the same measurements for other free parameters of the robot."""
        k = self.kernel
        return replace(
            self, kernel=kernel(robot, k.kind, k.point, names, k.fixed_loads), robot=robot_numbers(robot, names)
        )

    def evaluate(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Return residuals, shape (n, m), and their Jacobians, shape (n, m, z), in units of sigma.

        Residuals are without the loss; z is x followed by the pose's own unknown point, if any.

        x : departures of the free parameters in units of their scale, shape (p,)
        u : departures of all unknown points from the start, shape (K, 3) [mm]
        """
        parts = [part for _, *part in self.parts(x, u)]
        r, J = (np.concatenate(both) if len(parts) > 1 else both[0] for both in zip(*parts, strict=True))
        return r, J

    def parts(self, x: Array, u: Array) -> Iterator[tuple[slice, Array, Array]]:
        """Yield slice of poses, residuals and Jacobians, part by part; shapes as of `evaluate`."""
        for some, (r, J) in self._called(self.kernel.residual, x, u):
            yield some, r.T, J.T.reshape(*r.T.shape, -1)

    def residuals(self, x: Array, u: Array) -> Iterator[Array]:
        """Yield the residuals of some poses at a time, shape (n, m), in units of sigma.

        Compiled code of both is faster than CasADi's interpreter for the residual alone.
        """
        both, value = self.kernel.residual, self.kernel.value
        function = both if getattr(both, "is_compiled", False) else value
        for _, (r, *_) in self._called(function, x, u):
            yield r.T

    def _called(self, function: Any, x: Array, u: Array) -> Iterator[tuple[slice, list[Array]]]:
        """Yield a slice of poses and a kernel function's outputs there, the poses as last axis."""
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
    max_cached: int = MAX_CACHED_DATA_POSES,
) -> Block:
    """Return a set of measurements as a block, from which residuals and Jacobians are evaluated.

    names : free parameters; sigma, sigma_angle : standard deviations of a coordinate [m] and an
        angle [rad]
    points : initial positions of all unknown points in the measuring frame, shape (K, 3) [m]
    group : index of each pose's point among these, shape (n,); fixed_loads : see `kernel`
    max_cached : number of poses up to which their inputs are cached
    """
    kind, arrays = find_kind(m.kind), m.arrays
    compiled = kernel(robot, kind.of(arrays), bool(kind.point_names(arrays)), tuple(names), fixed_loads)

    def data(m: Measurements, at: slice) -> Array:
        """Return the kernel's inputs of the k poses m, shape (numbers, k); at : their slice."""
        start = points[group[at]] if len(points) else np.zeros((len(m), 3))
        return data_columns(robot, m, compiled.observed, start, sigma, sigma_angle)

    whole = data(m, slice(None)) if len(m) <= max_cached else None
    of_some = (lambda at: whole[:, at]) if whole is not None else (lambda at: data(m[at], at))
    return Block(compiled, of_some, group, robot_numbers(robot, names))

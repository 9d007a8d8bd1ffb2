"""Residuals of every kind of measurement as mapped CasADi kernels: cost, gradient and Gauss-Newton Hessian per pose.

A kernel sees one pose. Its variables z = (x, u) are the departures x of the chosen parameters from the robot's nominal
values in units of their scale (mm, mrad) and, where the kind has an unknown point, that point's departure u [mm]. Its
residual is in units of sigma. `Function.map` sums the kernel over the poses, so that graphs do not grow with them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import casadi as ca
import numpy as np

from casadical.core.arrays import Array
from casadical.core.casadi_buffers import call
from casadical.core.compile_cache import compiled
from casadical.core.errors import InputError
from casadical.measurements.kinds.base import MeasurementKind, PoseExpression
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.robot.model import Expressions, expressions
from casadical.robot.robot import Robot

Loss = Literal["linear", "huber", "soft_l1"]

LOSSES: tuple[Loss, ...] = ("linear", "huber", "soft_l1")
POINT_SCALE = 1e-3
CHUNK = 512
# From this many poses on, compiling saves more time than it takes.
COMPILE_FROM = 2000

# Square of the normalised residual at which a robust loss leaves the parabola: the 95 % quantile of a chi-squared
# distribution with as many degrees of freedom as the kind observes.
_KNEE = {1: 3.84, 2: 5.99, 3: 7.81, 4: 9.49, 5: 11.07, 6: 12.59}


def _linear(s: ca.SX, _knee: float) -> tuple[ca.SX, ca.SX]:
    return s, ca.SX(1)


def _huber(s: ca.SX, knee: float) -> tuple[ca.SX, ca.SX]:
    root = ca.sqrt(ca.fmax(s, knee) * knee)
    return ca.if_else(s <= knee, s, 2 * root - knee), knee / root


def _soft_l1(s: ca.SX, knee: float) -> tuple[ca.SX, ca.SX]:
    root = ca.sqrt(1 + s / knee)
    return 2 * knee * (root - 1), 1 / root


# Cost rho(s) of a squared residual s, and its slope (Triggs et al. 2000; the second-order term is left out).
_LOSS: dict[Loss, Callable[[ca.SX, float], tuple[ca.SX, ca.SX]]] = {
    "linear": _linear,
    "huber": _huber,
    "soft_l1": _soft_l1,
}


class PoseFunctions:
    """Functions of one pose, each made when it is first asked for; shared by all robots of one structure.

    robot : the numbers that differ between them: nominal parameters, constants, scales (see `robot_numbers`)
    residual : (z, data, robot)->(r[m], J[m, z]), in units of sigma, without the loss
    cost, gradient, hessian : (z, data, robot)->f, (f, g[z]), h, with the loss; h is the upper triangle by columns
    point : whether z ends with an unknown point; observed : names of the observed arrays in data, in their order
    """

    def __init__(
        self,
        model: Expressions,
        kind: MeasurementKind,
        point: bool,
        chosen: tuple[int, ...],
        loss: Loss,
        fixed_loads: bool,
    ) -> None:
        self.point = point
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
        self._r = r * ca.vertcat(*sigmas) * root
        self.observed = tuple(pose.observed)
        self._z = ca.vertcat(x, u)
        columns = [q, w, *pose.observed.values(), inverse, root]
        self._inputs = [self._z, ca.vertcat(*columns), ca.vertcat(nominal, constants, scale)]
        cost, self._slope = _LOSS[loss](ca.dot(self._r, self._r), _KNEE[r.numel()])
        self._cost = 0.5 * cost
        self._mapped: dict[tuple[str, int, bool, bool], ca.Function] = {}

    def _function(self, name: str, *outputs: ca.SX) -> ca.Function:
        return ca.Function(name, self._inputs, list(outputs))

    def mapped(self, name: str, n: int, *, total: bool, machine_code: bool) -> ca.Function:
        """A function over n poses, robot shared; outputs side by side, or (`total`) summed with z shared too."""
        key = (name, n, total, machine_code)
        if key not in self._mapped:
            f = self.machine_code(name) if machine_code else getattr(self, name)
            self._mapped[key] = f.map("poses", "serial", n, [0, 2] if total else [2], [0] if total else [])
        return self._mapped[key]

    @lru_cache(maxsize=8)  # noqa: B019 - kernels live in a cache themselves
    def machine_code(self, name: str) -> ca.Function:
        """A function through the C compiler, where there is one."""
        return compiled(getattr(self, name))

    @cached_property
    def _J(self) -> ca.SX:
        return ca.densify(ca.jacobian(self._r, self._z))

    @cached_property
    def residual(self) -> ca.Function:
        return self._function("residual", self._r, self._J)

    @cached_property
    def cost(self) -> ca.Function:
        return self._function("cost", self._cost)

    @cached_property
    def gradient(self) -> ca.Function:
        return self._function("gradient", ca.vertcat(self._cost, ca.gradient(self._cost, self._z)))

    @cached_property
    def hessian(self) -> ca.Function:
        H = self._slope * (self._J.T @ self._J)
        return self._function("hessian", ca.project(H, ca.Sparsity.upper(self._z.numel())).nz[:])


_kernel = lru_cache(maxsize=64)(PoseFunctions)


def kernel(
    robot: Robot, kind: MeasurementKind, point: bool, names: tuple[str, ...], loss: Loss, fixed_loads: bool = False
) -> PoseFunctions:
    """The kernel of one kind of measurement for the chosen parameters of a robot.

    fixed_loads : whether gravity torques are those of the nominal geometry (see `model.build`)
    """
    chosen = tuple(robot.parameters.index_of(name) for name in names)
    return _kernel(expressions(robot.structure, fixed_loads), kind, point, chosen, loss, fixed_loads)


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

    data : shape (numbers, n); group : index of each pose's point among all unknown points, shape (n,)
    robot : see `robot_numbers`
    """

    kernel: PoseFunctions
    data: Array
    group: Array
    robot: Array

    @property
    def _machine_code(self) -> bool:
        return bool(self.data.shape[1] >= COMPILE_FROM)

    def evaluate(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Residuals, shape (n, m), and Jacobians, shape (n, m, z); x : (p,), u : (K, 3) in solver units."""
        n = self.data.shape[1]
        z = np.tile(x[:, None], n)
        if self.kernel.point:
            z = np.concatenate([z, u[self.group].T])
        f = self.kernel.mapped("residual", n, total=False, machine_code=self._machine_code)
        r, J = call(f, z, self.data, self.robot)
        return r.T, J.T.reshape(n, z.shape[0], len(r)).transpose(0, 2, 1)

    def cost(self, x: ca.MX, u: ca.MX) -> ca.MX:
        """The block's cost; x : (p,), u : (3, K) in solver units."""
        return self._summed("cost", x, u)[0]

    def gradient(self, x: ca.MX, u: ca.MX) -> tuple[ca.MX, ca.MX]:
        """Cost, and gradient over v = (x, u), shape (p + 3 K,)."""
        shared, by_point = self._summed("gradient", x, u, shared=1 + x.numel())
        return shared[0], ca.vertcat(shared[1:], by_point)

    def hessian(self, x: ca.MX, u: ca.MX) -> ca.MX:
        """Gauss-Newton Hessian over v = (x, u), upper triangle, shape (p + 3 K, p + 3 K)."""
        p, K = x.numel(), u.size2()
        shared, by_point = self._summed("hessian", x, u, shared=p * (p + 1) // 2)
        pattern = ca.Sparsity.upper(p)
        if not self.kernel.point:
            pattern.resize(p + 3 * K, p + 3 * K)
            return ca.MX(pattern, shared)
        # Column (k, j) of the whole Hessian holds rows x and the rows of point k up to j: just as the kernel's does.
        rows, columns = pattern.get_triplet()
        for k in range(K):
            for j in range(3):
                rows = [*rows, *range(p), *range(p + 3 * k, p + 3 * k + j + 1)]
                columns = [*columns, *([p + 3 * k + j] * (p + j + 1))]
        whole = ca.Sparsity.triplet(p + 3 * K, p + 3 * K, rows, columns)
        return ca.MX(whole, ca.vertcat(shared, by_point))

    def _summed(self, name: str, x: ca.MX, u: ca.MX, shared: int = 1) -> tuple[ca.MX, ca.MX]:
        """Sum over the poses of the first `shared` outputs, and of the others point by point (stacked)."""
        if not self.kernel.point:
            return self._sum_over_poses(name, x), ca.MX.zeros(u.numel() if name == "gradient" else 0)
        n, K = self.data.shape[1], u.size2()
        z = ca.vertcat(ca.repmat(x, 1, n), u[:, self.group.tolist()])
        f = self.kernel.mapped(name, n, total=False, machine_code=self._machine_code)
        out = f(z, ca.DM(self.data), ca.DM(self.robot))
        member = ca.DM(ca.Sparsity.triplet(n, K, list(range(n)), self.group.tolist()), 1.0)
        return ca.sum2(out[:shared, :]), ca.vec(out[shared:, :] @ member)

    def _sum_over_poses(self, name: str, x: ca.MX) -> ca.MX:
        """Sum over all poses, in chunks of one length, so that memory does not grow with the poses."""
        data, robot = self.data, ca.DM(self.robot)
        n = data.shape[1]
        f = self.kernel.mapped(name, min(n, CHUNK), total=True, machine_code=self._machine_code)
        if n <= CHUNK:
            return f(x, ca.DM(data), robot)
        chunks = -(-n // CHUNK)
        # The last chunk is filled with copies of the first pose at weight zero (the last number of a column).
        fill = np.repeat(data[:, :1], chunks * CHUNK - n, axis=1)
        fill[-1] = 0.0
        z, d, k = ca.MX.sym("z", x.numel()), ca.MX.sym("d", data.shape[0], CHUNK), ca.MX.sym("k", robot.numel())
        chunk = ca.Function("chunk", [z, d, k], [f(z, d, k)])
        whole = chunk.map("chunks", "serial", chunks, [0, 2], [0])
        return whole(x, ca.DM(np.concatenate([data, fill], axis=1)), robot)


def make_block(
    robot: Robot,
    m: Measurements,
    names: Sequence[str],
    loss: Loss,
    sigma: float,
    sigma_angle: float,
    points: Array,
    group: Array,
    *,
    fixed_loads: bool = False,
) -> Block:
    """Measurements as a block; points : shape (K, 3) [m], all points' starts; group, fixed_loads : see above."""
    start = points[group] if len(points) else np.zeros((len(m), 3))
    kind = find_kind(m.kind)
    found = kernel(robot, kind, bool(kind.point_names(m.arrays)), tuple(names), loss, fixed_loads)
    data = data_columns(robot, m, found.observed, start, sigma, sigma_angle)
    return Block(found, data, group, robot_numbers(robot, names))


def loss_value(loss: Loss, r: Array) -> Array:
    """Square of each pose's residual through the loss, shape (n,), for residuals r, shape (n, m), in units of sigma."""
    value, _ = _LOSS[loss](ca.SX((r**2).sum(axis=1)), _KNEE[r.shape[1]])
    return np.broadcast_to(ca.DM(value).full().ravel(), (len(r),))


def loss_slope(loss: Loss, r: Array) -> Array:
    """Weight that the loss gives each pose, shape (n,), for residuals r, shape (n, m), in units of sigma."""
    _, slope = _LOSS[loss](ca.SX((r**2).sum(axis=1)), _KNEE[r.shape[1]])
    return np.broadcast_to(ca.DM(slope).full().ravel(), (len(r),))

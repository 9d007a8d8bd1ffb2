"""Residuals of every kind of measurement as mapped CasADi kernels: cost, gradient and Gauss-Newton Hessian per pose.

A kernel sees one pose. Its variables z = (x, u) are the departures x of the chosen parameters from the robot's nominal
values in units of their scale (mm, mrad) and, where the kind has an unknown point, that point's departure u [mm]. Its
residual is in units of sigma. `Function.map` sums the kernel over the poses, so that graphs do not grow with them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal

import casadi as ca
import numpy as np

from .compiled import compiled
from .measurements import Kind, Measurements
from .robot import Robot
from .transforms import Array

Loss = Literal["linear", "huber", "soft_l1"]

LOSSES: tuple[Loss, ...] = ("linear", "huber", "soft_l1")
POINT_SCALE = 1e-3
CHUNK = 512
# From this many poses on, a C compiler pays for itself.
COMPILE_FROM = 2000

# Square of the normalised residual at which a robust loss leaves the parabola: the 95 % quantile of a chi-squared
# distribution with as many degrees of freedom as the kind observes.
_KNEE = {1: 3.84, 3: 7.81, 6: 12.59}


class _Pose:
    """What a residual may use: the model at this pose, its unknown point, and its column of data, taken in order."""

    def __init__(self, robot: Robot, phi: ca.SX, u: ca.SX, fixed_loads: bool) -> None:
        model = robot.model_of_fixed_loads if fixed_loads else robot.model
        self._model = model.function("pose", ("p", "R"))
        self._phi = phi
        self.columns: list[ca.SX] = []
        self.n, self.u = robot.n, u
        q, self._w = self.take(robot.n), self.take(len(robot.conditions))
        self.p, self.R = self._model(q, self._w, phi)

    def take(self, count: int) -> ca.SX:
        self.columns.append(ca.SX.sym(f"d{len(self.columns)}", count))
        return self.columns[-1]

    def position_at(self, q: ca.SX) -> ca.SX:
        return self._model(q, self._w, self._phi)[0]


def _position(pose: _Pose) -> ca.SX:
    return (pose.p - pose.take(3)) * pose.take(1)


def _full_pose(pose: _Pose) -> ca.SX:
    y, Y = pose.take(3), ca.reshape(pose.take(9), 3, 3)
    # sin(angle) times the axis of Y' R: smooth, and the rotation vector itself to third order.
    E = Y.T @ pose.R
    turn = 0.5 * ca.vertcat(E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1])
    return ca.vertcat((pose.p - y) * pose.take(1), turn * pose.take(1))


def _distance(pose: _Pose) -> ca.SX:
    return (ca.norm_2(pose.p - pose.take(3) - POINT_SCALE * pose.u) - pose.take(1)) * pose.take(1)


def _pair_distance(pose: _Pose) -> ca.SX:
    return (ca.norm_2(pose.p - pose.position_at(pose.take(pose.n))) - pose.take(1)) * pose.take(1)


def _contact(pose: _Pose) -> ca.SX:
    return (pose.p - pose.take(3) - POINT_SCALE * pose.u) * pose.take(1)


_RESIDUAL: dict[Kind, Callable[[_Pose], ca.SX]] = {
    "position": _position,
    "pose": _full_pose,
    "distance": _distance,
    "pair_distance": _pair_distance,
    "contact": _contact,
}


def has_point(m: Measurements) -> bool:
    """Whether its poses refer to points that are identified too."""
    return m.kind == "contact" or (m.kind == "distance" and m.target is None)


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


class Kernel:
    """Functions of one pose, each made when it is first asked for.

    residual : (z, data)->(r[m], J[m, z]), in units of sigma, without the loss
    cost, gradient, hessian : (z, data)->f, g[z], h, with the loss; h holds the columns of the upper triangle
    point : whether z ends with an unknown point
    fixed_loads : whether gravity torques are those of the nominal geometry (see `model.build`)
    """

    def __init__(
        self, robot: Robot, kind: Kind, point: bool, names: tuple[str, ...], loss: Loss, fixed_loads: bool = False
    ) -> None:
        self.point = point
        x = ca.SX.sym("x", len(names))
        u = ca.SX.sym("u", 3) if point else ca.SX.zeros(3)
        phi = ca.SX(ca.DM(robot.parameters.values))
        for k, name in enumerate(names):
            index = robot.parameters.index_of(name)
            phi[index] += robot.parameters[index].scale * x[k]
        pose = _Pose(robot, phi, u, fixed_loads)
        r = _RESIDUAL[kind](pose)
        self._r = r * pose.take(1)
        self._z = ca.vertcat(x, u) if point else x
        self._data = ca.vertcat(*pose.columns)
        cost, self._slope = _LOSS[loss](ca.dot(self._r, self._r), _KNEE[r.numel()])
        self._cost = 0.5 * cost

    def _function(self, name: str, *outputs: ca.SX) -> ca.Function:
        return ca.Function(name, [self._z, self._data], list(outputs))

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
        return self._function("gradient", ca.gradient(self._cost, self._z))

    @cached_property
    def hessian(self) -> ca.Function:
        H = self._slope * (self._J.T @ self._J)
        return self._function("hessian", ca.project(H, ca.Sparsity.upper(self._z.numel())).nz[:])


kernel = lru_cache(maxsize=64)(Kernel)


def data_columns(robot: Robot, m: Measurements, points: Array, sigma: float, sigma_angle: float) -> Array:
    """A kernel's data, shape (numbers, n): readings, conditions, observation, 1/sigma, root of the weight.

    points : start of each pose's unknown point, shape (n, 3) [m]; not used by kinds without one
    """
    inverse = np.full(len(m), 1 / sigma)
    observed: dict[Kind, list[Any]] = {
        "position": [m.position, inverse],
        "pose": [m.position, None if m.orientation is None else m.orientation.transpose(0, 2, 1), inverse,
                 np.full(len(m), 1 / sigma_angle)],
        "distance": [points if m.target is None else m.target, m.distance, inverse],
        "pair_distance": [m.other, m.distance, inverse],
        "contact": [points, inverse],
    }  # fmt: skip
    conditions = m.condition_matrix(robot.conditions, robot.declared)
    parts = [m.q, conditions, *observed[m.kind], np.sqrt(m.weight)]
    return np.concatenate([np.asarray(p, dtype=float).reshape(len(m), -1) for p in parts], axis=1).T


@dataclass(frozen=True, eq=False)
class Block:
    """One set of measurements, ready to be evaluated for the chosen parameters.

    data : shape (numbers, n); group : index of each pose's point among all unknown points, shape (n,)
    """

    kernel: Kernel
    data: Array
    group: Array

    def _ready(self, f: ca.Function) -> ca.Function:
        return compiled(f) if self.data.shape[1] >= COMPILE_FROM else f

    def evaluate(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Residuals, shape (n, m), and Jacobians, shape (n, m, z); x : (p,), u : (K, 3) in solver units."""
        n = self.data.shape[1]
        z = np.tile(x[:, None], n)
        if self.kernel.point:
            z = np.concatenate([z, u[self.group].T])
        r, J = self._ready(self.kernel.residual).map(n)(z, self.data)
        m = r.shape[0]
        return r.full().T, J.full().T.reshape(n, z.shape[0], m).transpose(0, 2, 1)

    def cost(self, x: ca.MX, u: ca.MX) -> ca.MX:
        """The block's cost; x : (p,), u : (3, K) in solver units."""
        return self._summed(self.kernel.cost, x, u)[0]

    def gradient(self, x: ca.MX, u: ca.MX) -> ca.MX:
        """Gradient over v = (x, u), shape (p + 3 K,)."""
        p = x.numel()
        g, by_point = self._summed(self.kernel.gradient, x, u, shared=p)
        return ca.vertcat(g, by_point)

    def hessian(self, x: ca.MX, u: ca.MX) -> ca.MX:
        """Gauss-Newton Hessian over v = (x, u), upper triangle, shape (p + 3 K, p + 3 K)."""
        p, K = x.numel(), u.size2()
        shared, by_point = self._summed(self.kernel.hessian, x, u, shared=p * (p + 1) // 2)
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

    def _summed(self, f: ca.Function, x: ca.MX, u: ca.MX, shared: int = 1) -> tuple[ca.MX, ca.MX]:
        """Sum over the poses of the first `shared` outputs, and of the others point by point (stacked)."""
        f = self._ready(f)
        if not self.kernel.point:
            return _sum_over_poses(f, self.data, x), ca.MX.zeros(u.numel() if f.name() == "gradient" else 0)
        n, K = self.data.shape[1], u.size2()
        out = f.map(n)(ca.vertcat(ca.repmat(x, 1, n), u[:, self.group.tolist()]), ca.DM(self.data))
        member = ca.DM(ca.Sparsity.triplet(n, K, list(range(n)), self.group.tolist()), 1.0)
        return ca.sum2(out[:shared, :]), ca.vec(out[shared:, :] @ member)


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
    found = kernel(robot, m.kind, has_point(m), tuple(names), loss, fixed_loads)
    return Block(found, data_columns(robot, m, start, sigma, sigma_angle), group)


def _sum_over_poses(f: ca.Function, data: Array, x: ca.MX) -> ca.MX:
    """Sum over all poses, in chunks of one length, so that memory does not grow with the poses."""
    n = data.shape[1]
    if n <= CHUNK:
        return f.map("poses", "serial", n, [0], [0])(x, ca.DM(data))
    chunks = -(-n // CHUNK)
    # The last chunk is filled with copies of the first pose at weight zero (the last number of a column).
    fill = np.repeat(data[:, :1], chunks * CHUNK - n, axis=1)
    fill[-1] = 0.0
    z, d = ca.MX.sym("z", x.numel()), ca.MX.sym("d", data.shape[0], CHUNK)
    chunk = ca.Function("chunk", [z, d], [f.map("poses", "serial", CHUNK, [0], [0])(z, d)])
    return chunk.map("chunks", "serial", chunks, [0], [0])(x, ca.DM(np.concatenate([data, fill], axis=1)))


def loss_slope(loss: Loss, r: Array) -> Array:
    """Weight that the loss gives each pose, shape (n,), for residuals r, shape (n, m), in units of sigma."""
    _, slope = _LOSS[loss](ca.SX((r**2).sum(axis=1)), _KNEE.get(r.shape[1], 1.0))
    return np.broadcast_to(ca.DM(slope).full().ravel(), (len(r),))

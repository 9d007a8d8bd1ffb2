"""The identification problem: sets of measurements, chosen parameters, unknown points; its solve and its statistics.

Variables are v = (x, u): departures of the chosen parameters from nominal in units of their scale, then three
coordinates [mm] per unknown point. The cost is half the sum of squared residuals in units of sigma (through the robust
loss), of known separations between points, and of priors where they are asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from casadical.core.arrays import Array
from casadical.identification.accuracy import predicted
from casadical.identification.identifiability import (
    Identifiability,
    analyse,
    scaled_inverse,
)
from casadical.identification.residuals import POINT_SCALE, Block, Loss, loss_slope, loss_value, make_block
from casadical.identification.solver import Progress, Solution, minimise
from casadical.identification.steps import solve_in_steps
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

# Taken where no sigma is given, until it is estimated from the residuals.
SIGMA_GUESS, SIGMA_ANGLE_GUESS = 1e-4, 1e-4
# More parameters than this are solved for step by step (see `solve_in_steps`).
WIDE = 200

# They move the robot as a whole.
_WHOLE_ROBOT = (
    "alpha0",
    "a0",
    "beta0",
    "b0",
    "d1",
    "theta1",
    *(f"base_{c}" for c in ("x", "y", "z", "rx", "ry", "rz")),
)


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """One identification problem; see the module's text.

    names : parameters that are variables; sigmas : of one coordinate [m] and angle [rad], for each set
    known : correlated priors: names and their covariance [SI]; their means are those of `priors`
    priors : whether the robot's own priors hold the variables back, or name -> (mean, one sigma) [SI] of other priors
    fixed_loads : whether gravity torques are those of the nominal geometry (see `Model`)
    """

    robot: Robot
    sets: tuple[Measurements, ...]
    names: tuple[str, ...]
    loss: Loss
    priors: bool | Mapping[str, tuple[float, float]]
    sigmas: tuple[tuple[float, float], ...]
    fixed_loads: bool = False
    known: tuple[tuple[tuple[str, ...], Array], ...] = ()

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Names of all unknown points."""
        return tuple(dict.fromkeys(name for k in range(len(self.sets)) for name in self._pose_labels(k)))

    def _pose_labels(self, k: int) -> list[str]:
        m = self.sets[k]
        return [f"{k}/{name}" for name in find_kind(m.kind).point_names(m.arrays)]

    @cached_property
    def points(self) -> Array:
        """Start of every unknown point, shape (K, 3) [m]."""
        start: dict[str, Array] = {}
        for k, m in enumerate(self.sets):
            if labels := self._pose_labels(k):
                p, _ = predicted(self.robot, m)
                start |= dict(zip(labels, find_kind(m.kind).point_starts(m.arrays, p), strict=True))
        return np.array([start[name] for name in self.labels]).reshape(-1, 3)

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        index = {name: k for k, name in enumerate(self.labels)}
        made = []
        for k, (m, (sigma, sigma_angle)) in enumerate(zip(self.sets, self.sigmas, strict=True)):
            group = np.array([index[name] for name in self._pose_labels(k)] or [0] * len(m), dtype=np.int64)
            of_set = (self.robot, m, self.names, self.loss, sigma, sigma_angle, self.points, group)
            made.append(make_block(*of_set, fixed_loads=self.fixed_loads))
        return tuple(made)

    @property
    def size(self) -> int:
        return len(self.names) + 3 * len(self.labels)

    @cached_property
    def residual_count(self) -> int:
        return sum(m.residuals for m in self.sets)

    @property
    def degrees_of_freedom(self) -> int:
        """Numbers that were measured or known before, less variables."""
        return self.residual_count - self.size + int(np.count_nonzero(np.diag(self.prior_matrix)))

    def _parameter(self, what: str) -> Array:
        """Values of an attribute of the chosen parameters, in solver units where it is a length or angle."""
        return np.array([getattr(self.robot.parameters[n], what) for n in self.names])

    @cached_property
    def scale(self) -> Array:
        return self._parameter("scale")

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Of v, in solver units."""
        free = np.full(3 * len(self.labels), np.inf)
        value = self._parameter("value")
        lower = (self._parameter("lower") - value) / self.scale
        upper = (self._parameter("upper") - value) / self.scale
        return np.concatenate([lower, -free]), np.concatenate([upper, free])

    @cached_property
    def prior_matrix(self) -> Array:
        """Inverse of the priors' covariance, shape (size, size) in solver units; zero without priors."""
        weights = np.zeros(self.size)
        if self.priors:
            weights[: len(self.names)] = (self.scale / self._prior[1]) ** 2
        matrix = np.diag(weights)
        for names, covariance in self.known:
            places = [k for k, name in enumerate(self.names) if name in names]
            at = [names.index(self.names[k]) for k in places]
            scale = self.scale[places]
            inverse = np.linalg.inv(covariance[np.ix_(at, at)] / np.outer(scale, scale))
            matrix[np.ix_(places, places)] = inverse
        return matrix

    def prior_square(self, v: Array) -> float:
        """Squared distance of v from the priors' mean in units of their covariance."""
        departure = v - self.prior_mean
        return float(departure @ self.prior_matrix @ departure)

    @cached_property
    def prior_mean(self) -> Array:
        """Of each variable; zero, which is nominal, with the robot's own priors."""
        mean = np.zeros(self.size)
        mean[: len(self.names)] = (self._prior[0] - self._parameter("value")) / self.scale
        return mean

    @cached_property
    def _prior(self) -> Array:
        """Mean and one sigma of each chosen parameter's prior, shape (2, p) [SI]."""
        other = self.priors if isinstance(self.priors, Mapping) else {}
        own = (self.robot.parameters[n] for n in self.names)
        return np.array([other.get(p.name, (p.value, p.prior)) for p in own]).reshape(-1, 2).T

    def separate(self, v: Array) -> tuple[Array, Array]:
        """x, shape (p,), and u, shape (K, 3)."""
        p = len(self.names)
        return v[:p], v[p:].reshape(-1, 3)

    def values(self, v: Array) -> dict[str, float]:
        """Parameters by name [SI]."""
        x, _ = self.separate(v)
        return dict(zip(self.names, self._parameter("value") + self.scale * x, strict=True))

    def solve(self, progress: Progress | None = None) -> Solution:
        """The bounded optimum. Raises ConvergenceError."""
        if self.size > WIDE:
            return solve_in_steps(self.cost, self.gradient, self.bounds, progress)
        v = ca.MX.sym("v", self.size)
        x, u = v[: len(self.names)], ca.reshape(v[len(self.names) :], 3, len(self.labels))
        cost, again, gradient, hessian = ca.MX(0), ca.MX(0), ca.MX.zeros(self.size), ca.MX(self.size, self.size)
        for block in self.blocks:
            cost += block.cost(x, u)
            f, g = block.gradient(x, u)
            again, gradient, hessian = again + f, gradient + g, hessian + block.hessian(x, u)
        r = self._separations(u)
        if r.numel():
            J = ca.jacobian(r, v)
            cost, again = cost + ca.sumsqr(r) / 2, again + ca.sumsqr(r) / 2
            gradient, hessian = gradient + J.T @ r, hessian + ca.triu(J.T @ J)
        if self.priors:
            weights = ca.sparsify(ca.DM(self.prior_matrix))
            pull = weights @ (v - ca.DM(self.prior_mean))
            prior = ca.dot(v - ca.DM(self.prior_mean), pull) / 2
            cost, again, gradient = cost + prior, again + prior, gradient + pull
            hessian += ca.triu(weights)
        lower, upper = self.bounds
        return minimise(
            v, cost, (again, gradient), hessian, lower, upper, scale=0.5 * self.residual_count, progress=progress
        )

    def cost(self, v: Array) -> float:
        """Half the sum of squares at v, through the robust loss, with the priors."""
        residuals, _ = self.evaluate(v)
        squares = [loss_value(self.loss, r) for r in residuals[: len(self.sets)]]
        squares += [r**2 for r in residuals[len(self.sets) :]]
        return 0.5 * (sum(float(s.sum()) for s in squares) + self.prior_square(v))

    def _separations(self, u: ca.MX) -> ca.MX:
        """Residuals of known distances between touched points."""
        rows = []
        for k, m in enumerate(self.sets):
            for first, second, length in m.separations:
                i, j = self.labels.index(f"{k}/{first}"), self.labels.index(f"{k}/{second}")
                apart = ca.DM(self.points[i] - self.points[j]) + POINT_SCALE * (u[:, i] - u[:, j])
                rows.append((ca.norm_2(apart) - length) / m.separation_sigma)
        return ca.vertcat(*rows) if rows else ca.MX.zeros(0)

    def evaluate(self, v: Array) -> tuple[list[Array], Array]:
        """Residuals of every set, shape (n, m), and the whole Jacobian, shape (residuals, size), without the loss."""
        at, result = self._last
        if at is None or not np.array_equal(at, v):
            self._last[:] = [v.copy(), self._evaluate(v)]
            result = self._last[1]
        return result  # type: ignore[no-any-return]

    @cached_property
    def _last(self) -> list[Any]:
        """Where the problem was evaluated last, and what came out: the statistics ask for the optimum many times."""
        return [None, None]

    def _evaluate(self, v: Array) -> tuple[list[Array], Array]:
        x, u = self.separate(v)
        residuals, rows = [], []
        for block in self.blocks:
            r, J = block.evaluate(x, u)
            residuals.append(r)
            if not u.size:
                rows.append(J.reshape(-1, v.size))
                continue
            whole = np.zeros((*r.shape, v.size))
            whole[:, :, : x.size] = J[:, :, : x.size]
            if block.kernel.point:
                for j in range(3):
                    whole[np.arange(len(r)), :, x.size + 3 * block.group + j] = J[:, :, x.size + j]
            rows.append(whole.reshape(-1, v.size))
        if not u.size:  # no points, and no distances between them
            return residuals, np.concatenate(rows) if len(rows) > 1 else rows[0]
        w = ca.MX.sym("v", self.size)
        r_s = self._separations(ca.reshape(w[x.size :], 3, len(self.labels)))
        if r_s.numel():
            both = ca.Function("separations", [w], [r_s, ca.densify(ca.jacobian(r_s, w))])(v)
            residuals.append(both[0].full())
            rows.append(both[1].full())
        return residuals, np.concatenate(rows)

    def gradient(self, v: Array) -> tuple[Array, Array]:
        """Gradient and Gauss-Newton Hessian of the cost at v, from residuals; independent of the solver's."""
        r, J, slope = self._weighted(v)
        gradient = J.T @ (slope * r) + self.prior_matrix @ (v - self.prior_mean)
        return gradient, self._products(J, slope) + self.prior_matrix

    def _products(self, J: Array, weights: Array) -> Array:
        """Weighted products of the columns of the Jacobian, shape (size, size); weights : of its rows, not negative."""
        J = J if self.loss == "linear" else J * np.sqrt(weights)[:, None]
        return np.asarray(J.T @ J)

    def _weighted(self, v: Array) -> tuple[Array, Array, Array]:
        """All residuals, shape (residuals,), the whole Jacobian, and the weight that the loss gives each row."""
        residuals, J = self.evaluate(v)
        return np.concatenate([part.ravel() for part in residuals]), J, self.slopes(residuals)

    def slopes(self, residuals: Sequence[Array]) -> Array:
        """Weight that the loss gives each row of the Jacobian; known separations pass through no loss."""
        rows = [np.repeat(loss_slope(self.loss, r), r.shape[1]) for r in residuals[: len(self.sets)]]
        return np.concatenate([*rows, *(np.ones(r.size) for r in residuals[len(self.sets) :])])

    def at_bounds(self, v: Array) -> Array:
        """Mask of the variables that stopped at a bound."""
        lower, upper = self.bounds
        near = 1e-5 * np.maximum(1.0, np.minimum(upper - lower, 1e3))
        return np.asarray((v - lower < near) | (upper - v < near))

    def decrement(self, v: Array) -> float:
        """What one more Gauss-Newton step inside the bounds would gain in cost, half of chi-squared: g' H^-1 g / 2."""
        g, H = self.gradient(v)
        lower, upper = self.bounds
        # A bound that the cost pushes away from holds nothing back.
        inward = np.where(v - lower < upper - v, g < 0, g > 0)
        free = ~self.at_bounds(v) | inward
        return float(0.5 * g[free] @ np.linalg.solve(H[np.ix_(free, free)], g[free]))

    def identifiability(self, v: Array) -> Identifiability:
        """Which of the names the data determine, by the Jacobian at v, with fixed loads if joints are compliant."""
        loaded = any(j.compliance is not None for j in self.robot.joints) or bool(self.robot.effects)
        _, J = replace(self, fixed_loads=loaded).evaluate(v)
        p = len(self.names)
        held = {n: self.robot.parameters[n].held for n in self.names if self.robot.parameters[n].held}
        if not any(find_kind(m.kind).at_rest(m.arrays) for m in self.sets):
            held |= dict.fromkeys(_WHOLE_ROBOT, "nothing at rest was measured: moving the whole robot changes nothing")
        if self.priors and self.residual_count <= self.size:
            # Too few numbers to say what is confounded.
            J = np.concatenate([J, np.diag(np.sqrt(np.diag(self.prior_matrix)))])
        of_effects = {e.label for e in self.robot.effects}
        if self.priors and p > WIDE:  # what a prior of an effect holds back needs no test of independence
            own = [k for k, n in enumerate(self.names) if self.robot.parameters[n].group not in of_effects]
            base = tuple(self.names[k] for k in own)
            found = analyse(J[:, [*range(p, self.size), *own]], base, 3 * len(self.labels), held)
            dropped = {u.name for u in found.held}
            return replace(found, independent=tuple(n for n in self.names if n not in dropped))
        J_ordered = np.concatenate([J[:, p:], J[:, :p]], axis=1)
        found = analyse(J_ordered, self.names, 3 * len(self.labels), held)
        if any(find_kind(m.kind).has_scale or m.separations for m in self.sets) or not self._scale_is_free():
            return found
        longest = max(found.independent, key=lambda n: abs(self._length(n)))
        held[longest] = "contacts without known separations do not determine the scale; this length is its reference"
        return analyse(J_ordered, self.names, 3 * len(self.labels), held)

    def _length(self, name: str) -> float:
        """Nominal value of a parameter that is a length [m]; zero for others."""
        parameter = self.robot.parameters[name]
        return parameter.value if parameter.unit == "m" else 0.0

    def _scale_is_free(self) -> bool:
        """Whether all lengths grow together unseen.

        Contact residuals p - u are then homogeneous in lengths and points, and Euler's theorem says J (lengths, points)
        = residuals. Compliance breaks this by its share in the position, which is no measure: hence one per cent.
        """
        residuals, J = self.evaluate(np.zeros(self.size))
        lengths = np.array([self._length(n) for n in self.names]) / self.scale
        growth = np.concatenate([lengths, (self.points - self.robot.base.T[:3, 3]).ravel() / POINT_SCALE])
        r = np.concatenate([part.ravel() for part in residuals])
        robot_alone = np.linalg.norm(J[:, : lengths.size] @ lengths)
        return bool(robot_alone > 0 and np.linalg.norm(J @ growth - r) < 0.01 * robot_alone)

    def covariance(self, v: Array, variance: float) -> Array:
        """Of the parameters, shape (p, p) [SI], points marginalised; NaN for those at a bound.

        variance : of a residual in units of sigma, one if the sigmas are right

        With a robust loss it is the sandwich H^-1 (J' W^2 J) H^-1 of M-estimators (Huber and Ronchetti 2009, ch. 7).
        """
        _, J, slope = self._weighted(v)
        free = np.flatnonzero(~self.at_bounds(v))
        inverse = scaled_inverse((self._products(J, slope) + self.prior_matrix)[np.ix_(free, free)])
        if self.loss != "linear":
            inverse = inverse @ (self._products(J, slope**2) + self.prior_matrix)[np.ix_(free, free)] @ inverse
        whole = np.full((self.size, self.size), np.nan)
        whole[np.ix_(free, free)] = variance * inverse
        p = len(self.names)
        return np.asarray(whole[:p, :p] * np.outer(self.scale, self.scale))

    def redundancies(self, v: Array) -> Array:
        """Degrees of freedom of each observed number, one less its leverage; they sum to those of the fit."""
        _, J, slope = self._weighted(v)
        H = self._products(J, slope) + self.prior_matrix
        return np.asarray(1 - slope * np.einsum("ij,ij->i", J @ scaled_inverse(H), J))

    def with_names(self, names: Sequence[str]) -> LeastSquares:
        return replace(self, names=tuple(names))


def variance(problem: LeastSquares, v: Array, *, trimmed: bool = False) -> float:
    """Of a residual, in units of sigma: the sum of squares over the degrees of freedom.

    With a robust loss, and unless outliers were trimmed, from the median absolute residuals instead.
    """
    residuals, _ = problem.evaluate(v)
    freedom = problem.degrees_of_freedom
    if problem.loss != "linear" and not trimmed:
        typical = float(np.median([robust_std(r) ** 2 for r in residuals]))
        return typical * problem.residual_count / max(1, freedom)
    chi2 = sum(float((r**2).sum()) for r in residuals) + problem.prior_square(v)
    return chi2 / max(1, freedom)


def robust_std(r: Array) -> float:
    """Standard deviation of residuals from their median absolute value, robust to outliers; zeros have weight zero."""
    counted = np.abs(r[r != 0])
    return float(1.4826 * np.median(counted)) if counted.size else 0.0

"""The identification problem: measurements, free parameters and unknown points, and its solution.

Variables are v = (x, u): departures x of the free parameters from nominal in units of their scale,
then three coordinates u [mm] per unknown point, relative to the start. The cost is half the sum of
squared residuals in units of sigma, times their weights (through the robust loss), of given
distances between points, and of the priors that apply.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import chain

import casadi as ca
import numpy as np

from casadical.core.basics import M_PER_MM, Array
from casadical.core.levenberg_marquardt import Evaluated, levenberg_marquardt
from casadical.core.linear_gaussian.normal_equations import scaled_solution
from casadical.core.parameters import Parameter
from casadical.core.statistics import robust_std
from casadical.identification.accuracy import predicted
from casadical.identification.residuals import MAX_CACHED_DATA_POSES, Block, Loss, loss_and_slope, make_block
from casadical.identification.solver import (
    ACCEPTABLE_STATUS,
    OPTIMUM_MESSAGE,
    STOPPED_STATUS,
    ProblemCache,
    Progress,
    Solution,
    Sums,
    bounded_step,
    minimise,
)
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

# Initial standard deviation of a coordinate [m] where none is given, until residuals estimate it.
INITIAL_SIGMA_M = 1e-4
# Initial standard deviation of an angle [rad] where none is given, until residuals estimate it.
INITIAL_SIGMA_ANGLE_RAD = 1e-4
# Gain of one more step [cost, half of chi-squared] below which a slow search has converged: a tenth
# of a standard error. A search is slow along what only priors determine, such as the common scale
# of estimated masses and compliances, or parameters with a prior from another campaign.
SETTLED_COST_GAIN = 5e-3
# Number of free parameters of a problem with priors above which those of effects are not tested
# for independence.
MANY_PARAMETERS = 200
# Maximum number of Gauss-Newton steps, damped ones included, with which a solve starts.
MAX_APPROACH_STEPS = 8
# Groups of parameters (frames) that belong to a campaign's set-up, not to the robot.
FRAME_GROUPS = ("base", "tool")

# Index of a set, residuals of some of its poses, shape (n, m), and their Jacobian by v, shape
# (n m, size), both in units of sigma. Known distances between points have the index after the last.
_Part = tuple[int, Array, Array]


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """One identification problem; the module's docstring defines its variables and cost.

    robot : nominal; sets : measurements
    names : free parameters, which are variables
    loss : loss of the residuals of a pose
    priors : whether the robot's own priors constrain the variables; a mapping name -> (mean, one
        sigma) [SI] means that they do, except for the priors that it replaces
    sigmas : standard deviations of one coordinate [m] and one angle [rad], for each set
    fixed_loads : whether gravity torques are those of the nominal geometry (see `expressions`)
    weighed : whether the tilt of the pedestal is identified by the weight of the links alone, where
        nothing at rest was measured
    correlated : names and covariance [SI] of each group of correlated parameters; their means are those of
        `priors`
    max_cached_values : maximum number of values of a cached Jacobian or cached residuals, and of
        poses whose inputs are cached
    cache : of what was computed
    """

    robot: Robot
    sets: tuple[Measurements, ...]
    names: tuple[str, ...]
    loss: Loss
    priors: bool | Mapping[str, tuple[float, float]]
    sigmas: tuple[tuple[float, float], ...]
    fixed_loads: bool = False
    weighed: bool = False
    correlated: tuple[tuple[tuple[str, ...], Array], ...] = ()
    max_cached_values: int = 2_000_000
    cache: ProblemCache = field(default_factory=ProblemCache, init=False, repr=False)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of all K unknown points, as "set index/point name", such as "0/A"."""
        names = chain.from_iterable(map(self.pose_labels, range(len(self.sets))))
        return self.cache.once("labels", lambda: tuple(dict.fromkeys(names)))

    def pose_labels(self, k: int) -> list[str]:
        """Return the label of each pose's unknown point in set k; empty if the kind has none."""
        m = self.sets[k]
        return [f"{k}/{name}" for name in find_kind(m.kind).point_names(m.arrays)]

    @property
    def points(self) -> Array:
        """Initial position of every unknown point in the measuring frame, shape (K, 3) [m]."""
        return self.cache.once("points", self._points)

    def _points(self) -> Array:
        """Compute `points` by each kind's `point_starts` from the nominal tool positions."""
        start: dict[str, Array] = {}
        for k, m in enumerate(self.sets):
            if labels := self.pose_labels(k):
                p, _ = predicted(self.robot, m)
                start |= dict(zip(labels, find_kind(m.kind).point_starts(m.arrays, p), strict=True))
        return np.array([start[name] for name in self.labels]).reshape(-1, 3)

    @property
    def blocks(self) -> tuple[Block, ...]:
        """One block per set of measurements, from which residuals and Jacobians are evaluated."""
        return self.cache.once("blocks", self._blocks)

    def _blocks(self) -> tuple[Block, ...]:
        """Compute `blocks`, one for each set of measurements."""
        index = {name: k for k, name in enumerate(self.labels)}
        made = []
        for k, (m, (sigma, sigma_angle)) in enumerate(zip(self.sets, self.sigmas, strict=True)):
            group = np.array([index[name] for name in self.pose_labels(k)] or [0] * len(m), dtype=np.int64)
            of_set = (self.robot, m, self.names, sigma, sigma_angle, self.points, group)
            made.append(
                make_block(
                    *of_set, fixed_loads=self.fixed_loads, max_cached=min(MAX_CACHED_DATA_POSES, self.max_cached_values)
                )
            )
        return tuple(made)

    @property
    def size(self) -> int:
        """Number of variables v: free parameters, and three coordinates per unknown point."""
        return len(self.names) + 3 * len(self.labels)

    @cached_property
    def residual_count(self) -> int:
        """Number of residuals (scalars) of all poses with a weight, and of given distances."""
        return sum(m.residuals for m in self.sets)

    @property
    def degrees_of_freedom(self) -> int:
        """Number of residuals and of informative priors, minus the number of variables."""
        return self.residual_count - self.size + int(np.count_nonzero(np.diag(self.prior_matrix)[self._informed]))

    @cached_property
    def _informed(self) -> Array:
        """Mask of the variables whose priors, if they apply, are information, shape (size,).

        The robot's own priors of base and tool only limit the search: they do not count.
        """
        informed = {*self.given, *(n for names, _ in self.correlated for n in names)}
        own = [p.group not in FRAME_GROUPS or p.name in informed for p in self._free_parameters]
        return np.array([*own, *[False] * (self.size - len(own))], dtype=bool)

    @property
    def given(self) -> Mapping[str, tuple[float, float]]:
        """Priors that are not the robot's own, name -> (mean, one sigma) [SI]."""
        return self.priors if isinstance(self.priors, Mapping) else {}

    @cached_property
    def _free_parameters(self) -> list[Parameter]:
        """The free parameters in the order of `names`."""
        return [self.robot.parameters[n] for n in self.names]

    def _parameter_values(self, what: str) -> Array:
        """Return an attribute of the p free parameters, shape (p,), in SI units."""
        return np.array([getattr(p, what) for p in self._free_parameters])

    @cached_property
    def scale(self) -> Array:
        """Unit of each parameter's variable, shape (p,) [SI]."""
        return self._parameter_values("scale")

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the variables, shape (size,) each, relative to nominal.

        They are in units of scale; unknown points have none.
        """
        free = np.full(3 * len(self.labels), np.inf)
        value = self._parameter_values("value")
        lower = (self._parameter_values("lower") - value) / self.scale
        upper = (self._parameter_values("upper") - value) / self.scale
        return np.concatenate([lower, -free]), np.concatenate([upper, free])

    @cached_property
    def prior_matrix(self) -> Array:
        """Precision matrix of the priors (inverse covariance) of the variables, (size, size).

        Variables are parameters in units of scale and points in mm; rows and columns of those
        without a prior are zero.
        """
        weights = np.zeros(self.size)
        with_prior = self.guesses | bool(self.priors)
        weights[: len(self.names)] = np.where(with_prior, (self.scale / self._prior[1]) ** 2, 0.0)
        matrix = np.diag(weights)
        for names, covariance in self.correlated:
            places = [k for k, name in enumerate(self.names) if name in names]
            at = [names.index(self.names[k]) for k in places]
            scale = self.scale[places]
            inverse = np.linalg.inv(covariance[np.ix_(at, at)] / np.outer(scale, scale))
            matrix[np.ix_(places, places)] = inverse
        return matrix

    @cached_property
    def guesses(self) -> Array:
        """Mask of the free parameters whose own priors always apply (guesses), shape (p,)."""
        return self._parameter_values("guess").astype(bool)

    def prior_square(self, v: Array, *, counted: bool = False) -> float:
        """Return the squared Mahalanobis distance of the variables v from the priors' mean.

        counted : True includes only the priors that count as information: not the robot's own
            ones of base and tool
        """
        if not (self.priors or self.correlated or self.guesses.any()):
            return 0.0
        departure = np.where(self._informed, v - self.prior_mean, 0.0) if counted else v - self.prior_mean
        return float(departure @ self.prior_matrix @ departure)

    @cached_property
    def prior_mean(self) -> Array:
        """Prior mean of the variables minus nominal, shape (size,), in units of scale and mm.

        It is zero by the robot's own priors.
        """
        mean = np.zeros(self.size)
        mean[: len(self.names)] = (self._prior[0] - self._parameter_values("value")) / self.scale
        return mean

    @cached_property
    def _prior(self) -> Array:
        """Mean (row 0) and one sigma (row 1) of each free parameter's prior, shape (2, p) [SI]."""
        return np.array([self.given.get(p.name, (p.value, p.prior)) for p in self._free_parameters]).reshape(-1, 2).T

    def separate(self, v: Array) -> tuple[Array, Array]:
        """Return parameters x (p,) [units of scale] and unknown points u (K, 3) [mm] out of v."""
        p = len(self.names)
        return v[:p], v[p:].reshape(-1, 3)

    def values(self, v: Array) -> dict[str, float]:
        """Return the values of the free parameters at v, name -> value [SI].

        They are clipped to their bounds, which rounding may exceed.
        """
        x, _ = self.separate(v)
        values = np.clip(
            self._parameter_values("value") + self.scale * x,
            self._parameter_values("lower"),
            self._parameter_values("upper"),
        )
        return dict(zip(self.names, values, strict=True))

    def solve(
        self,
        progress: Progress | None = None,
        start: Array | None = None,
        poor_at: Callable[[LeastSquares, Array], object] | None = None,
    ) -> Solution:
        """Return the optimum within the bounds, by default from the robot's own values.

        Gauss-Newton steps often suffice; else Ipopt goes on from there. Where round-off of the cost
        stops its line search, it cannot tell that it is at an optimum; the predicted gain of one
        more Gauss-Newton step decides.

        start : variables v, shape (size,); None: zero
        poor_at : (self, v) -> parameters that will be left out; a slow search along them ends at v
        Raises ConvergenceError where Ipopt finds none.
        """
        scale = 0.5 * self.residual_count
        start, history = self._approached(np.zeros(self.size) if start is None else start)
        if history:
            if progress:
                progress(len(history) - 1, history[-1])
            return Solution(start, "Solve_Succeeded", OPTIMUM_MESSAGE, history)
        if poor_at and self.decrement(start) < 1e-3 * self.cost(start) and poor_at(self, start):
            return Solution(start, STOPPED_STATUS, "", (self.cost(start),))
        creeps = bool(self.guesses.any() or self.correlated)
        settled = (lambda v: self.decrement(v) < SETTLED_COST_GAIN) if creeps else None
        solution = minimise(
            self.cost, self.gradient, *self.bounds, scale=scale, start=start, progress=progress, settled=settled
        )
        # An optimum is where one more step gains less than 1e-8: a ten-thousandth of a standard error.
        sharp = solution.status == ACCEPTABLE_STATUS and self.decrement(solution.v) < 1e-8
        return replace(solution, message=OPTIMUM_MESSAGE) if sharp else solution

    def _approached(self, v: Array) -> tuple[Array, tuple[float, ...]]:
        """Return the variables, shape (size,), reached from v by bounded Gauss-Newton steps.

        Along bounds an active set needs a few steps where Ipopt's interior point needs many. A step
        that raises the cost is repeated with damping (Levenberg-Marquardt). There are at most
        MAX_APPROACH_STEPS. They end earlier where damping does not help, or, at bounds, where one
        changes the cost by less than SETTLED_COST_GAIN. The costs at all steps are returned, too,
        where the last point is an optimum inside the bounds, as sharp as Ipopt's; else none.
        """

        def evaluate(at: Array) -> Evaluated:
            """Return twice the cost, and the equations of a step, at one point, shape (1, size)."""

            def sums(_: Array) -> tuple[Array, Array]:
                g, H = self.gradient(at[0])
                return H[None], -g[None]

            return np.array([2 * self.cost(at[0])]), sums

        states = levenberg_marquardt(
            evaluate,
            v[None],
            MAX_APPROACH_STEPS + 1,
            solve=lambda at, H, right: self.step(at[0], (-right[0], H[0]))[None],
            first=0.0,
            least=0.0,
        )
        inside, sharp, damping = False, False, 0.0
        history: list[float] = []
        for at in states:
            v, gain = at.point[0], 0.5 * at.gain[0]
            if gain > 0:
                history.append(float(0.5 * at.cost[0]))
                if gain < SETTLED_COST_GAIN and not inside:
                    break
            elif sharp:  # round-off hides what is left: Ipopt would find nothing, either
                return v, tuple(history)
            elif abs(gain) < SETTLED_COST_GAIN or damping > 1:
                break
            damping = at.damping[0]
            inside = not (damping or self.at_bounds(v + at.step[0]).any())
            sharp = inside and at.predicted[0] < 2e-8
            if sharp and np.abs(self.gradient(v)[0]).max() < 0.5e-6 * self.residual_count:
                return v, tuple(history)
        return v, ()

    def cost(self, v: Array) -> float:
        """Return the cost at v: half the sum of squares, through the loss, with the priors.

        If Ipopt did not take the gradient at the last point, it is in a line search: residuals are
        then evaluated without derivatives.
        """
        last = self.cache.sums
        if last.point is None or last.holds(v) or self.cache.gradient.holds(last.point):
            return self._sums(v).cost + 0.5 * self.prior_square(v)
        return float(self.cache.cost(v, self._cost))

    def gradient(self, v: Array) -> tuple[Array, Array]:
        """Return gradient (size,) and Gauss-Newton Hessian (size, size) of the cost with priors."""
        both: tuple[Array, Array] = self.cache.gradient(v, self._gradient)
        return both

    def _gradient(self, v: Array) -> tuple[Array, Array]:
        """Compute `gradient` at v from the sums over all residuals and the priors."""
        sums = self._sums(v)
        if not (self.priors or self.correlated or self.guesses.any()):
            return sums.gradient, sums.information
        P = self.prior_matrix
        return sums.gradient + P @ (v - self.prior_mean), sums.information + P

    def triangle(self, v: Array) -> Array:
        """Return the triangular factor R of the Jacobian at v, without loss and priors.

        Its shape is (size, size), with fewer rows if there are fewer residuals. It carries the same
        information as the Jacobian in a size that does not grow with the residuals; the sums at v
        are computed along with it.
        """
        last = self.cache.sums
        cached: Sums | None = last.answer if last.holds(v) else None
        if cached is None or cached.triangle is None:
            cached = last.keep(v, self._summed(v, triangle=True))
        assert cached.triangle is not None
        return cached.triangle

    def undefined(self, v: Array) -> tuple[Measurements, Array] | None:
        """Return the first set with a residual or derivative that is not finite at v, and its mask.

        The mask marks these poses, shape (n,). None where all are finite.
        """
        bad: list[list[Array]] = [[] for _ in self.sets]
        for k, r, J in self.parts(v):
            if k < len(self.sets):  # not of separations
                bad[k].append(~np.isfinite(np.column_stack([r, J.reshape(len(r), -1)])).all(axis=1))
        at = ((m, np.concatenate(some)) for m, some in zip(self.sets, bad, strict=True) if some)
        return next((each for each in at if each[1].any()), None)

    def information(self, v: Array) -> Array:
        """Return the information matrix J'WJ at v without priors, shape (size, size).

        J is the Jacobian in units of sigma, W the weights of the loss.
        """
        return self._sums(v).information

    def residuals(self, v: Array) -> list[Array]:
        """Return the residuals of every set in units of sigma, shape (n, m) each, without the loss.

        Known distances between points, where there are any, add a last part of shape (separations,
        1).
        """
        cached = self._sums(v).residuals
        return self._joined((k, r) for k, r, _ in self.parts(v)) if cached is None else cached

    def square(self, v: Array) -> float:
        """Return the sum of the squares of all residuals at v, without the loss."""
        return self._sums(v).square

    def variance(self, v: Array, *, trimmed: bool = False) -> float:
        """Return the variance of a residual at v in units of sigma^2: square sum by degrees of freedom.

        Informative priors are in both. With a robust loss, unless outliers were excluded (`trimmed`),
        it comes from the median of the sets' robust variances instead. With a correlated prior it is at
        least one: small residuals are no sign that prior or instrument is better than stated.
        """
        least = 1.0 if self.correlated else 0.0
        freedom = max(1, self.degrees_of_freedom)
        if self.loss != "linear" and not trimmed:
            typical = float(np.median([robust_std(r) ** 2 for r in self.residuals(v)]))
            return max(least, typical * self.residual_count / freedom)
        return max(least, (self.square(v) + self.prior_square(v, counted=True)) / freedom)

    @staticmethod
    def _joined(parts: Iterable[tuple[int, Array]]) -> list[Array]:
        """Return the residuals of each set, shape (n, m), in the order of sets.

        parts : (index of the set, residuals of some of its poses)
        """
        of_set: dict[int, list[Array]] = {}
        for k, r in parts:
            of_set.setdefault(k, []).append(r)
        return [np.concatenate(some) if len(some) > 1 else some[0] for some in of_set.values()]

    def _sums(self, v: Array) -> Sums:
        """Return the sums over all residuals at v, cached for the last point."""
        sums: Sums = self.cache.sums(v, self._summed)
        return sums

    def _summed(self, v: Array, *, triangle: bool = False) -> Sums:
        """Compute the sums over all residuals at v, some poses at a time.

        triangle : whether the triangular factor of the Jacobian is computed, too
        """
        cost = square = 0.0
        gradient, information = np.zeros(self.size), np.zeros((self.size, self.size))
        residuals: list[tuple[int, Array]] = []
        R = np.zeros((0, self.size))
        for k, r, J in self.parts(v):
            if self.residual_count <= self.max_cached_values:
                residuals.append((k, r))
            if triangle:
                R = np.asarray(np.linalg.qr(np.concatenate([R, J]) if len(R) else J, mode="r"))
            flat = r.ravel()
            square += (own := float(flat @ flat))
            loss = self.loss_of(k)
            cost += own if loss == "linear" else float(loss_and_slope(loss, r)[0].sum())
            rows, y = self.through_loss(k, r, J)
            information += rows.T @ rows
            gradient += rows.T @ y
        joined = self._joined(residuals) if residuals else None
        return Sums(0.5 * cost, gradient, information, square, joined, R if triangle else None)

    def through_loss(self, k: int, r: Array, J: Array) -> tuple[Array, Array]:
        """Return Jacobian (n m, size) and residuals (n m,) of a part, times roots of loss weights.

        k : index of the set; r, J : residuals, shape (n, m), and Jacobian, shape (n m, size)
        """
        if self.loss_of(k) == "linear":
            return J, r.ravel()
        root = np.sqrt(self.loss_weights(k, r))
        return J * root[:, None], root * r.ravel()

    def loss_weights(self, k: int, r: Array) -> Array:
        """Return the loss weight of each residual of a part, shape (n m,); r : shape (n, m)."""
        return np.repeat(loss_and_slope(self.loss_of(k), r)[1], r.shape[1])

    def _cost(self, v: Array) -> float:
        """Compute the cost at v, with the priors, from the residuals alone, without derivatives."""
        x, u = self.separate(v)
        of_sets = ((k, r) for k, block in enumerate(self.blocks) for r in block.residuals(x, u))
        residuals = chain(of_sets, ((k, r) for k, r, _ in self._separated(v)))
        return 0.5 * (
            sum(float(loss_and_slope(self.loss_of(k), r)[0].sum()) for k, r in residuals) + self.prior_square(v)
        )

    def loss_of(self, k: int) -> Loss:
        """Return the loss of set k; linear for given distances, whose index is after the last."""
        return self.loss if k < len(self.sets) else "linear"

    def parts(self, v: Array) -> Iterable[_Part]:
        """Return residuals and Jacobian at v without the loss, some poses at a time, as parts.

        A part has the set's index, residuals, shape (n, m), and Jacobian, shape (n m, size), in
        units of sigma. They are cached for the last v where they are few, so that statistics need
        no further evaluation.
        """
        if self.residual_count * self.size > self.max_cached_values:
            return self._evaluated(v)
        parts: tuple[_Part, ...] = self.cache.parts(v, lambda v: tuple(self._evaluated(v)))
        return parts

    def _evaluated(self, v: Array) -> Iterator[_Part]:
        """Yield residuals and Jacobian at v as parts, evaluated without the cache."""
        x, u = self.separate(v)
        for k, block in enumerate(self.blocks):
            for some, r, J in block.parts(x, u):
                yield k, r, self._by_all_variables(block, some, J)
        yield from self._separated(v)

    def _separated(self, v: Array) -> Iterator[_Part]:
        """Yield the one part of given distances between touched points, if there are any."""
        if any(m.separations for m in self.sets):
            w = ca.MX.sym("v", self.size)
            r_s = self._separations(ca.reshape(w[len(self.names) :], 3, len(self.labels)))
            both = ca.Function("separations", [w], [r_s, ca.densify(ca.jacobian(r_s, w))])(v)
            yield len(self.sets), both[0].full(), both[1].full()

    def _by_all_variables(self, block: Block, some: slice, J: Array) -> Array:
        """Return the Jacobian of some poses of a block by all variables v, shape (n m, size).

        The columns of a pose's own unknown point are put at the variables of that point; those of
        all other points are zero.

        J : by the scaled parameters x and the coordinates of each pose's own point, in units of
            sigma, shape (n, m, z); some : slice of the block's poses
        """
        p = len(self.names)
        if p == self.size:
            return J.reshape(-1, p)
        whole = np.zeros((*J.shape[:2], self.size))
        whole[:, :, :p] = J[:, :, :p]
        if block.kernel.point:
            for j in range(3):
                whole[np.arange(len(J)), :, p + 3 * block.group[some] + j] = J[:, :, p + j]
        return whole.reshape(-1, self.size)

    def _separations(self, u: ca.MX) -> ca.MX:
        """Return the residuals of given distances between touched points, shape (s,), in sigmas.

        u : variables of all unknown points, shape (3, K) [mm]
        """
        rows = []
        for k, m in enumerate(self.sets):
            for first, second, length in m.separations:
                i, j = self.labels.index(f"{k}/{first}"), self.labels.index(f"{k}/{second}")
                apart = ca.DM(self.points[i] - self.points[j]) + M_PER_MM * (u[:, i] - u[:, j])
                rows.append((ca.norm_2(apart) - length) / m.separation_sigma)
        return ca.vertcat(*rows) if rows else ca.MX.zeros(0)

    def evaluate(self, v: Array) -> tuple[list[Array], Array]:
        """Return residuals of every set, shape (n, m), and the Jacobian by v, (residuals, size).

        Both are at v, in units of sigma, without the loss and priors.
        """
        rows = [J for _, _, J in self.parts(v)]
        return self.residuals(v), np.concatenate(rows) if len(rows) > 1 else rows[0]

    def at_bounds(self, v: Array) -> Array:
        """Return the mask of the variables v that are at a bound, or nearly, shape (size,)."""
        lower, upper = self.bounds
        near = 1e-5 * np.maximum(1.0, np.minimum(upper - lower, 1e3))
        return np.asarray((v - lower < near) | (upper - v < near))

    def decrement(self, v: Array) -> float:
        """Return the cost reduction (half of chi-squared) of a bounded Gauss-Newton step from v.

        It is predicted by the quadratic model of the cost, and zero at an optimum.
        """
        g, H = self.gradient(v)
        step = self.step(v)
        return max(0.0, float(-(g + 0.5 * H @ step) @ step))

    def step(self, v: Array, normal: tuple[Array, Array] | None = None) -> Array:
        """Return the bounded Gauss-Newton step from v, shape (size,).

        It leads to the minimum of the problem linearised at v, within the bounds.

        normal : gradient and Hessian, shapes (size,) and (size, size); by default `gradient(v)`
        """
        lower, upper = self.bounds
        return bounded_step(*(normal or self.gradient(v)), lower - v, upper - v, self.at_bounds(v))

    def from_points(self, points: Array) -> LeastSquares:
        """Return the problem with other initial positions of the unknown points.

        points : in the measuring frame, shape (K, 3) [m]
        """
        other = replace(self)
        other.cache.made.update(points=points)
        return other

    def with_loss(self, loss: Loss) -> LeastSquares:
        """Return the same problem with another loss of the residuals.

        Data, points, independence of parameters and residuals at the start are taken over from the
        cache.
        """
        other = replace(self, loss=loss)
        other.cache.made.update(self.cache.made)
        if parts := self.cache.parts.at_zero:
            zero = np.zeros(self.size)
            other.cache.parts.keep(zero, parts)
            other._sums(zero)
        return other

    def with_names(self, names: Sequence[str]) -> LeastSquares:
        """Return the same problem with other free parameters of the robot, by their names.

        Data and, for a subset of the parameters, the sums at the start are taken over from the
        cache.
        """
        other = replace(self, names=tuple(names))
        if "blocks" in self.cache.made:
            blocks = tuple(block.with_names(self.robot, other.names) for block in self.blocks)
            other.cache.made.update(labels=self.labels, points=self.points, blocks=blocks)
        place_of = {name: k for k, name in enumerate(self.names)}
        if (sums := self.cache.sums.at_zero) and place_of.keys() >= set(other.names):
            columns = [*(place_of[n] for n in other.names), *range(len(self.names), self.size)]
            other.cache.sums(np.zeros(other.size), lambda _: sums.for_variables(columns))
            other.gradient(np.zeros(other.size))
        return other


@dataclass(frozen=True, eq=False)
class Linearised(LeastSquares):
    """A problem linearised about a point: its residuals are linear in the variables v.

    of : the original problem, which may differ in loss and sigmas; at : the point v, shape (size,)
    """

    of: LeastSquares = field(kw_only=True)
    at: Array = field(kw_only=True)

    @classmethod
    def about(cls, problem: LeastSquares, v: Array, loss: Loss) -> Linearised:
        """Return the linearisation of a problem about the point v, with another loss."""
        own = {f.name: getattr(problem, f.name) for f in fields(LeastSquares) if f.init}
        made = cls(**own | {"loss": loss}, of=problem, at=v)
        made.cache.made.update(labels=problem.labels, points=problem.points)
        return made

    def with_sigmas(self, sigmas: tuple[tuple[float, float], ...]) -> Linearised:
        """Return the linearised problem with other noise sigmas of each set.

        sigmas : standard deviations of a coordinate [m] and an angle [rad], for each set
        """
        other = replace(self, sigmas=sigmas)
        other.cache.made.update(labels=self.labels, points=self.points)
        return other

    def settled(self, v: Array) -> Array:
        """Return the optimum without bounds, shape (size,), by at most ten reweighted steps from v.

        Source: Huber and Ronchetti 2009.
        """
        # Reweighting ends where a step gains less than this in cost.
        for _ in range(10):
            g, H = self.gradient(v)
            step = scaled_solution(H, g)
            v = v - step
            if 0.5 * g @ step < 1e-3:
                break
        return v

    def _evaluated(self, v: Array) -> Iterator[_Part]:
        """Yield the linear residuals at v and their constant Jacobian as parts, in these sigmas."""
        kinds = [find_kind(m.kind) for m in self.sets]
        ratios = np.array(self.of.sigmas) / np.array(self.sigmas)
        for k, r, J in self.of.parts(self.at):
            r = r + (J @ (v - self.at)).reshape(r.shape)
            if k < len(kinds) and (ratios[k] != 1.0).any():
                unit = np.repeat(ratios[k], [kinds[k].lengths, kinds[k].angles])
                r, J = r * unit, (J.reshape(len(r), len(unit), -1) * unit[:, None]).reshape(J.shape)
            yield k, r, J


def initial_sigmas(sets: Iterable[Measurements]) -> tuple[tuple[float, float], ...]:
    """Return for each set the standard deviations of a coordinate [m] and an angle [rad].

    They are the declared ones, or else INITIAL_SIGMA_M and INITIAL_SIGMA_ANGLE_RAD.
    """
    return tuple((m.sigma or INITIAL_SIGMA_M, m.sigma_angle or INITIAL_SIGMA_ANGLE_RAD) for m in sets)

"""The identification problem: sets of measurements, chosen parameters, unknown points; and its solve.

Variables are v = (x, u): departures of the chosen parameters from nominal in units of their scale, then three
coordinates [mm] per unknown point. The cost is half the sum of squared residuals in units of sigma (through the robust
loss), of known separations between points, and of priors where they are asked for.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, reduce
from itertools import chain

import casadi as ca
import numpy as np

from casadical.core.basics import Array
from casadical.core.parameters import Parameter
from casadical.identification.accuracy import predicted
from casadical.identification.identifiability import scaled_inverse
from casadical.identification.residuals import HELD, POINT_SCALE, Block, Loss, loss_slope, loss_value, make_block
from casadical.identification.solver import ACCEPTABLE, OPTIMUM, Kept, Progress, Solution, Sums, bounded_step, minimise
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

# Taken where no sigma is given, until it is estimated from the residuals.
SIGMA_GUESS, SIGMA_ANGLE_GUESS = 1e-4, 1e-4
# The same where a search creeps, for what priors hold is much: guesses, along their common scale, and what another
# campaign has told; a tenth of a standard error.
SETTLED = 5e-3
# Of more parameters than this, held back by priors, not all are tested for independence, and a solve starts where so
# many steps at most lead.
WIDE, APPROACH = 200, 8
# Groups of parameters that belong to a campaign, not to the robot.
FRAMES = ("base", "tool")

_Part = tuple[int, Array, Array]


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """One identification problem; see the module's text.

    names : parameters that are variables; sigmas : of one coordinate [m] and angle [rad], for each set
    known : correlated priors: names and their covariance [SI]; their means are those of `priors`
    priors : whether the robot's own priors hold the variables back, or name -> (mean, one sigma) [SI] of other priors
    fixed_loads : whether gravity torques are those of the nominal geometry (see `Model`)
    weighed : whether turns of a foot with nothing at rest about it are sought, which the weight of the links shows
    most_kept : numbers of a Jacobian or of residuals that are kept from one question to the next; poses whose data are
    """

    robot: Robot
    sets: tuple[Measurements, ...]
    names: tuple[str, ...]
    loss: Loss
    priors: bool | Mapping[str, tuple[float, float]]
    sigmas: tuple[tuple[float, float], ...]
    fixed_loads: bool = False
    weighed: bool = False
    known: tuple[tuple[tuple[str, ...], Array], ...] = ()
    most_kept: int = 2_000_000
    kept: Kept = field(default_factory=Kept, init=False, repr=False)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of all unknown points."""
        return self.kept.once("labels", self._labels)

    def _labels(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for k in range(len(self.sets)) for name in self.pose_labels(k)))

    def pose_labels(self, k: int) -> list[str]:
        m = self.sets[k]
        return [f"{k}/{name}" for name in find_kind(m.kind).point_names(m.arrays)]

    @property
    def points(self) -> Array:
        """Start of every unknown point, shape (K, 3) [m]."""
        return self.kept.once("points", self._points)

    def _points(self) -> Array:
        start: dict[str, Array] = {}
        for k, m in enumerate(self.sets):
            if labels := self.pose_labels(k):
                p, _ = predicted(self.robot, m)
                start |= dict(zip(labels, find_kind(m.kind).point_starts(m.arrays, p), strict=True))
        return np.array([start[name] for name in self.labels]).reshape(-1, 3)

    @property
    def blocks(self) -> tuple[Block, ...]:
        return self.kept.once("blocks", self._blocks)

    def _blocks(self) -> tuple[Block, ...]:
        index = {name: k for k, name in enumerate(self.labels)}
        made = []
        for k, (m, (sigma, sigma_angle)) in enumerate(zip(self.sets, self.sigmas, strict=True)):
            group = np.array([index[name] for name in self.pose_labels(k)] or [0] * len(m), dtype=np.int64)
            of_set = (self.robot, m, self.names, sigma, sigma_angle, self.points, group)
            made.append(make_block(*of_set, fixed_loads=self.fixed_loads, held=min(HELD, self.most_kept)))
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
        return self.residual_count - self.size + int(np.count_nonzero(np.diag(self.prior_matrix)[self._informed]))

    @cached_property
    def _informed(self) -> Array:
        """Mask of the variables whose priors tell something, shape (size,).

        The own priors of base and tool say where to look, not where they are: they count as nothing known.
        """
        known_before = {*self.given, *(n for names, _ in self.known for n in names)}
        own = [p.group not in FRAMES or p.name in known_before for p in self._own]
        return np.array([*own, *[False] * (self.size - len(own))], dtype=bool)

    @property
    def given(self) -> Mapping[str, tuple[float, float]]:
        """Priors that are not the robot's own."""
        return self.priors if isinstance(self.priors, Mapping) else {}

    @cached_property
    def _own(self) -> list[Parameter]:
        """The chosen parameters."""
        return [self.robot.parameters[n] for n in self.names]

    def _parameter(self, what: str) -> Array:
        """Values of an attribute of the chosen parameters, in solver units where it is a length or angle."""
        return np.array([getattr(p, what) for p in self._own])

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
        held_back = self.guesses | bool(self.priors)
        weights[: len(self.names)] = np.where(held_back, (self.scale / self._prior[1]) ** 2, 0.0)
        matrix = np.diag(weights)
        for names, covariance in self.known:
            places = [k for k, name in enumerate(self.names) if name in names]
            at = [names.index(self.names[k]) for k in places]
            scale = self.scale[places]
            inverse = np.linalg.inv(covariance[np.ix_(at, at)] / np.outer(scale, scale))
            matrix[np.ix_(places, places)] = inverse
        return matrix

    @cached_property
    def guesses(self) -> Array:
        """Mask of the chosen parameters whose priors always hold them back."""
        return self._parameter("guess").astype(bool)

    @cached_property
    def _free(self) -> bool:
        """Whether no prior holds any variable back."""
        return not (self.priors or self.known or self.guesses.any())

    def prior_square(self, v: Array, *, counted: bool = False) -> float:
        """Squared distance of v from the priors' mean in units of their covariance; counted : of those that count."""
        if self._free:
            return 0.0
        departure = np.where(self._informed, v - self.prior_mean, 0.0) if counted else v - self.prior_mean
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
        return np.array([self.given.get(p.name, (p.value, p.prior)) for p in self._own]).reshape(-1, 2).T

    def separate(self, v: Array) -> tuple[Array, Array]:
        """x, shape (p,), and u, shape (K, 3)."""
        p = len(self.names)
        return v[:p], v[p:].reshape(-1, 3)

    def values(self, v: Array) -> dict[str, float]:
        """Parameters by name [SI]; round-off takes none beyond its bounds."""
        x, _ = self.separate(v)
        values = np.clip(self._parameter("value") + self.scale * x, self._parameter("lower"), self._parameter("upper"))
        return dict(zip(self.names, values, strict=True))

    def solve(self, progress: Progress | None = None, start: Array | None = None) -> Solution:
        """The bounded optimum, sought from a start, by default the robot as it is. Raises ConvergenceError.

        Where the cost's round-off stops Ipopt's line search, the solver cannot know that it stands at an optimum.
        """
        scale = 0.5 * self.residual_count
        if start is None and self.priors and len(self.names) > WIDE:
            start = self._approached()
        creeps = bool(self.guesses.any() or self.known)
        settled = (lambda v: self.decrement(v) < SETTLED) if creeps else None
        solution = minimise(
            self.cost, self.gradient, *self.bounds, scale=scale, start=start, progress=progress, settled=settled
        )
        # What one more step gains at an optimum [chi-squared]: a ten-thousandth of a standard
        # error.
        sharp = solution.status == ACCEPTABLE and self.decrement(solution.v) < 1e-8
        return replace(solution, message=OPTIMUM) if sharp else solution

    def _approached(self) -> Array:
        """Where Gauss-Newton steps inside the bounds lead from the start, while each gains what counts.

        Of many parameters one meets its bound on the way, where Ipopt shortens the whole step.
        """
        v = np.zeros(self.size)
        cost = self.cost(v)
        for _ in range(APPROACH):
            closer = v + self.step(v)
            if not (then := self.cost(closer)) < cost - SETTLED:
                break
            v, cost = closer, then
        return v

    def cost(self, v: Array) -> float:
        """Half the sum of squares at v, through the robust loss, with the priors.

        A line search asks for further points where it did not step to the last one, which its gradient would show:
        there residuals are evaluated without derivatives.
        """
        last = self.kept.sums
        if last.point is None or last.holds(v) or self.kept.gradient.holds(last.point):
            return self._sums(v).cost + 0.5 * self.prior_square(v)
        return float(self.kept.cost(v, self._cost))

    def gradient(self, v: Array) -> tuple[Array, Array]:
        """Gradient and Gauss-Newton Hessian of the cost at v, shapes (size,) and (size, size)."""
        both: tuple[Array, Array] = self.kept.gradient(v, self._gradient)
        return both

    def _gradient(self, v: Array) -> tuple[Array, Array]:
        sums = self._sums(v)
        if self._free:
            return sums.gradient, sums.information
        P = self.prior_matrix
        return sums.gradient + P @ (v - self.prior_mean), sums.information + P

    def triangle(self, v: Array, of: Sequence[int] | None = None) -> Array:
        """Triangular factor of the Jacobian at v, without loss and priors, shape (size, size) or less rows.

        As good as the whole Jacobian, and as small as the variables are; the sums at v come with it.
        of : some of its columns, without the sums
        """
        if of is not None:
            return reduce(_with_rows, (J[:, of] for _, _, J in self.parts(v)), np.zeros((0, len(of))))
        last = self.kept.sums
        known: Sums | None = last.answer if last.holds(v) else None
        if known is None or known.triangle is None:
            known = last.keep(v, self._summed(v, triangle=True))
        assert known.triangle is not None
        return known.triangle

    def undefined(self, v: Array) -> tuple[Measurements, Array] | None:
        """The first set with a residual, or a slope of one, that is no finite number, and at which of its poses."""
        bad: list[list[Array]] = [[] for _ in self.sets]
        for k, r, J in self.parts(v):
            if k < len(self.sets):  # not of separations
                bad[k].append(~np.isfinite(np.column_stack([r, J.reshape(len(r), -1)])).all(axis=1))
        at = ((m, np.concatenate(some)) for m, some in zip(self.sets, bad, strict=True) if some)
        return next((each for each in at if each[1].any()), None)

    def information(self, v: Array) -> Array:
        """J'WJ at v without the priors, shape (size, size); W : the weights that the loss gives."""
        return self._sums(v).information

    def residuals(self, v: Array) -> list[Array]:
        """Of every set, shape (n, m), and of the known separations, where there are any, shape (separations, 1)."""
        left = self._sums(v).residuals
        return self._joined((k, r) for k, r, _ in self.parts(v)) if left is None else left

    def square(self, v: Array) -> float:
        """Sum of the squares of all residuals, without the loss."""
        return self._sums(v).square

    @staticmethod
    def _joined(parts: Iterable[tuple[int, Array]]) -> list[Array]:
        """Residuals of every set."""
        of_set: dict[int, list[Array]] = {}
        for k, r in parts:
            of_set.setdefault(k, []).append(r)
        return [np.concatenate(some) if len(some) > 1 else some[0] for some in of_set.values()]

    def _sums(self, v: Array) -> Sums:
        sums: Sums = self.kept.sums(v, self._summed)
        return sums

    def _summed(self, v: Array, *, triangle: bool = False) -> Sums:
        cost = square = 0.0
        gradient, information = np.zeros(self.size), np.zeros((self.size, self.size))
        residuals: list[tuple[int, Array]] = []
        R = np.zeros((0, self.size))
        for k, r, J in self.parts(v):
            if self.residual_count <= self.most_kept:
                residuals.append((k, r))
            if triangle:
                R = _with_rows(R, J)
            flat = r.ravel()
            square += (own := float(flat @ flat))
            loss = self.loss_of(k)
            cost += own if loss == "linear" else float(loss_value(loss, r).sum())
            rows, y = self.through_loss(k, r, J)
            information += rows.T @ rows
            gradient += rows.T @ y
        kept = self._joined(residuals) if residuals else None
        return Sums(0.5 * cost, gradient, information, square, kept, R if triangle else None)

    def through_loss(self, k: int, r: Array, J: Array) -> tuple[Array, Array]:
        """Rows of the Jacobian and residuals of a part as the loss weighs them, shapes (rows, size) and (rows,)."""
        if (loss := self.loss_of(k)) == "linear":
            return J, r.ravel()
        root = np.sqrt(np.repeat(loss_slope(loss, r), r.shape[1]))
        return J * root[:, None], root * r.ravel()

    def _cost(self, v: Array) -> float:
        """The cost from residuals alone."""
        x, u = self.separate(v)
        of_sets = ((k, r) for k, block in enumerate(self.blocks) for r in block.residuals(x, u))
        residuals = chain(of_sets, ((k, r) for k, r, _ in self._separated(v)))
        return 0.5 * (sum(float(loss_value(self.loss_of(k), r).sum()) for k, r in residuals) + self.prior_square(v))

    def loss_of(self, k: int) -> Loss:
        """Known separations pass through no loss."""
        return self.loss if k < len(self.sets) else "linear"

    def parts(self, v: Array) -> Iterable[_Part]:
        """Some poses at a time: the set's index, residuals, shape (n, m), and Jacobian, shape (n m, size); no loss.

        Kept for the last v where they are few, so that statistics need no further evaluation.
        """
        if self.residual_count * self.size > self.most_kept:
            return self._evaluated(v)
        parts: tuple[_Part, ...] = self.kept.parts(v, lambda v: tuple(self._evaluated(v)))
        return parts

    def _evaluated(self, v: Array) -> Iterator[_Part]:
        x, u = self.separate(v)
        for k, block in enumerate(self.blocks):
            for some, r, J in block.parts(x, u):
                yield k, r, self._widened(block, some, J)
        yield from self._separated(v)

    def _separated(self, v: Array) -> Iterator[_Part]:
        """The part of known distances between touched points, where there are any."""
        if any(m.separations for m in self.sets):
            w = ca.MX.sym("v", self.size)
            r_s = self._separations(ca.reshape(w[len(self.names) :], 3, len(self.labels)))
            both = ca.Function("separations", [w], [r_s, ca.densify(ca.jacobian(r_s, w))])(v)
            yield len(self.sets), both[0].full(), both[1].full()

    def _widened(self, block: Block, some: slice, J: Array) -> Array:
        """The Jacobian of a block's poses by (x, their own points), shape (n, m, z), as one by v, shape (n m, size)."""
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
        rows = [J for _, _, J in self.parts(v)]
        return self.residuals(v), np.concatenate(rows) if len(rows) > 1 else rows[0]

    def at_bounds(self, v: Array) -> Array:
        """Mask of the variables that stopped at a bound."""
        lower, upper = self.bounds
        near = 1e-5 * np.maximum(1.0, np.minimum(upper - lower, 1e3))
        return np.asarray((v - lower < near) | (upper - v < near))

    def decrement(self, v: Array) -> float:
        """What one more Gauss-Newton step inside the bounds would gain in cost, half of chi-squared."""
        g, H = self.gradient(v)
        step = self.step(v)
        return max(0.0, float(-(g + 0.5 * H @ step) @ step))

    def step(self, v: Array) -> Array:
        """The next Gauss-Newton step, to the least of the linearised problem inside the bounds, shape (size,)."""
        lower, upper = self.bounds
        return bounded_step(*self.gradient(v), lower - v, upper - v, self.at_bounds(v))

    def from_points(self, points: Array) -> LeastSquares:
        """With other starts of the unknown points, shape (K, 3) [m]."""
        other = replace(self)
        other.kept.made.update(points=points)
        return other

    def with_loss(self, loss: Loss) -> LeastSquares:
        """With another loss: data, points, which parameters are independent, and residuals at the start stay."""
        other = replace(self, loss=loss)
        other.kept.made.update(self.kept.made)
        if parts := self.kept.parts.at_zero:
            zero = np.zeros(self.size)
            other.kept.parts.keep(zero, parts)
            other._sums(zero)
        return other

    def with_names(self, names: Sequence[str]) -> LeastSquares:
        """With others of the robot's parameters: data and, of some of the same, the sums at the start stay."""
        other = replace(self, names=tuple(names))
        if "blocks" in self.kept.made:
            blocks = tuple(block.with_names(self.robot, other.names) for block in self.blocks)
            other.kept.made.update(labels=self.labels, points=self.points, blocks=blocks)
        place_of = {name: k for k, name in enumerate(self.names)}
        if (sums := self.kept.sums.at_zero) and place_of.keys() >= set(other.names):
            columns = [*(place_of[n] for n in other.names), *range(len(self.names), self.size)]
            other.kept.sums(np.zeros(other.size), lambda _: sums.for_variables(columns))
            other.gradient(np.zeros(other.size))
        return other


@dataclass(frozen=True, eq=False)
class Linearised(LeastSquares):
    """A problem whose residuals are those of another one at a point, and linear in v about it.

    of : the other problem, which differs in loss and sigmas; at : the point, shape (size,)
    """

    of: LeastSquares = field(kw_only=True)
    at: Array = field(kw_only=True)

    @classmethod
    def about(cls, problem: LeastSquares, v: Array, loss: Loss) -> Linearised:
        """A problem about the point v, with another loss."""
        own = {f.name: getattr(problem, f.name) for f in fields(LeastSquares) if f.init}
        made = cls(**own | {"loss": loss}, of=problem, at=v)
        made.kept.made.update(labels=problem.labels, points=problem.points)
        return made

    def with_sigmas(self, sigmas: tuple[tuple[float, float], ...]) -> Linearised:
        """The same with other sigmas, one of a coordinate [m] and of an angle [rad] for each set."""
        other = replace(self, sigmas=sigmas)
        other.kept.made.update(labels=self.labels, points=self.points)
        return other

    def settled(self, v: Array) -> Array:
        """The optimum without bounds, by reweighted least squares from v, shape (size,) (Huber and Ronchetti 2009)."""
        # Steps of the settling of a robust loss at most, and what the last one gains [chi-squared].
        for _ in range(10):
            g, H = self.gradient(v)
            step = scaled_inverse(H) @ g
            v = v - step
            if 0.5 * g @ step < 1e-3:
                break
        return v

    def _evaluated(self, v: Array) -> Iterator[_Part]:
        kinds = [find_kind(m.kind) for m in self.sets]
        ratios = np.array(self.of.sigmas) / np.array(self.sigmas)
        for k, r, J in self.of.parts(self.at):
            r = r + (J @ (v - self.at)).reshape(r.shape)
            if k < len(kinds) and (ratios[k] != 1.0).any():
                unit = np.repeat(ratios[k], [kinds[k].lengths, kinds[k].angles])
                r, J = r * unit, (J.reshape(len(r), len(unit), -1) * unit[:, None]).reshape(J.shape)
            yield k, r, J


def _with_rows(R: Array, J: Array) -> Array:
    """The triangular factor of the rows that a factor stands for and of further ones."""
    return np.asarray(np.linalg.qr(np.concatenate([R, J]) if len(R) else J, mode="r"))


def first_sigmas(sets: Iterable[Measurements]) -> tuple[tuple[float, float], ...]:
    """Of each set one sigma of a coordinate [m] and of an angle [rad], as given, or else a guess."""
    return tuple((m.sigma or SIGMA_GUESS, m.sigma_angle or SIGMA_ANGLE_GUESS) for m in sets)

"""Evidence of laws (expressions of errors), each at one insertion point, given other causes.

The log evidence of thousands of laws at one insertion point is computed together. A law's columns
are those of its place, pose by pose, times functions of its driver. Whitened and orthogonal to the
base model, their products need two quantities for each place: Gram matrices of its columns at each
pose, and coordinates of its columns in the axes of the base model, shape (P, n). The rest is a
matrix product for all functions together.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import itemgetter

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import array_columns
from casadical.core.linear_gaussian.noise import SerialNoise
from casadical.core.statistics import best_of
from casadical.diagnosis.evidence import KAPPA_GRID, KAPPA_WEIGHTS, REPEATABILITY, RHO_GRID, SIGMA_GRID_M, Evidence
from casadical.diagnosis.laws.forms import Driver, Form
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.linearisation import Linearisation
from casadical.diagnosis.noise_evidence import WHITE_FORM
from casadical.diagnosis.noise_evidence import Form as NoiseForm
from casadical.diagnosis.settings import SETTINGS
from casadical.effects.base import CAUSE_PRIOR_SIGMA
from casadical.effects.formula_effect import SEAMS, Law
from casadical.measurements.measurements import Noise
from casadical.robot.robot import Robot

# Value that stands for the log evidence [nats] of laws that were not evaluated.
NOT_JUDGED_LOG_EVIDENCE = -1e9


@dataclass(frozen=True, eq=False)
class Screen:
    """Linear model at one noise ratio rho, prepared to evaluate many laws.

    W : whitening matrix of each pose, shape (n, 3, 3)
    Q : orthonormal basis of the whitened base model, shape (n, 3, P)
    y : residual, whitened and orthogonal to the base model, shape (n, 3) [m]
    square : sum of squares of y and of the deviations over repeated poses [m^2]
    rows : degrees of freedom of both
    """

    W: Array
    Q: Array
    y: Array
    square: float
    rows: int

    @classmethod
    def at_rho(cls, e: Evidence, rho: int) -> Screen:
        """Return the screen of a linear model at a noise ratio; rho : its index in `RHO_GRID`."""
        r = float(RHO_GRID[rho])
        projection = e.projected(r)
        y = projection.y
        rows, (scatter, freedom) = e.r.size, (e.noise_prior.repeats, e.noise_prior.freedom)
        again = freedom * scatter**2 / e.noise.mean_variance({REPEATABILITY: r}, rows)
        Q, residual = projection.Q[:rows].reshape(*e.r.shape, -1), y[:rows].reshape(e.r.shape)
        return cls(projection.W, Q, residual, float(y @ y) + again, max(round(e.count - e.absorbed) + freedom, 1))

    def products(self, columns: Array, functions: Array, later: Array | None = None) -> tuple[Array, Array]:
        """Return the Gram matrices (K, w, w) of K laws, and products with the residual (K, w).

        Each law has w = parts * d columns, whitened and orthogonal to the base model.
        columns : columns of the place, shape (n, 3, d)
        functions : values of the parts of the forms, shape (parts, n, K), or (parts, n, d, K) if
            they differ between columns
        later : contribution of a pose's columns to the next pose under autocorrelated noise, shape
            (n - 1, 3, d); None for white noise
        """
        B = self.W @ columns
        d, parts = B.shape[2], len(functions)
        M = np.einsum("nap,nad->dpn", self.Q, B)
        own = np.einsum("nai,naj->ijn", B, B)
        right = np.einsum("nai,na->in", B, self.y)
        if later is not None:
            A = self.W[1:] @ later
            M[:, :, :-1] += np.einsum("nap,nad->dpn", self.Q[1:], A)
            own[:, :, :-1] += np.einsum("nai,naj->ijn", A, A)
            right[:, :-1] += np.einsum("nai,na->in", A, self.y[1:])
            across = np.einsum("nai,naj->ijn", A, B[1:])
        each = functions[:, :, None] if functions.ndim == 3 else functions
        own_of = [0] * d if functions.ndim == 3 else range(d)
        F = [[np.ascontiguousarray(part[:, i]) for i in range(each.shape[2])] for part in each]
        seen = [[M[i] @ part[own_of[i]] for i in range(d)] for part in F]
        K = functions.shape[-1]
        G = np.empty((K, parts * d, parts * d))
        for a in range(parts):
            for b in range(a, parts):
                both = F[a][0] * F[b][0]
                for i in range(d):
                    for j in range(i if a == b else 0, d):
                        one, other = F[a][own_of[i]], F[b][own_of[j]]
                        if functions.ndim > 3:
                            both = one * other
                        value = own[i, j] @ both - np.einsum("pk,pk->k", seen[a][i], seen[b][j])
                        if later is not None:
                            value += across[i, j] @ (one[:-1] * other[1:]) + across[j, i] @ (other[:-1] * one[1:])
                        G[:, a * d + i, b * d + j] = G[:, b * d + j, a * d + i] = value
        return G, np.stack([right[i] @ part[own_of[i]] for part in F for i in range(d)], axis=1)

    def products_of(self, columns: Array) -> tuple[Array, Array]:
        """Return the same as `products` for K laws with given columns, shape (n, 3, w, K)."""
        B = np.einsum("nab,nbwk->nawk", self.W, columns, optimize=True)
        M = np.tensordot(self.Q, B, axes=((0, 1), (0, 1)))
        G = np.einsum("naik,najk->kij", B, B, optimize=True) - np.einsum("pik,pjk->kij", M, M, optimize=True)
        return G, np.einsum("naik,na->ki", B, self.y, optimize=True)

    def max_gains(self, G: Array, b: Array) -> Array:
        """Return an upper bound of the log evidence over none of K laws, shape (K,) [nats].

        It holds for any size and noise of the grids. G, b : see `products`
        """
        free = (SIGMA_GRID_M[0] / KAPPA_GRID[-1]) ** 2 * np.eye(G.shape[1])
        taken = (b * np.linalg.solve(G + free, b[:, :, None])[:, :, 0]).sum(axis=1)
        return np.asarray(-0.5 * self.rows * np.log1p(-np.minimum(taken / self.square, 1 - 1e-12)))

    def gains(self, G: Array, b: Array, least: float = 0.0) -> Array:
        """Return the log evidence over none of K laws, shape (K,) [nats].

        It is the mean over the sizes of the grid, each at the maximum-likelihood noise.
        G, b : products of columns in units of their typical sizes (see `products`)
        least : laws whose bound (`max_gains`) is below this [nats] get `NOT_JUDGED_LOG_EVIDENCE`
        """
        if least > 0:
            gains, can = np.full(len(b), NOT_JUDGED_LOG_EVIDENCE), self.max_gains(G, b) >= least
            gains[can] = self.gains(G[can], b[can])
            return gains
        rows = self.rows
        least = float(SIGMA_GRID_M[0]) ** 2
        before = max(self.square / rows, least)
        if G.shape[1] == 1:
            value, projected = G[:, :, 0], b
        else:
            value, vector = np.linalg.eigh(G)
            projected = (vector * b[:, :, None]).sum(axis=1)
        value = np.maximum(value, 0.0)
        logs = np.empty((len(KAPPA_GRID), len(b)))
        for k, kappa in enumerate(KAPPA_GRID):
            size = kappa**2
            variance = np.full(len(b), before)
            for _ in range(2):
                taken = (size * projected**2 / (variance[:, None] + size * value)).sum(axis=1)
                variance = np.maximum((self.square - taken) / rows, least)
            gain = 1 + size * value / variance[:, None]
            quad = (size * projected**2 / gain).sum(axis=1) / variance
            logs[k] = -0.5 * rows * np.log(variance) - 0.5 * np.log(gain).sum(axis=1)
            logs[k] += 0.5 * (quad - self.square) / variance
        none = -0.5 * rows * np.log(before) - 0.5 * self.square / before
        return np.asarray(log_mean(logs, np.log(KAPPA_WEIGHTS)[:, None]) - none)


def log_mean(logs: Array, log_weights: Array | float = 0.0) -> Array:
    """Return the log of the weighted mean of exp(logs) over the first axis.

    log_weights : logarithms of the weights; 0 for a sum in place of a mean
    """
    logs = logs + log_weights
    top = logs.max(axis=0)
    return np.asarray(top + np.log(np.exp(logs - top).sum(axis=0)))


@dataclass(frozen=True, eq=False)
class InsertionPoint:
    """A place of the model at which a law may act.

    law : a law with a constant formula there
    columns : derivatives of the measured points by its factors, shape (n, 3, d) [m per unit]
    """

    law: Law
    columns: Array

    @property
    def size(self) -> float:
        """Return the prior sigma of a factor whose function varies by one [rad, m or kg/kg]."""
        # That of the payload is relative to its mass.
        return {"rad": 30e-6, "m": 30e-6}.get(SEAMS[self.law.seam][1], 0.03)

    def takes(self, driver: Driver) -> bool:
        """Return whether a law at this place may depend on a driver.

        For the payload the driver must depend on logged columns only.
        """
        return self.law.seam != "payload" or driver.columns_only

    def with_formula(self, parts: Sequence[str], scales: Sequence[float]) -> Law:
        """Return the law at this place that is the sum of some parts, each with its own factors.

        parts : formulas; scales : variation of each part over the poses (see `scale_of`), by which
            the typical sizes of its factors are divided
        """
        d = SEAMS[self.law.seam][0]
        terms, factors = [], []
        for k, (part, scale) in enumerate(zip(parts, scales, strict=True)):
            # The letters r and t are names of drivers.
            names = "abcdefghijklmnopqsuvwxyz"[k * d : (k + 1) * d]
            terms.append((names if d == 1 else f"[{', '.join(names)}]") + f"*{part}")
            factors += [(name, float(f"{self.size / scale:.3g}")) for name in names]
        return replace(self.law, formula=" + ".join(terms), factors=tuple(factors))


def seams_at(robot: Robot) -> list[Law]:
    """Return a law with a constant formula for every place: joints, links, base, tool and payload.

    The places of an instrument are in `beams`.
    """
    vector = (("a", 1e-5), ("b", 1e-5), ("c", 1e-5))
    seams = [Law(j, "joint", "a") for j in robot.numbers]
    seams += [Law(j, seam, "[a, b, c]", vector) for seam in ("tilt", "shift") for j in robot.numbers]
    # The last link's shift is that of the tool.
    seams = [law for law in seams if (law.seam, law.joint) != ("shift", robot.n)]
    seams += [Law(None, seam, "[a, b, c]", vector) for seam in ("base tilt", "base shift", "tool shift")]
    return [*seams, *([Law(None, "payload", "a", (("a", 0.01),))] if robot.payload else [])]


def with_columns(linear: Linearisation, laws: Sequence[Law]) -> list[InsertionPoint]:
    """Return the insertion points of laws, with their columns at the poses of `linear`."""
    columns = linear.columns(laws)
    edges = np.cumsum([0, *(len(law.sizes()) for law in laws)])
    return [InsertionPoint(law, columns[:, :, a:b]) for law, a, b in zip(laws, edges[:-1], edges[1:], strict=True)]


# Indices in `RHO_GRID`, the ratio of joint repeatability to sigma, at which laws are screened.
SCREENED_RHO_INDICES = (2, 4)


@dataclass(frozen=True, eq=False)
class TriedLaws:
    """The laws of one form and one driver, at one or several places, with all settings.

    seams : the places; more than one for the beam of an instrument, whose stations are settings
    driver, form : driver and form of the laws; x : values of the driver at each place, shape (n,)
    nearby : function of a law and a step that returns the places a step away in each direction, and
        the values of the driver there; None where places cannot be moved
    again : function of a problem and indices of poses that returns the same laws with places found
        from these poses only; None where places do not depend on data
    given : number of the places before any was moved, zero for all
    """

    seams: tuple[InsertionPoint, ...]
    driver: Driver
    form: Form
    x: tuple[Array, ...]
    nearby: Callable[[Law, float], Sequence[tuple[InsertionPoint, Array]]] | None = field(default=None, kw_only=True)
    again: Callable[[Problem, Array], TriedLaws] | None = field(default=None, kw_only=True)
    given: int = field(default=0, kw_only=True)

    @cached_property
    def settings(self) -> tuple[Array, ...]:
        """Return the grid of settings at each place, shape (K, settings) each."""
        return tuple(self.form.grid(x) for x in self.x)

    def with_moved_place(self, seam: int, step: float) -> list[TriedLaws]:
        """Return copies with one more place each, a step away from the place of index `seam`."""
        moved, given = self.nearby(self.seams[seam].law, step) if self.nearby else (), self.given or len(self.seams)
        return [replace(self, seams=(*self.seams, place), x=(*self.x, x), given=given) for place, x in moved]

    def by(self, problem: Problem, poses: Array) -> TriedLaws:
        """Return the laws at their original places, or at places found from some poses only.

        poses : indices of these poses among those of the laws
        """
        if self.again:
            return self.again(problem, poses)
        given = self.given or len(self.seams)
        return replace(self, seams=self.seams[:given], x=self.x[:given], given=0)

    def column(self, seam: int, settings: Array) -> tuple[Law, Array]:
        """Return the law of given settings, and its columns in typical sizes, shape (n, 3, w) [m].

        seam : index of the place; settings : shape (settings,)
        """
        place = self.seams[seam]
        values = self.form.values(self.x[seam], settings[None])
        scales = [float(s) for s in scale_of(values)[:, 0]]
        law = place.with_formula(self.form.texts(self.driver.text, settings.tolist()), scales)
        sizes = np.array([size for size, _ in law.sizes().values()])
        if values.ndim > 3:  # a law of every joint: all factors of the first joint, then those of the next
            each = np.stack([place.columns * v[:, None, :, 0] for v in values], axis=3)
            columns = each.reshape(*each.shape[:2], -1)
        else:
            columns = np.concatenate([place.columns * v[:, None] for v in values], axis=2)
        return law, columns * sizes


@dataclass(frozen=True, eq=False)
class ScreenedLaw:
    """The best law of a form and driver by screened log evidence over none [nats].

    tried : the laws from which it was selected; seam, settings : index of its place, and its
        settings
    best : log evidence of this law; mean : log of the mean evidence over all places and settings
    """

    tried: TriedLaws
    seam: int
    settings: Array
    best: float
    mean: float


@dataclass(frozen=True, eq=False)
class ScoredLaw:
    """A law with its most probable settings.

    law : the law as an effect; tried : the laws from which it was selected
    seam, settings : index of its place, and its settings
    score : log evidence less the price of the search [nats], see `laws.search`
    evidence : log evidence of these settings over none [nats]
    columns : Jacobian by its factors in units of their typical sizes, shape (n, 3, w) [m]
    noise : most probable noise given the law
    errors : standard error of each setting, shape (settings,)
    """

    law: Law
    tried: TriedLaws
    seam: int
    settings: Array
    score: float
    evidence: float
    columns: Array
    noise: Noise
    errors: Array

    @property
    def family(self) -> tuple[str, str]:
        """Return the law's place in words and the family of its driver."""
        return self.law.place, self.tried.driver.family


def scale_of(values: Array) -> Array:
    """Return the scale of each function over poses and joints, shape (parts, K).

    It is the largest of the standard deviation, a tenth of the range, and 1e-3.
    values : as of `Form.values`
    """
    flat = values.reshape(len(values), -1, values.shape[-1])
    # A function that hardly varies is not divided by its scale.
    return np.asarray(np.maximum(np.maximum(flat.std(axis=1), 0.1 * np.ptp(flat, axis=1)), 1e-3))


def scaled(values: Array) -> Array:
    """Return the values of functions divided by their scales; values : as of `Form.values`."""
    scales = scale_of(values)
    return np.asarray(values / scales.reshape(len(values), *[1] * (values.ndim - 2), -1))


@dataclass(frozen=True, eq=False)
class Round:
    """One comparison of laws with listed effects, smooth effects and forms of noise.

    laws : the laws of highest score, the best first
    listed, smooth, noise : label and score [nats] of the best listed effect, unlisted effect and
        form of noise
    alias : labels of listed effects that are equivalent to the best law
    form : form of the noise under which all were evaluated
    """

    laws: tuple[ScoredLaw, ...]
    listed: tuple[str, float]
    smooth: tuple[str, float]
    noise: tuple[str, float]
    alias: tuple[str, ...]
    form: NoiseForm = WHITE_FORM

    @property
    def best(self) -> ScoredLaw:
        """Return the law of the highest score."""
        return self.laws[0]

    @property
    def alike(self) -> tuple[ScoredLaw, ...]:
        """Return at most six laws that the data do not distinguish from the best one.

        Their scores are within `Settings.indistinguishable_law_margin` of its score.
        """
        return tuple(s for s in self.laws[1:] if s.score > self.best.score - SETTINGS.indistinguishable_law_margin)[:6]

    @property
    def claimed(self) -> bool:
        """Return whether the best law is claimed.

        Its score must reach `Settings.min_law_score`, exceed that of the best rival by
        `Settings.min_law_margin`, and no listed effect may be equivalent.
        """
        return (
            self.best.score >= SETTINGS.min_law_score
            and self.best.score >= self.rival[1] + SETTINGS.min_law_margin
            and not self.alias
        )

    @property
    def rival(self) -> tuple[str, float]:
        """Return label and score [nats] of the best rival: listed, unlisted effect or noise."""
        return best_of((self.listed, self.smooth, self.noise), itemgetter(1), logs=True)


@dataclass(frozen=True, eq=False)
class Problem:
    """The linear model of the inlier poses in which laws are evaluated.

    evidence : linear model without candidates; the causes in the model are part of its base
    least : log evidence over none [nats] that a law needs to be of interest
    order, noise : under autocorrelated noise, indices of the poses in time order, and the noise by
        which the evidence is prewhitened; None for white noise
    """

    evidence: Evidence
    least: float = 0.0
    order: Array | None = None
    noise: SerialNoise | None = None

    @classmethod
    def of_case(cls, case: Case, chosen: Array, least: float = 0.0) -> Problem:
        """Return the problem of a case's inlier poses.

        chosen : indices of the columns in the model; least : see the class
        """
        # Only at the most probable noise of the tables, since thousands of laws are evaluated.
        alone = case.judged.with_causes_alone(chosen)
        if case.form is WHITE_FORM:
            return cls(alone, least)
        return cls(alone, least, case.order, case.form.serial(len(case.order)))

    def white(self, columns: Array) -> Array:
        """Return columns of laws (n, 3, ...) prewhitened for autocorrelation as the evidence is."""
        return columns if self.noise is None else self.noise.whiten(columns[self.order])

    @cached_property
    def log_base(self) -> Array:
        """Return the log likelihood without a law, shape (rhos, sigmas)."""
        return self.evidence.log_base()

    def grids(self, columns: Sequence[Array]) -> Array:
        """Return the log likelihood of each law plus the log prior of its size kappa.

        The shape is (laws, rhos, sigmas, kappas). columns : those of each law, shape (n, 3, w)
        """
        edges = np.cumsum([0, *(c.shape[2] for c in columns)])
        every = array_columns(self.white(np.concatenate(columns, axis=2)))
        judged = self.evidence.marginals.with_other_columns(every, CAUSE_PRIOR_SIGMA)
        groups = [np.arange(a, b) for a, b in itertools.pairwise(edges)]
        logs: Array = judged.log_grids(groups) + np.log(KAPPA_WEIGHTS)
        return logs

    def evidences(self, columns: Sequence[Array]) -> Array:
        """Return the exact log evidence over none of each law, shape (laws,) [nats].

        columns : those of each law, shape (n, 3, w)
        """
        return self.over_none(self.grids(columns))

    def over_none(self, grids: Array) -> Array:
        """Return the log evidence over none of each law, (laws,) [nats]; grids : see `grids`."""
        return np.asarray(
            np.logaddexp.reduce(grids.reshape(len(grids), -1), axis=1)
            - float(np.logaddexp.reduce(self.log_base, axis=None))
        )

    @cached_property
    def screens(self) -> list[tuple[float, Screen]]:
        """Return (log weight, screen) at the screened rhos, that of the largest weight first.

        The weight is the posterior probability of the rho without a law.
        """
        near = list(self.evidence.near)
        by_rho = dict(zip(near, np.logaddexp.reduce(self.log_base[near], axis=1), strict=True))
        total = float(np.logaddexp.reduce(self.log_base[near], axis=None))
        selected = [k for k in SCREENED_RHO_INDICES if k in by_rho] or [best_of(near, by_rho.__getitem__, logs=True)]
        screens = [(float(by_rho[k]) - total, Screen.at_rho(self.evidence, k)) for k in selected]
        return sorted(screens, key=lambda s: -s[0])

    @property
    def residual_weights(self) -> Array:
        """Return w, shape (n, numbers), for products of columns with the residual.

        sum(w * column) is the product of the whitened column with the whitened residual.
        """
        screen = self.screens[0][1]
        weights = np.einsum("nab,na->nb", screen.W, screen.y)
        if self.noise is None or self.order is None:
            return np.asarray(weights)
        return self.noise.whiten_transposed(weights)[np.argsort(self.order)]

    def gains(self, seam: InsertionPoint, functions: Array) -> Array:
        """Return the screened log evidence over none of K laws at a place, shape (K,) [nats].

        functions : values of `Form.values` divided by their scales
        """
        columns, functions, later = self.in_order(seam.columns * seam.size, functions)
        return self._gains(
            functions.shape[-1], lambda screen, some: screen.products(columns, functions[..., some], later)
        )

    def in_order(self, columns: Array, functions: Array) -> tuple[Array, Array, Array | None]:
        """Return the arguments columns, functions and later of `Screen.products` for a place.

        columns : those of the place, shape (n, 3, d); functions : shape (parts, n, ...)
        """
        if self.noise is None:
            return columns, functions, None
        own, coefficient = (a[:, None, None] for a in (self.noise.weight, self.noise.ar_coefficient))
        columns = columns[self.order]
        return own * columns, functions[:, self.order], (-coefficient * own)[1:] * columns[:-1]

    def gains_of(self, columns: Array) -> Array:
        """Return the screened log evidence over none of K laws with given columns, (K,) [nats].

        columns : in units of their typical sizes, shape (n, 3, w, K)
        """
        columns = self.white(columns)
        return self._gains(columns.shape[-1], lambda screen, some: screen.products_of(columns[..., some]))

    def _gains(self, count: int, products: Callable[[Screen, Array | slice], tuple[Array, Array]]) -> Array:
        """Return the log evidences of laws, averaged over the screened rhos, shape (count,) [nats].

        Laws that cannot reach `least` at the most probable rho are not evaluated at the others.
        products : function of a screen and indices of laws that returns their `Screen.products`
        """
        some: Array | slice = slice(None)
        gains = np.full((len(self.screens), count), NOT_JUDGED_LOG_EVIDENCE)
        for k, (share, screen) in enumerate(self.screens):
            G, b = products(screen, some)
            least = self.least - share
            gains[k, some] = share + screen.gains(G, b, least)
            # At other rhos a law gains at most 20 nats over its bound at the most probable one.
            if not k and least > 20.0:
                some = np.flatnonzero(screen.max_gains(G, b) >= least - 20.0)
                if not len(some):
                    break
        return log_mean(gains)

"""A law that is tried at a seam (a place where an error may be added), its evidence beside what is known, its score.

Log evidence of thousands of laws at one place, quickly: what all of them share is computed once.

A law's columns are those of its place, pose by pose, times functions of the driver. Made white and orthogonal to the
base model, their products need two things for each place: products of its own columns at each pose, and its columns in
the axes of the base model, shape (P, n). The rest is a product of matrices for all functions together.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import itemgetter

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import ArrayColumns
from casadical.core.linear_gaussian.noise import SerialNoise
from casadical.core.statistics import best_of
from casadical.diagnosis.evidence import KAPPA_GRID, KAPPA_WEIGHTS, REPEATABILITY, RHO_GRID, SIGMA_GRID_M, Evidence
from casadical.diagnosis.laws.forms import Driver, Form
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.linearisation import Linearisation
from casadical.diagnosis.noise_evidence import WHITE_FORM
from casadical.diagnosis.noise_evidence import Form as NoiseForm
from casadical.effects.base import CAUSE_PRIOR_SIGMA
from casadical.effects.formula_effect import SEAMS, Law
from casadical.measurements.measurements import Noise
from casadical.robot.robot import Robot

# Log evidence of what is not judged.
NEVER = -1e9


@dataclass(frozen=True, eq=False)
class Screen:
    """A problem at one rho.

    W : makes each pose's columns white, shape (n, 3, 3); Q : base model's axes, shape (n, 3, P)
    y : residual, white and orthogonal to the base model, shape (n, 3)
    square, rows : of the whole residual and of the scatter of repeated poses, and how many numbers these are
    """

    W: Array
    Q: Array
    y: Array
    square: float
    rows: int

    @classmethod
    def at_rho(cls, e: Evidence, rho: int) -> Screen:
        """The problem at a rho of the grid, by its number."""
        r = float(RHO_GRID[rho])
        projection = e.projected(r)
        y = projection.y
        rows, (scatter, freedom) = e.r.size, (e.known.repeats, e.known.freedom)
        again = freedom * scatter**2 / e.noise.mean_variance({REPEATABILITY: r}, rows)
        Q, left = projection.Q[:rows].reshape(*e.r.shape, -1), y[:rows].reshape(e.r.shape)
        return cls(projection.whitening.W, Q, left, float(y @ y) + again, max(round(e.count - e.absorbed) + freedom, 1))

    def products(self, columns: Array, functions: Array, later: Array | None = None) -> tuple[Array, Array]:
        """Products of every law's columns, shape (K, w, w), and with the residual, shape (K, w); w = parts times d.

        columns : of the place, shape (n, 3, d); functions : parts of the forms at the poses, shape (parts, n, K), or of
            each column, shape (parts, n, d, K)
        later : what a pose's columns do to the numbers of the next one, shape (n - 1, 3, d), where noise follows itself
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
        """The same of laws whose columns are given, shape (n, 3, w, K)."""
        B = np.einsum("nab,nbwk->nawk", self.W, columns, optimize=True)
        M = np.tensordot(self.Q, B, axes=((0, 1), (0, 1)))
        G = np.einsum("naik,najk->kij", B, B, optimize=True) - np.einsum("pik,pjk->kij", M, M, optimize=True)
        return G, np.einsum("naik,na->ki", B, self.y, optimize=True)

    def reach(self, G: Array, b: Array) -> Array:
        """What log evidence over none no law exceeds, whatever its size and the noise, shape (K,); see `gains`."""
        free = (SIGMA_GRID_M[0] / KAPPA_GRID[-1]) ** 2 * np.eye(G.shape[1])
        taken = (b * np.linalg.solve(G + free, b[:, :, None])[:, :, 0]).sum(axis=1)
        return np.asarray(-0.5 * self.rows * np.log1p(-np.minimum(taken / self.square, 1 - 1e-12)))

    def gains(self, G: Array, b: Array, least: float = 0.0) -> Array:
        """Log evidence of each law over none, mean over sizes, noise as it comes out; shape (K,).

        G, b : products of columns in units of their sizes (see `products`)
        least : laws that cannot reach this are not judged, and have `NEVER`
        """
        if least > 0:
            gains, can = np.full(len(b), NEVER), self.reach(G, b) >= least
            gains[can] = self.gains(G[can], b[can])
            return gains
        rows = self.rows
        least = float(SIGMA_GRID_M[0]) ** 2
        before = max(self.square / rows, least)
        if G.shape[1] == 1:
            value, turned = G[:, :, 0], b
        else:
            value, vector = np.linalg.eigh(G)
            turned = (vector * b[:, :, None]).sum(axis=1)
        value = np.maximum(value, 0.0)
        logs = np.empty((len(KAPPA_GRID), len(b)))
        for k, kappa in enumerate(KAPPA_GRID):
            size = kappa**2
            variance = np.full(len(b), before)
            for _ in range(2):
                taken = (size * turned**2 / (variance[:, None] + size * value)).sum(axis=1)
                variance = np.maximum((self.square - taken) / rows, least)
            gain = 1 + size * value / variance[:, None]
            quad = (size * turned**2 / gain).sum(axis=1) / variance
            logs[k] = -0.5 * rows * np.log(variance) - 0.5 * np.log(gain).sum(axis=1)
            logs[k] += 0.5 * (quad - self.square) / variance
        none = -0.5 * rows * np.log(before) - 0.5 * self.square / before
        return np.asarray(log_mean(logs, np.log(KAPPA_WEIGHTS)[:, None]) - none)


def log_mean(logs: Array, log_weights: Array | float = 0.0) -> Array:
    """log(sum(exp(logs + weights))) over the first axis."""
    logs = logs + log_weights
    top = logs.max(axis=0)
    return np.asarray(top + np.log(np.exp(logs - top).sum(axis=0)))


# Realistic size of a law, one sigma: where a form varies by one.
ANGLE, LENGTH, SHARE = 30e-6, 30e-6, 0.03
LETTERS = "abcdefghijklmnopqsuvwxyz"


@dataclass(frozen=True, eq=False)
class Seam:
    """A place; law : with a constant formula there, columns : of its factors, shape (n, 3, d) [m per unit]."""

    law: Law
    columns: Array

    @property
    def size(self) -> float:
        """One sigma of its factors."""
        return {"rad": ANGLE, "m": LENGTH}.get(SEAMS[self.law.seam][1], SHARE)

    def takes(self, driver: Driver) -> bool:
        """Whether a driver may act there: the payload's energy follows logged columns alone."""
        return self.law.seam != "payload" or driver.columns_only

    def with_formula(self, parts: Sequence[str], scales: Sequence[float]) -> Law:
        """The law of these parts, each with factors of its own. scales : how much each part varies."""
        d = SEAMS[self.law.seam][0]
        terms, factors = [], []
        for k, (part, scale) in enumerate(zip(parts, scales, strict=True)):
            names = LETTERS[k * d : (k + 1) * d]
            terms.append((names if d == 1 else f"[{', '.join(names)}]") + f"*{part}")
            factors += [(name, float(f"{self.size / scale:.3g}")) for name in names]
        return replace(self.law, formula=" + ".join(terms), factors=tuple(factors))


def seams_at(robot: Robot) -> list[Law]:
    """Laws with a constant formula at every place that all drivers may act at."""
    vector = (("a", 1e-5), ("b", 1e-5), ("c", 1e-5))
    seams = [Law(j, "joint", "a") for j in robot.numbers]
    seams += [Law(j, seam, "[a, b, c]", vector) for seam in ("tilt", "shift") for j in robot.numbers]
    # The last link's shift is the tool's, and the foot's is the measuring frame's.
    seams = [law for law in seams if (law.seam, law.joint) != ("shift", robot.n)]
    seams += [Law(None, seam, "[a, b, c]", vector) for seam in ("base tilt", "base shift", "tool shift")]
    return [*seams, *([Law(None, "payload", "a", (("a", 0.01),))] if robot.payload else [])]


def with_columns(linear: Linearisation, laws: Sequence[Law]) -> list[Seam]:
    """The places with what they do to the measured point."""
    columns = linear.columns(laws)
    edges = np.cumsum([0, *(len(law.sizes()) for law in laws)])
    return [Seam(law, columns[:, :, a:b]) for law, a, b in zip(laws, edges[:-1], edges[1:], strict=True)]


LEAST_SCALE = 1e-3
# Numbers of the rhos at which laws are screened: what is most probable without a law says little of that with it.
SCREENED = (2, 4)
# Nats by which a law at another rho does not exceed what it reaches at the most probable one.
HOPELESS = 20.0
# Nats of a claim: of the score, and above rivals; of laws that are not distinguished.
CLAIMED, ABOVE, ALIKE = 12.0, 3.0, 5.0
MOST_ALIKE = 6


@dataclass(frozen=True, eq=False)
class Tried:
    """One form of one driver at one place, or at several, with all its settings.

    seams : the place; more than one of the beam, whose stations are settings
    x : the driver's values, shape (n,), at each place; form : see `Form`
    nearby : the place of a law moved by a step, each way that there is, and the driver's values there; None of places
        that are not settings, or cannot be moved
    again : the same with its places found by some poses alone, of a problem; None where they do not follow from data
    given : how many of the places were there before any was moved, zero for all
    """

    seams: tuple[Seam, ...]
    driver: Driver
    form: Form
    x: tuple[Array, ...]
    nearby: Callable[[Law, float], Sequence[tuple[Seam, Array]]] | None = field(default=None, kw_only=True)
    again: Callable[[Problem, Array], Tried] | None = field(default=None, kw_only=True)
    given: int = field(default=0, kw_only=True)

    @cached_property
    def settings(self) -> tuple[Array, ...]:
        """At each place, shape (K, settings)."""
        return tuple(self.form.grid(x) for x in self.x)

    def beside(self, seam: int, step: float) -> list[Tried]:
        """The same with one more place each, a step beside that of a number."""
        moved, given = self.nearby(self.seams[seam].law, step) if self.nearby else (), self.given or len(self.seams)
        return [replace(self, seams=(*self.seams, place), x=(*self.x, x), given=given) for place, x in moved]

    def by(self, problem: Problem, poses: Array) -> Tried:
        """The same without what all poses said of its places: as they were given, or found by some poses alone."""
        if self.again:
            return self.again(problem, poses)
        given = self.given or len(self.seams)
        return replace(self, seams=self.seams[:given], x=self.x[:given], given=0)

    def column(self, seam: int, settings: Array) -> tuple[Law, Array]:
        """The law of these settings, and its columns in units of their sizes, shape (n, 3, w)."""
        place = self.seams[seam]
        values = self.form.values(self.x[seam], settings[None])
        scales = [float(s) for s in scale_of(values)[:, 0]]
        law = place.with_formula(self.form.texts(self.driver.text, settings.tolist()), scales)
        sizes = np.array([size for size, _ in law.sizes().values()])
        if values.ndim > 3:  # of every joint: all factors of the first, then of the next
            each = np.stack([place.columns * v[:, None, :, 0] for v in values], axis=3)
            columns = each.reshape(*each.shape[:2], -1)
        else:
            columns = np.concatenate([place.columns * v[:, None] for v in values], axis=2)
        return law, columns * sizes


@dataclass(frozen=True, eq=False)
class Rough:
    """A law by its screened evidence: what was tried, which place and settings are best, mean over all of them."""

    tried: Tried
    seam: int
    settings: Array
    best: float
    mean: float


@dataclass(frozen=True, eq=False)
class Scored:
    """A law with its most probable settings.

    law : as an effect; tried : what it was selected from; seam, settings : which place and settings of it
    score : see the module; evidence : log evidence of these settings over none
    columns : in units of its sizes, shape (n, 3, w); noise : that it leaves; errors : of the settings, by name
    """

    law: Law
    tried: Tried
    seam: int
    settings: Array
    score: float
    evidence: float
    columns: Array
    noise: Noise
    errors: Array

    @property
    def family(self) -> tuple[str, str]:
        """Place and kind of driver."""
        return self.law.place, self.tried.driver.family


def scale_of(values: Array) -> Array:
    """How much functions vary over poses and joints, shape (parts, K); a constant one, of the base model, a little.

    values : as of `Form.values`
    """
    flat = values.reshape(len(values), -1, values.shape[-1])
    return np.asarray(np.maximum(np.maximum(flat.std(axis=1), 0.1 * np.ptp(flat, axis=1)), LEAST_SCALE))


def scaled(values: Array) -> Array:
    """Functions in units of how much they vary; values : as of `Form.values`."""
    scales = scale_of(values)
    return np.asarray(values / scales.reshape(len(values), *[1] * (values.ndim - 2), -1))


@dataclass(frozen=True, eq=False)
class Round:
    """One comparison of laws with everything else.

    laws : the most probable, the best first; listed, smooth : label and score of the best rivals, refined
    noise : the same of the best form of noise; alias : labels of listed effects whose columns are the best law's
    form : of the noise, by which all were judged
    """

    laws: tuple[Scored, ...]
    listed: tuple[str, float]
    smooth: tuple[str, float]
    noise: tuple[str, float]
    alias: tuple[str, ...]
    form: NoiseForm = WHITE_FORM

    @property
    def best(self) -> Scored:
        """The most probable law."""
        return self.laws[0]

    @property
    def alike(self) -> tuple[Scored, ...]:
        """Laws that these data do not tell from the best one."""
        return tuple(s for s in self.laws[1:] if s.score > self.best.score - ALIKE)[:MOST_ALIKE]

    @property
    def claimed(self) -> bool:
        """Whether the best law is claimed."""
        return self.best.score >= CLAIMED and self.best.score >= self.rival[1] + ABOVE and not self.alias

    @property
    def rival(self) -> tuple[str, float]:
        """Label and score of the best of all rivals."""
        return best_of((self.listed, self.smooth, self.noise), itemgetter(1), logs=True)


@dataclass(frozen=True, eq=False)
class Problem:
    """What laws are judged on: poses that are no outliers, with what is in the model in the base.

    evidence : without candidates; least : log evidence over none that a law needs to be of interest
    order, noise : of noise that follows itself, of whose numbers the evidence is: the poses in the order of measuring
    """

    evidence: Evidence
    least: float = 0.0
    order: Array | None = None
    noise: SerialNoise | None = None

    @classmethod
    def beside(cls, case: Case, chosen: Array, least: float = 0.0) -> Problem:
        """Of a case; chosen : columns of what is in the model already."""
        # At the tables' likely noise alone: thousands of laws are judged.
        alone = case.judged.with_causes_alone(chosen)
        if case.form is WHITE_FORM:
            return cls(alone, least)
        return cls(alone, least, case.order, case.form.serial(len(case.order)))

    def white(self, columns: Array) -> Array:
        """Columns of laws as they are among the numbers of the evidence, shape (n, 3, ...)."""
        return columns if self.noise is None else self.noise.whiten(columns[self.order])

    @cached_property
    def log_base(self) -> Array:
        """Log likelihood without a law, shape (rhos, sigmas)."""
        return self.evidence.log_base()

    def grids(self, columns: Sequence[Array]) -> Array:
        """Log likelihood with each law, shape (laws, rhos, sigmas, kappas), sizes weighted."""
        edges = np.cumsum([0, *(c.shape[2] for c in columns)])
        every = ArrayColumns(self.white(np.concatenate(columns, axis=2)))
        judged = self.evidence.marginals.with_other_columns(every, CAUSE_PRIOR_SIGMA)
        groups = [np.arange(a, b) for a, b in itertools.pairwise(edges)]
        logs: Array = judged.log_grids(groups) + np.log(KAPPA_WEIGHTS)
        return logs

    def evidences(self, columns: Sequence[Array]) -> Array:
        """Exact log evidence over none of each law, shape (laws,)."""
        return self.over_none(self.grids(columns))

    def over_none(self, grids: Array) -> Array:
        """Log evidence over none, shape (laws,); grids : as of `grids`."""
        return np.asarray(
            np.logaddexp.reduce(grids.reshape(len(grids), -1), axis=1)
            - float(np.logaddexp.reduce(self.log_base, axis=None))
        )

    @cached_property
    def screens(self) -> list[tuple[float, Screen]]:
        """Screens at the rhos that matter, each with its log share of the evidence without a law."""
        near = list(self.evidence.near)
        by_rho = dict(zip(near, np.logaddexp.reduce(self.log_base[near], axis=1), strict=True))
        total = float(np.logaddexp.reduce(self.log_base[near], axis=None))
        known = [k for k in SCREENED if k in by_rho] or [best_of(near, by_rho.__getitem__, logs=True)]
        screens = [(float(by_rho[k]) - total, Screen.at_rho(self.evidence, k)) for k in known]
        return sorted(screens, key=lambda s: -s[0])

    @property
    def pulled(self) -> Array:
        """How what is left pulls at small columns: their product with it, white, has this factor, (n, numbers)."""
        screen = self.screens[0][1]
        pull = np.einsum("nab,na->nb", screen.W, screen.y)
        if self.noise is None or self.order is None:
            return np.asarray(pull)
        return self.noise.whiten_transposed(pull)[np.argsort(self.order)]

    def gains(self, seam: Seam, functions: Array) -> Array:
        """Log evidence of laws at a place, shape (K,); functions : in units of their scales, as of `Form.values`."""
        columns, functions, later = self.in_order(seam.columns * seam.size, functions)
        return self._gains(
            functions.shape[-1], lambda screen, some: screen.products(columns, functions[..., some], later)
        )

    def in_order(self, columns: Array, functions: Array) -> tuple[Array, Array, Array | None]:
        """A place's columns and functions as `Screen.products` takes them."""
        if self.noise is None:
            return columns, functions, None
        own, stays = (a[:, None, None] for a in (self.noise.weight, self.noise.ar_coefficient))
        columns = columns[self.order]
        return own * columns, functions[:, self.order], (-stays * own)[1:] * columns[:-1]

    def gains_of(self, columns: Array) -> Array:
        """Log evidence of laws whose columns are given, shape (K,); columns : in units of their sizes, (n, 3, w, K)."""
        columns = self.white(columns)
        return self._gains(columns.shape[-1], lambda screen, some: screen.products_of(columns[..., some]))

    def _gains(self, count: int, products: Callable[[Screen, Array | slice], tuple[Array, Array]]) -> Array:
        """Of so many laws, at the most probable rho, and where these are not hopeless at the others, too."""
        some: Array | slice = slice(None)
        gains = np.full((len(self.screens), count), NEVER)
        for k, (share, screen) in enumerate(self.screens):
            G, b = products(screen, some)
            least = self.least - share
            gains[k, some] = share + screen.gains(G, b, least)
            if not k and least > HOPELESS:
                some = np.flatnonzero(screen.reach(G, b) >= least - HOPELESS)
                if not len(some):
                    break
        return log_mean(gains)

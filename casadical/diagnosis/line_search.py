"""Lines of one joint's error: sines of its reading that stand out of its curve.

A line is looked for beside the base model, all other causes and the curves of the other joints, each as wide as it is
held in the model. The joint's own curve is in the model too, its size learnt again beside the lines that were found: a
line is what neither noise nor a curve without lines explains. Its frequency need not be a whole number. Lines are taken
up one by one, each without a prior. (Chance of the highest peak: Baluev 2008, Assessing the statistical significance
of periodogram peaks, MNRAS 385, eq. 5 to 9, an upper bound.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.fit import Fit
from casadical.core.linear_gaussian.normal_equations import root_of_inverse
from casadical.core.statistics import first_of_best, ranked

# Frequencies that are tried [cycles a turn]: from half a cycle over all readings on, so many to a cycle over them.
LOWEST, PER_CYCLE, WIDEST_STEP = 0.5, 5, 0.5
# A joint whose readings span less than this share of a turn shows too little of its curve for a line.
LEAST_TURNS = 0.25
# Peaks that are looked at more closely, and frequencies tried within a step to each side of one.
PEAKS, FINE = 6, 12
# A line is named up to this chance of it, or of a stronger one, and from so many standard errors of its amplitude on.
CHANCE, DETERMINED, MOST_LINES = 0.01, 3.0, 12
# What is found at an edge of the grid, or beside a line and closer than this share of a cycle over all readings, is
# taken into the model without a name, so often at most.
APART, MOST_UNNAMED = 0.6, 6
# Another frequency is in question beside a line that is at most so many times as probable.
RIVAL = 20.0
# Rounds of Gauss-Newton on the frequencies of a joint's lines; the farthest step, in cycles over all readings.
ROUNDS, FARTHEST = 4, 0.25
# The size of a joint's curve is learnt beside its lines in bands of so many harmonics, in so many rounds, within limits
# in the size that it had.
BAND, LEARNING, LEAST, MOST = 30, 8, 0.02, 8.0
# Poses whose columns are looked at in one go.
AT_ONCE = 512
# A sine is not seen if its coefficients are not determined to this [rad].
SEEN = 3e-4


@dataclass(frozen=True)
class Line:
    """A sine of one joint's reading: amplitude * sin(frequency * q + phase).

    frequency, frequency_error : cycles a turn, with standard error
    amplitude, amplitude_error, phase, phase_error : [rad], with standard errors
    p : chance of it in noise and a curve without lines, over all frequencies and joints that were tried
    rivals : other frequencies that these readings hardly distinguish from it
    multiple_of, factor : frequency of a stronger line of the same joint, and how many times that this one is
    """

    joint: int
    frequency: float
    frequency_error: float
    amplitude: float
    amplitude_error: float
    phase: float
    phase_error: float
    p: float
    rivals: tuple[float, ...] = ()
    multiple_of: float | None = None
    factor: float = 1.0


@dataclass(frozen=True, eq=False)
class Scan:
    """What one sine alone explains of a joint's error, at each frequency that was tried.

    frequency : [cycles a turn]; amplitude, error : with standard error [rad]; needed : from which on it stands out
        [rad]; shapes (k,)
    strongest : index of the sine that explains most; None where nothing is seen
    """

    frequency: Array
    amplitude: Array
    error: Array
    needed: Array
    strongest: int | None


@dataclass(frozen=True, eq=False)
class _Columns:
    """Functions of one joint's reading as columns of a model.

    T : in the background's basis, shape (r, k); GT : products of the basis with them, shape (r, k)
    t : products of them with what the background leaves of the residual, shape (k,)
    weights : inverse variances of their coefficients; 0 for lines, which have no prior, shape (k,)
    """

    T: Array
    GT: Array
    t: Array
    weights: Array

    def __add__(self, other: _Columns) -> _Columns:
        return _Columns(
            np.concatenate([self.T, other.T], axis=1),
            np.concatenate([self.GT, other.GT], axis=1),
            np.concatenate([self.t, other.t]),
            np.concatenate([self.weights, other.weights]),
        )


class Whole:
    """A fit with some lines of all joints in it, from which the background of each joint is made.

    arms : derivative of the position by each joint, made white, shape (n, 3); q : readings, shape (n, joints) [rad]
    """

    def __init__(self, fit: Fit, arms: Mapping[int, Array], q: Array, lines: Sequence[Line]) -> None:
        P = len(fit.prior)
        self.A = np.empty((len(q), fit.numbers, P + 2 * len(lines)))  # much memory: there is no copy of it
        for some, columns in fit.by_parts():
            self.A[some, :, :P] = columns.reshape(-1, fit.numbers, P)
        for k, a in enumerate(lines):
            wave = _waves(q[:, a.joint - 1], [a.frequency])
            self.A[:, :, P + 2 * k : P + 2 * k + 2] = arms[a.joint][:, :, None] * wave[:, None]
        flat = self.A.reshape(-1, self.A.shape[2])
        self.y = fit.y - flat[:, :P] @ fit.mean
        self.g = flat.T @ self.y
        self.of_lines = np.repeat([a.joint for a in lines], 2)
        normal = flat.T @ flat + np.diag(np.concatenate([fit.prior**-2.0, np.zeros(2 * len(lines))]))
        self.root = root_of_inverse(normal)

    def across(self, arm: Array, B: Array) -> Array:
        """Products of all columns, seen along an arm, with functions of the poses, shape (columns, k); B : (n, k)."""
        total = np.zeros((self.A.shape[2], B.shape[1]))
        for first in range(0, len(B), AT_ONCE):
            some = slice(first, first + AT_ONCE)
            total += np.einsum("ni,nip->pn", arm[some], self.A[some]) @ B[some]
        return total

    def without(self, joint: int, own: Array) -> tuple[Array, Array]:
        """Columns that stay without a joint's curve and lines, and the root of their inverse normal matrix."""
        out = np.concatenate([own, self.A.shape[2] - len(self.of_lines) + np.flatnonzero(self.of_lines == joint)])
        rest = np.setdiff1d(np.arange(self.A.shape[2]), out)
        Q, _ = np.linalg.qr(self.root[:, out])
        return rest, self.root[:, rest] - Q @ (Q.T @ self.root[:, rest])


class Background:
    """Everything but one joint's curve and lines: base model, other causes, the other joints' curves and lines.

    Functions of the joint's reading are seen through a basis: their values at the readings or, where these are more,
    Chebyshev polynomials over their range.

    own : places of the joint's curve in the fit; q : its readings, shape (n,) [rad]; arm : see `Whole`
    top : highest frequency [cycles a turn]
    """

    def __init__(self, whole: Whole, joint: int, own: Array, q: Array, arm: Array, top: float) -> None:
        rest, root = whole.without(joint, own)
        fitted = root @ whole.g[rest]
        self.square = float(whole.y @ whole.y - fitted @ fitted)
        self.rows = len(whole.y) - int((whole.of_lines != joint).sum())
        self.weight, toward = (arm**2).sum(axis=1), (arm * whole.y.reshape(arm.shape)).sum(axis=1)
        self.q = q
        self.nodes, B, self.to_basis = _basis(q, top)
        U = root @ whole.across(arm, B)[rest]
        self.G = B.T @ (self.weight[:, None] * B) - U.T @ U
        self.t = B.T @ toward - U.T @ fitted

    def columns(self, values: Array, weights: Array | float = 0.0) -> _Columns:
        """Functions of the reading by their values at the nodes; weights : inverse variances of their coefficients."""
        T = self.to_basis @ values
        return _Columns(T, self.G @ T, T.T @ self.t, np.broadcast_to(weights, T.shape[1]))

    def waves(self, frequencies: Sequence[float] | Array) -> _Columns:
        return self.columns(_waves(self.nodes, frequencies))

    def products(self, a: _Columns, b: _Columns) -> Array:
        return np.asarray(a.T.T @ b.GT)

    def normal(self, own: _Columns) -> Array:
        return np.asarray(self.products(own, own) + np.diag(own.weights))

    def left(self, own: _Columns) -> float:
        """Sum of squares that columns leave, those with a prior as wide as it is."""
        return self.square - float(own.t @ np.linalg.solve(self.normal(own), own.t))

    def pairs(self, sines: _Columns, own: _Columns) -> tuple[Array, Array, Array, Array]:
        """Products of each sine and cosine with what own columns leave of the residual, shape (2 k,), and among
        themselves: sine by sine, sine by cosine, cosine by cosine, shapes (k,).
        """
        k = sines.T.shape[1] // 2
        half = np.linalg.inv(np.linalg.cholesky(self.normal(own)))
        K = half @ self.products(own, sines)
        s, c = slice(k), slice(k, 2 * k)
        ss, sc, cc = (
            (sines.T[:, a] * sines.GT[:, b]).sum(axis=0) - (K[:, a] * K[:, b]).sum(axis=0)
            for a, b in ((s, s), (s, c), (c, c))
        )
        return sines.t - K.T @ (half @ own.t), ss, sc, cc


class Search:
    """One joint's lines beside its curve.

    curve : harmonics of the reading with their prior; top : highest frequency [cycles a turn]
    joints : how many are searched
    """

    def __init__(self, background: Background, joint: int, curve: _Columns, top: float, joints: int) -> None:
        self.b, self.joint, self.curve, self.joints = background, joint, curve, joints
        q, weight = background.q, background.weight
        self.turns = max(float(np.ptp(q)) / (2 * np.pi), 1e-3)
        self.step = min(1 / (PER_CYCLE * self.turns), WIDEST_STEP)
        lowest = max(LOWEST, 0.5 / self.turns)
        self.frequency = np.arange(lowest, top + 1e-9, self.step)
        weight = weight / weight.max() if weight.any() else np.ones(len(q))
        spread = np.sqrt(np.average((q - np.average(q, weights=weight)) ** 2, weights=weight)) / (2 * np.pi)
        self.width = float(max(top - lowest, 0.0) * np.sqrt(4 * np.pi) * spread)
        self.grid = background.waves(self.frequency)

    @property
    def bands(self) -> list[slice]:
        """The curve's columns, sine and cosine of each harmonic in turn, by bands."""
        edges = range(0, len(self.curve.t), 2 * BAND)
        return [slice(k, min(k + 2 * BAND, len(self.curve.t))) for k in edges]

    def beside(self, frequencies: Sequence[float]) -> _Columns:
        """The joint's curve, its size learnt again, and these lines (MacKay's fixed point, see `learnt_sizes`)."""
        both = self.curve + self.b.waves(frequencies)
        products, weights, known = self.b.products(both, both), both.weights.copy(), self.curve.weights
        for _ in range(LEARNING):
            inverse = np.linalg.inv(products + np.diag(weights))
            x = inverse @ both.t
            scale = (self.b.square - both.t @ x) / self.b.rows
            for band in self.bands:
                determined = float((1 - np.diag(inverse)[band] * weights[band]).sum())
                factor = max(float(weights[band] @ x[band] ** 2) / (scale * max(determined, 1.0)), 1e-12)
                weights[band] = np.clip(weights[band] / factor, known[band] / MOST**2, known[band] / LEAST**2)
        return replace(both, weights=weights)

    def sines(self, c: _Columns, own: _Columns) -> tuple[Array, Array, Array]:
        """Of each sine beside own columns: what it takes off the squares, amplitude, mean variance of a coefficient."""
        t, ss, sc, cc = self.b.pairs(c, own)
        k = len(ss)
        det = ss * cc - sc**2
        good = (det > 0) & ((ss + cc) / 2 * self.unit(own) < SEEN**2 * det)
        det = np.where(good, det, np.inf)
        a, b = (cc * t[:k] - sc * t[k:]) / det, (ss * t[k:] - sc * t[:k]) / det
        return a * t[:k] + b * t[k:], np.hypot(a, b), np.where(good, (ss + cc) / (2 * det), np.inf)

    def chance(self, gain: Array | float, freedom: Array | float) -> Array:
        """Of a sine that explains so much, in units of what is left a degree of freedom, anywhere in the search."""
        log_p = -0.5 * freedom * np.log1p(np.asarray(gain) / freedom)
        return np.minimum(self.joints * np.exp(log_p) * (1 + self.width * np.sqrt(-log_p)), 1.0)

    def unit(self, own: _Columns) -> float:
        """What own columns leave a degree of freedom."""
        return self.b.left(own) / (self.b.rows - int((own.weights == 0).sum()))

    def chances(self, frequencies: Sequence[float]) -> Array:
        """Chance of each line beside the others, shape (k,).

        What a line is compared with is noise, known from all rows, and the rest of the curve, known from as many of
        its coefficients in the line's band as the readings determine (Satterthwaite's degrees of freedom).
        """
        own, k = self.beside(frequencies), len(self.curve.t)
        inverse, unit = np.linalg.inv(self.b.normal(own)), self.unit(own)
        alone = np.linalg.inv(self.b.products(waves := self.b.waves(frequencies), waves))
        x, chances = inverse @ own.t, []
        for i, f in enumerate(frequencies):
            c = np.array([i, i + len(frequencies)])
            part = inverse[np.ix_(k + c, k + c)]
            of_noise = float(np.trace(alone[np.ix_(c, c)]) / np.trace(part))
            band = self.bands[min(int(f / BAND), len(self.bands) - 1)]
            determined = max(float((1 - np.diag(inverse)[band] * own.weights[band]).sum()), 1.0)
            freedom = 1 / (of_noise**2 / self.b.rows + (1 - of_noise) ** 2 / determined)
            chances.append(float(self.chance(x[k + c] @ np.linalg.solve(part, x[k + c]) / unit, freedom)))
        return np.array(chances)

    def scan(self) -> Scan:
        """What one sine alone explains."""
        nothing, own = self.b.waves([]), self.beside([])
        gain, amplitude, variance = self.sines(self.grid, nothing)
        tried = np.geomspace(1, 1e4, 4000)
        enough = tried[np.argmax(self.chance(tried, self.b.rows) <= CHANCE)] * self.unit(own)
        strongest = first_of_best(gain) if gain.any() else None
        error = np.sqrt(variance * self.unit(nothing))
        return Scan(self.frequency, amplitude, error, np.sqrt(enough * self.sines(self.grid, own)[2]), strongest)

    def best(self, own: _Columns) -> tuple[float, tuple[float, ...]] | None:
        """The frequency that explains most, and others that are hardly less probable; None where nothing is seen."""
        gain = self.sines(self.grid, own)[0]
        if not gain.any():
            return None
        padded = np.concatenate([[-1.0], gain, [-1.0]])
        peaks = np.flatnonzero((gain >= padded[:-2]) & (gain >= padded[2:]))
        near = self.frequency[peaks[ranked(gain[peaks])[:PEAKS]]]
        found: list[tuple[float, float]] = []
        for f in (*near, near[0] / 2, near[0] * 2):
            fine = f + np.linspace(-1, 1, 2 * FINE + 1) * self.step
            fine = fine[(fine >= self.frequency[0]) & (fine <= self.frequency[-1])]
            if len(fine):
                more = self.sines(self.b.waves(fine), own)[0]
                found.append((float(more.max()), float(fine[first_of_best(more)])))
        most, f = found[first_of_best([gain for gain, _ in found])]
        close = most - 2 * np.log(RIVAL) * self.unit(own)
        others = sorted({x for g, x in found if g >= close and abs(x - f) > 1 / self.turns})
        if others:  # those that explain little more beside the best
            beside = self.sines(self.b.waves(others), own + self.b.waves([f]))[0]
            others = [x for x, g in zip(others, beside, strict=True) if g < most / 2]
        return f, tuple(others)

    def lines(self) -> tuple[Line, ...]:
        """Lines that neither noise nor a curve without lines explains."""
        named: dict[float, tuple[float, ...]] = {}
        unnamed: list[float] = []
        while self.turns >= LEAST_TURNS and len(named) < MOST_LINES and len(unnamed) < MOST_UNNAMED:
            found = self.best(self.beside([*named, *unnamed]))
            if found is None or self.chances([*named, *unnamed, found[0]])[-1] > CHANCE:
                break
            f, rivals = found
            edge = not self.frequency[0] + self.step <= f <= self.frequency[-1] - self.step
            if edge or any(abs(f - g) < APART / self.turns for g in (*named, *unnamed)):
                unnamed.append(f)
                continue
            named[f] = rivals
            named = dict(zip(self.refined([*named], unnamed), named.values(), strict=True))
        return self.final(named, unnamed)

    def refined(self, named: Sequence[float], unnamed: Sequence[float]) -> list[float]:
        """Frequencies of the named lines, all together."""
        now, farthest = np.array(named), FARTHEST / self.turns
        curve = replace(self.curve, weights=self.beside([*named, *unnamed]).weights[: len(self.curve.t)])
        for _ in range(ROUNDS if len(now) else 0):
            own = curve + self.b.waves([*now, *unnamed])
            step, _ = self.slid(own, now, len(unnamed))
            step, before = np.clip(step, -farthest, farthest), self.b.left(own)
            while np.abs(step).max() > 1e-5 and self.b.left(curve + self.b.waves([*(now + step), *unnamed])) > before:
                step = step / 2
            if np.abs(step).max() <= 1e-5:
                break
            now = now + step
        return [float(f) for f in now]

    def slid(self, own: _Columns, named: Array, unnamed: int) -> tuple[Array, Array]:
        """Gauss-Newton step of the named frequencies, shape (k,), and inverse normal matrix of own columns and them."""
        x = np.linalg.solve(self.b.normal(own), own.t)
        first, count = len(self.curve.t), len(named) + unnamed
        a, b = x[first : first + len(named)], x[first + count : first + count + len(named)]
        turned = np.outer(self.b.nodes, named)
        both = own + self.b.columns(self.b.nodes[:, None] * (a * np.cos(turned) - b * np.sin(turned)))
        inverse = np.linalg.inv(self.b.normal(both))
        return (inverse @ both.t)[len(x) :], inverse

    def final(self, named: Mapping[float, tuple[float, ...]], unnamed: Sequence[float]) -> tuple[Line, ...]:
        """The lines with their errors; those that the others make superfluous are dropped."""
        if not named:
            return ()
        frequencies = [*named]
        p = self.chances([*frequencies, *unnamed])
        own = self.beside([*frequencies, *unnamed])
        _, inverse = self.slid(own, np.array(frequencies), len(unnamed))
        x = np.linalg.solve(self.b.normal(own), own.t)
        covariance = inverse * self.unit(own)
        lines = []
        for i, f in enumerate(frequencies):
            first = len(self.curve.t) + i
            c = np.array([first, first + len(p)])
            size, part = float(np.hypot(*x[c])), covariance[np.ix_(c, c)]
            along = x[c] / size
            across = np.array([-along[1], along[0]])
            error, aside = (float(np.sqrt(v @ part @ v)) for v in (along, across))
            slid = float(np.sqrt(covariance[len(x) + i, len(x) + i]))
            phase = float(np.arctan2(along[1], along[0]))
            lines.append(Line(self.joint, f, slid, size, error, phase, aside / size, float(p[i]), named[f]))
        doubt = [
            max(
                a.p / CHANCE,
                a.amplitude_error * max(DETERMINED / a.amplitude, 1 / SEEN),
                a.frequency_error * self.turns,
            )
            for a in lines
        ]
        if max(doubt) <= 1:
            return tuple(lines)
        kept = [f for i, f in enumerate(frequencies) if i != first_of_best(doubt)]
        return self.final(dict(zip(self.refined(kept, unnamed), (named[f] for f in kept), strict=True)), unnamed)


def _waves(q: Array, frequencies: Sequence[float] | Array) -> Array:
    """Sines, then cosines of the readings, shape (n, 2 k)."""
    turned = np.outer(q, frequencies)
    return np.concatenate([np.sin(turned), np.cos(turned)], axis=1)


def _basis(q: Array, top: float) -> tuple[Array, Array, Array]:
    """Nodes at which functions of a reading are taken, shape (m,); the basis at the readings, shape (n, r); and what
    makes its coefficients of the functions' values, shape (r, m). Exact for sines of up to `top` cycles a turn.
    """
    low, high = float(q.min()), float(q.max())
    half, middle = max((high - low) / 2, 1e-6), (high + low) / 2
    most = top * half
    count = int(most + 30 + 10 * np.cbrt(most))
    if count >= len(q):
        return q, np.eye(len(q)), np.eye(len(q))
    turn = (np.arange(count) + 0.5) * np.pi / count
    to_basis = 2 / count * np.cos(np.outer(np.arange(count), turn))
    to_basis[0] /= 2
    at_readings = np.cos(np.outer(np.arccos(np.clip((q - middle) / half, -1, 1)), np.arange(count)))
    return middle + half * np.cos(turn), at_readings, to_basis

"""Tests of the residual for structure: dependence on quantities with a value at each pose.

Whitened residuals are regressed on functions of a driver (a joint angle, sums of two, order in
time, position, orientation, the sense of the last motion) along a direction (an axis of base or
tool, about the base's vertical, the motion of a joint). No driver is a candidate cause, and no
prior limits the size of an error: the explained fraction of the square is compared with its
distribution by chance among all tests (F test, Bonferroni correction). The degrees of freedom are
those of the scatter of the squares (Satterthwaite 1946), which accounts for heavy tails and for
noise in a single direction. Neighbouring poses are compared, too: in joint space, in position, and
in the order of measuring.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from math import exp, lgamma, log, log1p
from typing import Any, ClassVar, cast

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.model import axes_of_base
from casadical.core.linear_gaussian.noise import covariance_of, whitening_of
from casadical.core.reporting.plain import WRITTEN, Key, written
from casadical.core.statistics import first_of_best
from casadical.diagnosis.cross_validation import residual_of_fit_without
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.noise_evidence import Form
from casadical.diagnosis.settings import SETTINGS
from casadical.effects import JointZeroStep
from casadical.identification.accuracy import predicted
from casadical.measurements.derived_columns import MIN_WAY_M, derive, last_sense
from casadical.measurements.measurements import Measurements, Noise
from casadical.robot.robot import Robot

# Greatest frequency of a joint's periodic error that is tested as a line of its own [cycles per
# turn]: strain-wave gears have ratios to 160 and two lobes.
MAX_LINE_CYCLES = 300.0
# Difference of log chances up to which another line of the same joint may be the true one [nats].
ALIAS_NATS = 3.0
# Name of the driver that stands for a correlation of consecutive poses.
PREVIOUS_POSE = "the pose before"


@dataclass(frozen=True)
class Structure:
    """A dependence of the residual on a driver.

    along : name of the direction of the error; over : name of the driver
    share : fraction of the squared whitened residual that it explains, 0 to 1; for neighbouring
        poses their correlation
    log_chance : natural log of the probability of so large a share in pure noise, among all tests
    line : joint (1-based) and cycles per turn of a sine of its angle along its motion; else None
    """

    derived: ClassVar[tuple[Key, ...]] = (Key("log10_chance", lambda found: found.log_chance / log(10), digits=1),)

    along: str = field(metadata=WRITTEN)
    over: str = field(metadata=WRITTEN)
    share: float = field(metadata=written(digits=4))
    log_chance: float
    line: tuple[int, float] | None = None


def remainder_of(
    case: Case, columns: Array, noise: Noise, form: Form | None = None
) -> tuple[tuple[Structure, ...], bool]:
    """Return the drivers on which a fit's residual depends, and whether it is otherwise like noise.

    Of the dependences the most significant one is first. Like noise are Gaussian tails and isotropy.

    columns : indices of the columns of the causes in the fit, shape (k,)
    noise, form : noise by which the residual is whitened; None: white
    """
    return _WhitenedResidual(case, columns, noise, form or Form()).judged()


def shown_by(
    case: Case, columns: Array, noise: Noise, form: Form
) -> tuple[tuple[tuple[int, float], ...], Mapping[Any, str]]:
    """Return periodic joint errors (lines) in the residual of a fit, and its steps.

    A line is a joint (1-based) and cycles per turn; a joint's best one comes with its aliases.
    Steps are as of `events`. Up to 600 poses are tested, or the first 4000 under autocorrelated
    noise. The arguments are those of `remainder_of`.
    """
    residual = _WhitenedResidual(case, columns, noise, form)
    return residual.lines(), residual.events()


def joint_of_outliers(case: Case, columns: Array, noise: Noise) -> int | None:
    """Return the joint (1-based) along whose motion the outliers deviate, or None.

    A joint that errs at few places makes such outliers. For unrelated outliers the cosine between
    error and any direction is uniform from -1 to 1; the chances are combined by Fisher's sum of
    logarithms, with a Bonferroni correction over the joints. Typing errors in one coordinate each
    are no such outliers, though a joint may move the tool along it. None for less than two outliers
    or without positions (`Case.vectors`).
    columns : indices of the causes' columns, shape (k,)
    """
    from scipy.special import gammaincc

    out = ~case.inliers
    if out.sum() < 2 or case.vectors is None:
        return None
    residuals, motions = (
        residual_of_fit_without(case.whole, columns, noise, out)[out, :3],
        case.whole.Jq[out, :3, : case.robot.n],
    )
    lengths = np.linalg.norm(residuals, axis=1)[:, None] * np.linalg.norm(motions, axis=1)
    cosine = np.abs(np.einsum("ki,kij->kj", residuals, motions)) / np.maximum(lengths, 1e-300)
    total = -np.log(np.clip(1 - cosine, 1e-300, 1.0)).sum(axis=0)
    best = first_of_best(total)
    one_coordinate = np.abs(residuals).max(axis=1) / np.maximum(np.linalg.norm(residuals, axis=1), 1e-300)
    if -np.log(np.clip(1 - one_coordinate, 1e-300, 1.0)).sum() >= total[best]:
        return None
    # A sum of k logarithms has a gamma distribution of shape k.
    chance = len(total) * float(gammaincc(len(residuals), total[best]))
    return best + 1 if chance < SETTINGS.max_structure_chance else None


# Drivers, each as its name and the values of its functions at the poses, shape (n, functions).
_Functions = tuple[tuple[str, Array], ...]
# Tests along one direction: its name, its vectors at the poses, shape (n, numbers), drivers with
# equal numbers of functions, and (joint, cycles per turn) of those that are lines, by name.
_Group = tuple[str, Array, _Functions, Mapping[str, tuple[int, float]]]


class _WhitenedResidual:
    """Whitened residuals of a fit, at poses in the order of measuring, and their tests.

    The arguments are those of `remainder_of`.
    """

    def __init__(self, case: Case, columns: Array, noise: Noise, form: Form) -> None:
        self.case = case
        m, _ = derive(case.m, ["progress", *(f"approach{j}" for j in case.robot.numbers)])
        inliers = np.flatnonzero(case.inliers)
        self._order = order = np.argsort(m.conditions["progress"][inliers], kind="stable")
        # The tested poses are spread over the campaign; under autocorrelated noise they are the
        # first ones, in sequence.
        n, most = len(order), min(len(order), 4000 if form.ar_coefficient else 600)
        # Autocorrelated noise can be whitened only over consecutive poses.
        self.pick = np.arange(most) if form.ar_coefficient else np.linspace(0, n - 1, most).round().astype(int)
        self._form = form if form.scale is None else replace(form, scale=form.scale[self.pick])
        self._m, self.at = m[inliers[order]], inliers[order[self.pick]]
        self.e = e = case.evidence.at(order[self.pick])
        C = covariance_of(self._form.repeatability(e.Jq), noise.repeatability / noise.sigma)
        self._W = whitening_of(C)[0] / noise.sigma
        # Orthonormal basis of what a fit with priors absorbs.
        whole = e.with_base(columns)
        A = self.rows(whole.J)
        A *= noise.sigma
        Q, _ = axes_of_base(A, noise.sigma / whole.prior)
        self._Q = Q[: len(A)]
        self._absorbed = float((self._Q**2).sum())
        self.y = self._without_fit(self.rows(e.r[:, :, None]))[:, 0]
        self.squares = (self.y.reshape(len(e.r), -1) ** 2).sum(axis=1)

    def rows(self, X: Array) -> Array:
        """Return k columns of numbers at the poses as whitened rows, shape (n numbers, k).

        X : shape (n, numbers, k)
        """
        white = self._W @ self._form.serial(len(X)).whiten(X)
        return np.asarray(white.reshape(-1, X.shape[2]))

    def _without_fit(self, rows: Array) -> Array:
        """Return whitened rows minus the part of them that the fit absorbs, shape (rows, k)."""
        return np.asarray(rows - self._Q @ (self._Q.T @ rows))

    @cached_property
    def freedom(self) -> float:
        """Return the residual's degrees of freedom, from the scatter of the poses' squares.

        It is Satterthwaite's estimate, at most the count of measured numbers, reduced by the
        fraction that the fit absorbs; the poses of one stop count as one.
        """
        n, numbers = len(self.squares), self.e.count
        scatter = n * float((self.squares**2).sum()) / float(self.squares.sum()) ** 2 - 1
        freedom = min(2 * n / max(scatter, 1e-9), numbers) / self.e.poses_per_stop
        return freedom * (1 - self._absorbed / max(numbers, 1))

    def judged(self) -> tuple[tuple[Structure, ...], bool]:
        """Return up to three significant dependences on drivers, and if the rest is like noise."""
        if not self._has_residual:
            return (), True
        tests = [*(s for group in self._groups() for s in self._tests(*group)), *self._neighbours()]
        tests += [s for j in self.case.robot.numbers for s in self._line_tests(j, self._cycles[j])]
        sure = _significant(tests, len(tests) + self._screened)
        # Of a joint's lines only the most significant one is reported.
        each = {s.line[0] if s.line else s.over: self._with_aliases(s, sure) for s in reversed(sure)}
        # The tails are Gaussian if the squares have 0.6 of the numbers' degrees of freedom.
        tails = self.freedom * self.e.poses_per_stop >= 0.6 * (self.e.count - self._absorbed)
        # At most three drivers are reported.
        return tuple([*reversed(each.values())][:3]), tails and self._isotropic()

    @staticmethod
    def _with_aliases(line: Structure, sure: Sequence[Structure]) -> Structure:
        """Return a line whose name lists the cycles that these angles do not distinguish from it.

        sure : all significant dependences; other dependences are returned unchanged
        """
        same = [
            s.line[1]
            for s in sure
            if s.line
            and line.line
            and s.line[0] == line.line[0]
            and s.log_chance < line.log_chance + ALIAS_NATS
            and abs(s.line[1] - line.line[1]) >= 1
        ]
        others = ", ".join(f"{cycles:.4g}" for cycles in same)
        return replace(line, over=f"{line.over} (or {others})") if others else line

    def lines(self) -> tuple[tuple[int, float], ...]:
        """Return (joint, cycles per turn) of significant lines: the best of a joint and its aliases.

        The joints of an arm often have gears of one ratio: where one shows a line, the others need
        be significant only among the same number of cycles, its half and its double.
        """
        if not self._has_residual:
            return ()
        # The Bonferroni correction counts the lines, which are fewer than the tests of `judged`, so
        # that each line that a page prints is among these.
        tests = [s for j in self.case.robot.numbers for s in self._line_tests(j, self._cycles[j])]
        sure = _significant(tests, self._screened)
        best = {s.line[0]: s for s in reversed(sure) if s.line}
        found = [s.line for s in sure if s.line and s.log_chance < best[s.line[0]].log_chance + ALIAS_NATS]
        others = [j for j in self.case.robot.numbers if j not in best]
        for cycles in {s.line[1] for s in best.values() if s.line} if others else ():
            ratios = [cycles * r for r in (0.5, 1.0, 2.0) if 3 < cycles * r <= MAX_LINE_CYCLES]
            again = [s for j in others for s in self._line_tests(j, ratios)]
            found += [s.line for s in _significant(again, len(again)) if s.line]
        return tuple(dict.fromkeys(found))

    def _line_tests(self, joint: int, cycles: Sequence[float]) -> Iterator[Structure]:
        """Yield the dependences of a joint's motion on lines of its own angle, each tested alone.

        joint : 1-based; cycles : per turn
        """
        q = self.case.m.q[self.at, joint - 1]
        names = {f"q{joint} at {f:.4g} cycles a turn": (joint, float(f)) for f in cycles}
        some = tuple((name, sines(q, [f])) for name, (_, f) in names.items())
        return self._tests(f"joint {joint}", self.e.Jq[:, :, joint - 1], some, names) if some else iter(())

    @cached_property
    def _cycles(self) -> dict[int, tuple[float, ...]]:
        """Return the cycles per turn of the lines of each joint that are tested, by joint (1-based).

        They are the best eight of all lines up to `MAX_LINE_CYCLES` by a screening, one inner
        product over the poses for each, that neglects what the fit absorbs of a line; and the whole
        numbers next to them. The spacing is that which the range of the joint variable resolves.
        """
        serial, n = self._form.serial(len(self.squares)), len(self.squares)
        white = self.y.reshape(n, -1)
        raw = serial.whiten_transposed(np.einsum("nij,ni->nj", self._W, white))
        tested = {}
        for j in self.case.robot.numbers:
            q, v = self.case.m.q[self.at, j - 1], self.e.Jq[:, :, j - 1]
            steps = self._line_steps(j)
            turns = np.exp(1j * steps[:, None] * q)
            weight = (np.einsum("nij,nj->ni", self._W, v) ** 2).sum(axis=1)
            right, double = turns @ (v * raw).sum(axis=1), turns**2 @ weight
            # A pair of sine and cosine explains r' N^-1 r with N = [W - Re d, Im d; Im d, W + Re d] / 2.
            total = weight.sum()
            share = 2 * (total * np.abs(right) ** 2 - (double * (right**2).conj()).real)
            share /= np.maximum(total**2 - np.abs(double) ** 2, 1e-9 * max(total, 1e-300) ** 2)
            best = steps[np.argsort(-share)[:8]]
            near = best.round()[np.abs(best - best.round()) < np.ptp(steps[:2])]
            tested[j] = tuple(dict.fromkeys([*best.tolist(), *near.tolist()]))
        return tested

    def _line_steps(self, joint: int) -> Array:
        """Return the cycles per turn of all lines of a joint's (1-based) own angle, rising."""
        step = max(0.5, np.pi / max(float(np.ptp(self.case.m.q[self.at, joint - 1])), 1e-3))
        return np.arange(SETTINGS.max_joint_harmonic + step, MAX_LINE_CYCLES + step / 2, step)

    @property
    def _screened(self) -> int:
        """Return the number of lines of all joints that `_cycles` screens."""
        return sum(len(self._line_steps(j)) for j in self.case.robot.numbers)

    def events(self) -> Mapping[Any, str]:
        """Return one or two significant steps by an event (slip, jump), each with its label.

        Two are tested together, too: a slip that another one takes back hardly shows alone.
        """
        kinds = {
            cast(Any, replace)(event, at=-1.0): c.label
            for c in self.case.candidates
            for variant in c.variants
            for event in variant
            if getattr(event, "event", 0) == 1 or isinstance(event, JointZeroStep)
        }
        time, n = self.case.progress[self.at], len(self.squares)
        if n < 4 or not (kinds and self._has_residual):
            return {}
        between, every = (time[1:] + time[:-1]) / 2, np.arange(1, n)
        # Pairs are compared at 30 poses, and the best one is moved pose by pose.
        coarse = np.unique(np.linspace(1, n - 1, 30).round().astype(int))
        pairs = coarse[np.array(np.triu_indices(len(coarse), 1))]
        least, shown = log(SETTINGS.max_structure_chance / len(kinds)), tuple[Any, ...]()
        case = self.case.with_variants({(event,): kind for event, kind in kinds.items()})
        for event in kinds:
            chances = self._chances_of_steps(case, event)
            first, second = pairs[:, np.argmin(chances(*pairs))]
            first = every[np.argmin(chances(every[: second - 1], np.full(second - 1, second)))]
            later = every[first:]
            single, double = chances(every), chances(np.full(len(later), first), later)
            for chance, starts in (
                (single.min() + log(n), (np.argmin(single) + 1,)),
                (double.min() + 2 * log(n), (first, later[np.argmin(double)])),
            ):
                if chance < least:
                    least = chance
                    shown = tuple(replace(event, at=float(between[k - 1])) for k in starts)
        return {step: kinds[replace(step, at=-1.0)] for step in shown}

    def _chances_of_steps(self, case: Case, event: Any) -> Callable[..., Array]:
        """Return a function of the poses where steps begin: their log chances, shape (trials,).

        A step's columns are those of an event of the case before all poses, cut off there.
        """
        n = len(self.squares)
        G = self.rows(case.evidence.take(case.columns[event])[self._order[self.pick]])
        G = G.reshape(n, -1, G.shape[1])
        sums = (G.transpose(0, 2, 1) @ G, G.transpose(0, 2, 1) @ self.y.reshape(n, -1, 1))
        absorbed = self._Q.reshape(n, -1, self._Q.shape[1]).transpose(0, 2, 1) @ G
        normal, right, absorbed = (np.cumsum(s[::-1], axis=0)[::-1] for s in (*sums, absorbed))

        def chances(*starts: Array) -> Array:
            fit = np.concatenate([absorbed[k] for k in starts], axis=2)
            both = np.block([[normal[np.maximum(a, b)] for b in starts] for a in starts])
            both -= fit.transpose(0, 2, 1) @ fit
            shares = self._explained(both, np.concatenate([right[a, :, 0] for a in starts], axis=1))
            return np.array([log_chance_of(share, k, self.freedom) for share, k in shares])

        return chances

    @property
    def _has_residual(self) -> bool:
        """Return whether there is a residual to test."""
        return self.e.count - self._absorbed >= 2 and bool(self.squares.sum() > 0)

    @cached_property
    def _places(self) -> Array:
        """Return the inliers' predicted points in the order of measuring, (n_inliers, 3) [m].

        Predictions are used, averaged over repeated touches of a point, so that noise changes
        neither the order nor the neighbours of the points.
        """
        p, alike = predicted(self.case.robot, self._m)[0], self.case.evidence.alike
        if alike is None or any(m.label is None for m in self.case.observations.sets):
            return p
        _, which = np.unique(alike[self._order], return_inverse=True)
        return np.asarray(np.stack([np.bincount(which, c) for c in p.T], axis=1) / np.bincount(which)[:, None])[which]

    def _groups(self) -> Iterator[_Group]:
        """Yield groups of tests: one direction, and drivers with equal numbers of functions."""
        functions: dict[int, tuple[tuple[str, Array], ...]] = {}
        for name, values in _drivers(self.case.robot, self._m, self._places):
            g = values[self.pick]
            if len(g) and np.ptp(g, axis=0).max() > 0:  # a constant explains nothing
                functions[g.shape[1]] = (*functions.get(g.shape[1], ()), (name, g))
        for along, v in self._directions():
            for some in functions.values():
                yield along, v, some, {}

    def _tests(
        self, along: str, v: Array, some: _Functions, cycles: Mapping[str, tuple[int, float]]
    ) -> Iterator[Structure]:
        """Yield the dependence along a direction on each driver, its chance for a single test.

        The arguments are the items of a `_Group`.
        """
        width = some[0][1].shape[1]
        G = np.stack([g for _, g in some], axis=1)
        F = self._without_fit(self.rows(v[:, :, None] * G.reshape(len(v), 1, -1)))
        F = F.reshape(len(F), len(some), width).transpose(1, 0, 2)
        for (over, _), (share, k) in zip(some, self._shares(F), strict=True):
            yield Structure(along, over, share, log_chance_of(share, k, self.freedom), cycles.get(over))

    def _shares(self, F: Array) -> Iterator[tuple[float, int]]:
        """Return, for each group of columns, the explained fraction of the square, and their rank.

        F : whitened columns minus the part that the fit absorbs, shape (groups, rows, width)
        """
        return self._explained(F.transpose(0, 2, 1) @ F, np.einsum("gri,r->gi", F, self.y))

    def _explained(self, normal: Array, right: Array) -> Iterator[tuple[float, int]]:
        """Return the result of `_shares` from inner products of the columns.

        normal, right : with each other and the residual, (groups, width, width), (groups, width)
        """
        scale = np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 1e-300))
        value, vector = np.linalg.eigh(normal / scale[:, :, None] / scale[:, None])
        turned = np.einsum("gij,gi->gj", vector, right / scale)
        # Directions with a smaller eigenvalue are linearly dependent on the others.
        seen = value > 1e-6
        part = np.where(seen, turned**2 / np.where(seen, value, 1.0), 0.0).sum(axis=1) / float(self.squares.sum())
        return zip(part.tolist(), seen.sum(axis=1).tolist(), strict=True)

    def _neighbours(self) -> Iterator[Structure]:
        """Yield the correlation of residuals at neighbouring poses, its chance for a single test.

        Neighbours are the nearest pose in joint space, the previous pose and, for one set of
        positions, the nearest point.
        """
        from scipy.special import log_ndtr

        # Poses of one stop are no neighbours: they share how the joints repeat there.
        stop = np.arange(len(self.squares)) if self.e.stop is None else self.e.stop
        one = np.sort(np.unique(stop, return_index=True)[1])
        y, q = self.y.reshape(len(self.squares), -1)[one], self.case.m.q[self.at][one]
        q = np.concatenate([np.sin(q), np.cos(q)], axis=1)
        pairs = {
            "poses that are near in joint space": _pairs(_nearest(q)),
            PREVIOUS_POSE: np.column_stack([np.arange(len(y) - 1), np.arange(1, len(y))]),
        }
        if self.case.vectors is not None:
            pairs["poses whose points are near"] = _pairs(_nearest(self._places[self.pick][one]))
        for over, both in pairs.items():
            alike = float((y[both[:, 0]] * y[both[:, 1]]).sum() / (y[both] ** 2).sum() * 2)
            z = alike * np.sqrt(len(both) * self.freedom / len(y))
            yield Structure("any direction", over, max(alike, 0.0), float(log_ndtr(-z)))

    def _directions(self) -> Iterator[tuple[str, Array]]:
        """Yield the name and the vectors at the poses, shape (n, numbers), of each direction."""
        for name, axes in self._frames.items():
            yield from zip(name.split(", "), axes.transpose(2, 0, 1), strict=True)
        for j in self.case.robot.numbers:
            yield f"joint {j}", self.e.Jq[:, :, j - 1]

    @cached_property
    def _frames(self) -> Mapping[str, Array]:
        """Return axes in the measuring frame as columns at the poses, shape (n, numbers, 3).

        Rows beyond the position's three are zero. Keys are the axes' names, separated by ", ";
        there are none unless one set with positions was measured (see `Case.vectors`).
        """
        if self.case.vectors is None:
            return {}
        p, n = self.case.positions[self.at], len(self.at)
        R = predicted(self.case.robot, self.case.m[self.at])[1]
        frames = {
            "x, y, z": np.tile(np.eye(3), (n, 1, 1)),
            "the tool's x, the tool's y, the tool's z": R,
            "radius, azimuth, height": about_vertical(p),
        }
        more = self.e.r.shape[1] - 3
        return {name: np.concatenate([F, np.zeros((n, more, 3))], axis=1) for name, F in frames.items()}

    def _isotropic(self) -> bool:
        """Return whether the residual is equally large along all axes of every frame.

        It is Mauchly's test of sphericity; True without `_frames` and under autocorrelated noise.
        """
        n = len(self.squares)
        y = self.y.reshape(n, -1)[:, :3]
        if y.shape[1] < 3 or not self._frames or self._form.ar_coefficient:
            return True
        chances = []
        for axes in self._frames.values():
            turned = np.einsum("nij,ni->nj", axes[:, :3], y)
            value = np.linalg.eigvalsh(turned.T @ turned / n)
            ratio = max(value.prod(), 1e-300) / value.mean() ** 3
            square = -(n / self.e.poses_per_stop - 1 - 17 / 18) * float(np.log(ratio))
            # Chi-square tail with six instead of five degrees of freedom, which has a closed form.
            chances.append(-square / 2 + np.log1p(square / 2 + square**2 / 8))
        # Mauchly's test of isotropy at a level of 0.01 %
        return bool(min(chances) > log(1e-4 / len(chances)))


def _nearest(q: Array) -> Array:
    """Return the index of the nearest other row of q for each row, shape (n,); ties: the first."""
    square, nearest = (q**2).sum(axis=1), np.empty(len(q), dtype=np.int64)
    for first in range(0, len(q), 512):  # some rows at once, which bounds memory
        some = slice(first, first + 512)
        apart = square[some, None] + square - 2 * q[some] @ q.T
        apart[np.arange(len(apart)), first + np.arange(len(apart))] = np.inf
        # Squared distances are rounded, because many poses on a grid are equally near up to
        # round-off.
        nearest[some] = apart.round(9).argmin(axis=1)
    return nearest


def _pairs(nearest: Array) -> Array:
    """Return the pairs (row, its nearest row) as indices, each pair once, shape (pairs, 2)."""
    return np.unique(np.sort(np.column_stack([np.arange(len(nearest)), nearest]), axis=1), axis=0)


def _significant(found: Sequence[Structure], tried: int) -> list[Structure]:
    """Return the dependences that are significant among `tried` tests, the most significant first.

    Their chance is that among all tests (Bonferroni correction).
    """
    among = [replace(s, log_chance=s.log_chance + log(tried)) for s in found]
    return sorted((s for s in among if s.log_chance < log(SETTINGS.max_structure_chance)), key=lambda s: s.log_chance)


def about_vertical(p: Array) -> Array:
    """Return the axes radial, azimuthal and up at points as columns, shape (n, 3, 3).

    p : points in a frame with vertical z, shape (n, 3) [m]; the axes are in the same frame
    """
    a = np.arctan2(p[:, 1], p[:, 0])
    zero, one = np.zeros(len(a)), np.ones(len(a))
    axes = [[np.cos(a), -np.sin(a), zero], [np.sin(a), np.cos(a), zero], [zero, zero, one]]
    return np.asarray(np.array(axes).transpose(2, 0, 1))


def log_chance_of(share: float, width: int, freedom: float) -> float:
    """Return the natural log of the probability that columns explain a fraction of noise's square.

    share : the fraction, or more of it; width : number of columns; freedom : degrees of freedom of
        the noise; where these are not more than the columns, and without columns, the log is 0
    An odd number of columns counts as one more: the tail of the fraction's beta distribution is
    then a finite sum. It is summed in logarithms because scipy's tail underflows below 1e-308.
    """
    half, rest = (width + 1) // 2, (freedom - width) / 2
    if rest <= 0 or not half:
        return 0.0
    share = min(max(share, 0.0), 1 - 1e-12)
    log_share, first = log(max(share, 1e-300)), lgamma(rest)
    terms = [i * log_share + lgamma(rest + i) - first - lgamma(i + 1) for i in range(half)]
    greatest = max(terms)
    return min(0.0, rest * log1p(-share) + greatest + log(sum(exp(term - greatest) for term in terms)))


def _drivers(robot: Robot, m: Measurements, p: Array) -> Iterator[tuple[str, Array]]:
    """Yield every driver's name and its functions (sines, ranks, signs), shape (n, functions).

    m : poses in the order of measuring; p : predicted points, shape (n, 3) [m]
    """
    q, n = m.q, m.q.shape[1]
    for j in range(n):
        yield f"q{j + 1}", sines(q[:, j], range(1, SETTINGS.max_joint_harmonic + 1))
    for i, j in combinations(range(n), 2):
        yield f"q{i + 1} + q{j + 1}", sines(q[:, i] + q[:, j], range(1, SETTINGS.max_joint_harmonic + 1))
        yield f"q{i + 1} - q{j + 1}", sines(q[:, i] - q[:, j], range(1, SETTINGS.max_joint_harmonic + 1))
    R, about = predicted(robot, m)[1], about_vertical(p)
    yield "time", _cosines(m.conditions["progress"])
    places = {"radius": np.hypot(p[:, 0], p[:, 1]), "azimuth": np.arctan2(p[:, 1], p[:, 0]), "height": p[:, 2]}
    for name, values in places.items():
        way = np.diff(values, prepend=values[0])
        way = ((way + np.pi) % (2 * np.pi) - np.pi) * places["radius"] if name == "azimuth" else way
        yield f"the {name}", _cosines(values)
        yield f"the sense of the last change of {name}", last_sense(way, MIN_WAY_M)[:, None]
    for j in range(n):
        yield f"approach{j + 1}", m.conditions[f"approach{j + 1}"][:, None]
    for k, axis in enumerate("xyz"):
        for other, direction in (("x", 0), ("y", 1), ("z", 2)):
            yield f"the tool's {axis} against {other}", _cosines(R[:, direction, k])
        for other, direction in (("the radius", 0), ("the azimuth", 1)):
            yield f"the tool's {axis} against {other}", _cosines((R[:, :, k] * about[:, :, direction]).sum(axis=1))


def sines(angle: Array, cycles: range | list[float]) -> Array:
    """Return sin and cos of each multiple of an angle [rad], alternating, shape (n, 2 multiples).

    cycles : the multiples [cycles per turn]
    """
    return np.stack([f(h * angle) for h in cycles for f in (np.sin, np.cos)], axis=1)


def _cosines(values: Array) -> Array:
    """Return cos(k pi rank) of each value's rank among all, for k from 1 to 4, shape (n, 4).

    Ranks, from zero to one, make quantities that are no angles comparable.
    """
    rank = (np.argsort(np.argsort(values, kind="stable")) + 0.5) / len(values)
    return np.stack([np.cos(np.pi * k * rank) for k in range(1, 5)], axis=1)

"""What a few touched points a day tell of a calibrated robot: a Gaussian model of its errors, and changes beside it.

The robot file says where the points should be. What is measured departs from that by y = J x + r + J d + noise: x, the
errors that the calibration left, with the second moment of the file's [remaining] (or its covariance); r, what nothing
explains, the same at every visit of a pose, on average what the file has less the noise, or as great as both where
touches are planned, far out; daily differences; growth with a logged temperature; and changes d since some day, each
along few columns. Given one change all is Gaussian; causes, days, sizes and the shares of noise and r are summed over
with the weights of `casadical compare`. The error of today is drawn from what comes of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc, chdtri

from casadical.core.basics import Array, InputError
from casadical.core.linear_gaussian.noise import whitening_of
from casadical.core.linear_gaussian.normal_equations import inverse_of
from casadical.fleet.comparison import CAMPAIGNS, YEAR, weighed
from casadical.fleet.estimates import readings_of
from casadical.fleet.evidence import FREQUENCY, KAPPAS, Candidate, candidates_of, daily, log_evidence
from casadical.identification.remaining_errors import residuals_and_jacobian
from casadical.measurements.measurements import STANDSTILL_TOLERANCE, Measurements, same_readings, unmeasured
from casadical.project.acceptance.budget import covariance_root
from casadical.robot.remaining_errors import doubted
from casadical.robot.robot import Robot

# What usually changes, and how often a crash moves several zeros and the tool, or something else happens.
USUAL = ("joint_zero", "tool", "foot", "lengths")
CRASH, UNKNOWN = "crash", "unknown"
OFTEN = {**{kind: float(FREQUENCY[kind]) for kind in USUAL}, CRASH: 2.0, UNKNOWN: 1.0}
# Shares of noise in what nothing explains, where nobody states the noise.
SHARES = (1.0, 0.5, 0.2, 0.08, 0.03, 0.01)
# Growth of lengths, mean and one sigma [1/K], where the temperature is logged.
GROWTH, GROWTH_SIGMA = 12e-6, 6e-6
TEMPERATURE = "temperature_degC"
TASK, DRAWS = 1000, 4000
MM = 1e3


@dataclass(frozen=True, eq=False)
class Draws:
    """Changes that are probable today; a row a draw.

    label : of the change, "" for none; since : first day that shows it, counted from 1; d : departures of parameters
    by it, in units of scale, shape (n, p); x : those that the calibration left, and of the day alone, shape (n, p)
    extra : rms of a change that no parameter makes [mm], shape (n,)
    """

    label: Array
    since: Array
    d: Array
    x: Array
    extra: Array

    def share(self, label: str) -> float:
        """Probability of a change."""
        return float(np.mean(self.label == label))


class _Hypotheses(NamedTuple):
    """Changes of one candidate with one course, at one share of noise.

    factors : of the course on each day, shape (c, rows); Z : columns at the touches, shape (rows, m)
    since : first day that shows it; H, b : as of `visible`
    logs : log evidence with each size, shape (c, kappas); weight : before the data, shape (c,)
    share : number of the share of noise
    """

    candidate: Candidate
    factors: Array
    Z: Array
    since: Array
    H: Array
    b: Array
    logs: Array
    weight: Array
    share: int

    def amplitudes(self, row: int, kappa: float, n: int, rng: np.random.Generator) -> Array:
        """Drawn sizes of one change, shape (n, m)."""
        C = inverse_of(self.H[row] + np.diag((kappa * self.candidate.sizes) ** -2.0))
        return np.asarray(C @ self.b[row] + rng.normal(size=(n, len(C))) @ np.linalg.cholesky(C).T)


@dataclass(frozen=True, eq=False)
class TouchModel:
    """A calibrated robot, as its file says, and its touches, a table a day.

    robot : with the first harmonics of joints, in whose terms the file's errors are; names : parameters that may change
    dates : of the touches [d], None where one is not known
    weights : how often each kind of change is met; noise : of a coordinate [mm], None: not known
    reference : temperature of the calibration [degC], None: not known
    """

    robot: Robot
    days: tuple[Measurements, ...]
    names: tuple[str, ...]
    factor: Array
    rest: float
    weights: Mapping[str, float] = field(default_factory=lambda: OFTEN)
    noise: float | None = None
    reference: float | None = None
    dates: tuple[float | None, ...] = ()

    @staticmethod
    def of_robot(robot: Robot, days: Sequence[Measurements], noise: float | None = None, **more: Any) -> TouchModel:
        """Made from the file's [remaining], or its covariance and the noise [m]. Raises InputError: it has neither."""
        wide = doubted(robot)
        names = tuple(p.name for p in wide.parameters if p.prior > 0)
        scale = np.array([wide.parameters[n].scale for n in names])
        if robot.remaining is not None:
            own = np.zeros((len(names), robot.remaining.factor.shape[1]))
            own[[names.index(n) for n in robot.remaining.names]] = robot.remaining.factor
            rest = robot.remaining.rest
        elif robot.knowledge is not None and robot.knowledge.covariance and noise:
            own, rest = covariance_root(robot.knowledge, names), noise * np.sqrt(3)
        else:
            raise InputError(
                f"{robot.name}: its file does not say how far it may be off ([remaining], or a covariance beside "
                "--noise-mm); write it with `casadical calibrate --out` from 30 positions or more"
            )
        known = robot.knowledge.conditions.get(TEMPERATURE) if robot.knowledge else None
        reference = None if known is None else float(np.mean(known))
        own = own / scale[:, None]
        stated = None if noise is None else MM * noise
        return TouchModel(wide, tuple(days), names, own, MM * rest, noise=stated, reference=reference, **more)

    @cached_property
    def usual(self) -> tuple[Candidate, ...]:
        """What usually changes, one thing each."""
        return tuple(c for c in candidates_of(self.robot, self.names) if c.kind in USUAL and c.names)

    @cached_property
    def candidates(self) -> tuple[Candidate, ...]:
        """What may have changed, a crash and something unknown among it."""
        usual = self.usual
        parts = [c for c in usual if c.kind in ("joint_zero", "tool")]
        columns, sizes = np.hstack([c.columns for c in parts]), np.concatenate([c.sizes for c in parts])
        crash = Candidate(CRASH, None, tuple(n for c in parts for n in c.names), columns, sizes)
        none = np.zeros((len(self.names), 0))
        # Of an unknown change: each coordinate of each pose, one sigma [mm].
        return (*usual, crash, Candidate(UNKNOWN, None, (), none, np.full(3 * self._poses.max() + 3, 0.3)))

    @cached_property
    def day(self) -> Array:
        """Of each coordinate, counted from 1, shape (rows,)."""
        return np.repeat(np.arange(1, len(self.days) + 1), [3 * len(m) for m in self.days])

    @cached_property
    def _poses(self) -> Array:
        """A number for each pose that was touched, on any day, shape (rows / 3,)."""
        return same_readings(np.concatenate([m.q for m in self.days]), STANDSTILL_TOLERANCE)

    @cached_property
    def _evaluated(self) -> tuple[Array, Array]:
        """Measured less predicted, shape (rows,) [mm], and the Jacobian, shape (rows, p) [mm a unit of scale]."""
        r, J = residuals_and_jacobian(self.robot, self.days, self.names)
        return -r.reshape(-1), J.reshape(-1, J.shape[2])

    @property
    def left(self) -> Array:
        """Measured less predicted, shape (poses, 3) [mm]."""
        return self._evaluated[0].reshape(-1, 3)

    @cached_property
    def temperatures(self) -> Array:
        """Of each day, NaN where it is not logged, shape (days,) [degC]."""
        logged = [m.conditions.get(TEMPERATURE) for m in self.days]
        return np.array([np.nan if t is None else float(np.mean(t)) for t in logged])

    @cached_property
    def warmer(self) -> Array:
        """How much warmer than in the calibration, or on the first day, shape (rows,) [K]; zero where nobody knows."""
        T = self.temperatures
        known = T[np.isfinite(T)]
        if not len(known):
            return np.zeros(len(self.day))
        reference = float(known[0]) if self.reference is None else self.reference
        return np.asarray(np.nan_to_num(T - reference)[self.day - 1])

    @property
    def _times(self) -> tuple[Array, bool]:
        """Of the calibration and of each day, in units of a drift; whether they are dates. A month before the first."""
        if not self.dates or any(day is None for day in self.dates):
            return np.arange(len(self.days) + 1) / CAMPAIGNS, False
        days = np.array(self.dates, dtype=float)
        return np.concatenate([[0.0], (days - days[0]) / YEAR + 1 / CAMPAIGNS]), True

    @cached_property
    def _known(self) -> tuple[Array, Array, Array]:
        """y without the usual growth; covariance without what nothing explains; of that, the mask of equal poses."""
        y, J = self._evaluated
        own = J @ self.factor
        S = own @ own.T
        usual = self.usual
        columns, sizes = daily(usual)
        D = (J @ columns) * sizes
        same_day = self.day[:, None] == self.day
        S += (D @ D.T) * same_day
        lengths = [J @ c.columns[:, 0] for c in usual if c.kind == "lengths"]
        if lengths:
            grown = lengths[0] * self.warmer
            y = y - GROWTH * grown
            S += GROWTH_SIGMA**2 * np.outer(grown, grown)
        pose, axis = np.repeat(self._poses, 3), np.tile(np.arange(3), len(self._poses))
        return y, S, (pose[:, None] == pose) & (axis[:, None] == axis)

    @cached_property
    def noises(self) -> list[tuple[float, Array, Array, Array]]:
        """For each share of noise and of what stays: log likelihood, inverse of S, whitened y, log of its roots."""
        y, S, same = self._known
        v = self.rest**2 / 3
        shares = SHARES if self.noise is None else (min(1.0, self.noise**2 / v),)
        levels = []
        noises = [share * v if self.noise is None else self.noise**2 for share in shares]
        for noise, unexplained in [(n, r) for n in noises for r in (max(v - n, 0.0), v)]:
            whole = S + noise * np.eye(len(y)) + unexplained * same
            (W,) = whitening_of(whole[None]).W
            z, roots = W @ y, -np.log(np.diag(W))
            levels.append((-0.5 * float(z @ z) - float(roots.sum()), W.T @ W, z, roots))
        return levels

    def charted(self) -> Array:
        """T^2 of each day given the days before it, nothing changed, shape (days,).

        How probable each share of noise is, the days before tell: a day that changed does not widen its own limit. The
        value is exceeded as rarely as those of the shares are in the mean.
        """
        numbers = np.bincount(self.day)[1:].astype(float)
        own = [(np.bincount(self.day, z**2)[1:], np.bincount(self.day, roots)[1:]) for *_, z, roots in self.noises]
        T2, roots = np.array(own).transpose(1, 0, 2)
        known = np.cumsum(-0.5 * T2 - roots, axis=1) + 0.5 * T2 + roots  # log likelihood of the days before
        weight = np.exp(known - np.logaddexp.reduce(known, axis=0))
        tail = np.clip((weight * chdtrc(numbers, T2)).sum(axis=0), 1e-300, 1 - 1e-12)
        return np.asarray(chdtri(numbers, tail))

    def _columns(self, candidate: Candidate) -> Array:
        """How a change moves the touched points, shape (rows, m) [mm]."""
        if candidate.kind != UNKNOWN:
            return np.asarray(self._evaluated[1] @ candidate.columns)
        at = 3 * np.repeat(self._poses, 3) + np.tile(np.arange(3), len(self._poses))
        return np.asarray(np.eye(len(candidate.sizes))[at])

    def _hypotheses(self) -> Iterator[_Hypotheses]:
        """Each candidate, course and share of noise."""
        y, (times, dated) = self._known[0], self._times
        for c, course, weight, since, courses in weighed(self.candidates, self.weights, times, dated=dated):
            if course == "season":
                continue
            Z, factors = self._columns(c), courses[:, :, 0][:, self.day]
            X = factors[:, :, None] * Z
            for k, (base, P, *_) in enumerate(self.noises):
                PX = P @ X
                H, b = X.transpose(0, 2, 1) @ PX, PX.transpose(0, 2, 1) @ y
                logs = log_evidence(H, b, c.sizes) + base
                yield _Hypotheses(c, factors, Z, since, H, b, logs, weight, k)

    def drawn(self, seed: int = 0) -> Draws:
        """Changes as probable as they are."""
        rng, every = np.random.default_rng(seed), list(self._hypotheses())
        prior = sum(float(h.weight.sum()) for h in every) / len(self.noises)
        none = np.array([n[0] for n in self.noises]) + np.log(max(1 - prior, 1e-12))
        logs = [h.logs + np.log(h.weight)[:, None] - np.log(len(KAPPAS)) for h in every]
        flat = np.concatenate([none, *(own.ravel() for own in logs)])
        p = np.exp(flat - np.logaddexp.reduce(flat))
        chosen = rng.choice(len(flat), size=DRAWS, p=p / p.sum())
        label, since = np.full(DRAWS, "", dtype=object), np.zeros(DRAWS, dtype=int)
        d, extra = np.zeros((DRAWS, len(self.names))), np.zeros(DRAWS)
        x, left = np.zeros_like(d), [self._left(k, rng) for k in range(len(none))]
        for k in range(len(none)):
            own = np.flatnonzero(chosen == k)
            x[own] = left[k](np.zeros((len(own), len(self.day))))
        begins = len(none)
        for h in every:
            inside = chosen[(chosen >= begins) & (chosen < begins + h.logs.size)]
            for number in np.unique(inside):
                own = np.flatnonzero(chosen == number)
                row, kappa = divmod(int(number) - begins, len(KAPPAS))
                a = h.amplitudes(row, float(KAPPAS[kappa]), len(own), rng)
                label[own], since[own] = h.candidate.label, h.since[row]
                x[own] = left[h.share](h.factors[row] * (a @ h.Z.T))
                if h.candidate.kind == UNKNOWN:  # of displacements of all poses, those of the last day
                    moved = a.reshape(len(a), -1, 3)[:, np.unique(self._poses[(self.day == len(self.days))[::3]])]
                    extra[own] = np.sqrt((moved**2).sum(axis=2).mean(axis=1))
                else:
                    d[own] = h.factors[row, -1] * a @ h.candidate.columns.T
            begins += h.logs.size
        return Draws(label, since, d, x, extra)

    def _left(self, share: int, rng: np.random.Generator) -> Callable[[Array], Array]:
        """Draws what the calibration left and what today alone differs, from what changes moved, shape (n, rows)."""
        y, J, P = self._known[0], self._evaluated[1], self.noises[share][1]
        columns, sizes = daily(self.usual)
        D, M = columns * sizes, self.factor @ self.factor.T
        today = self.day == len(self.days)
        warm = float(self.warmer[-1])
        L = next((c.columns[:, 0] for c in self.usual if c.kind == "lengths"), np.zeros(len(self.names)))
        V = M + D @ D.T + (GROWTH_SIGMA * warm) ** 2 * np.outer(L, L)
        cross = M @ J.T + (D @ D.T @ J.T) * today
        cross = cross + GROWTH_SIGMA**2 * warm * np.outer(L, (J @ L) * self.warmer)
        K = cross @ P
        values, U = np.linalg.eigh(V - K @ cross.T)
        root = (U * np.sqrt(np.maximum(values, 0.0))) @ U.T  # whichever way a processor's axes point
        mean = GROWTH * warm * L

        def draw(moved: Array) -> Array:
            return np.asarray(mean + (y - moved) @ K.T + rng.normal(size=(len(moved), len(root))) @ root.T)

        return draw

    @cached_property
    def task(self) -> Array:
        """Jacobian at poses over the readings on which the robot was learnt, shape (n, 3, p) [mm a unit of scale]."""
        J = residuals_and_jacobian(self.robot, [unmeasured(readings_of(self.robot, TASK))], self.names)[1]
        return np.asarray(J[np.isfinite(J).all(axis=(1, 2))])

    @cached_property
    def weight(self) -> Array:
        """Mean J'J over the task, shape (p, p) [mm^2]."""
        return np.asarray(np.einsum("kip,kiq->pq", self.task, self.task, optimize=True) / len(self.task))

    @property
    def stated(self) -> float:
        """Rms error over the task that the file itself states [mm]."""
        return float(np.sqrt(self.rest**2 + np.sum(self.weight * (self.factor @ self.factor.T))))

    def size_of(self, d: Array, extra: Array | float = 0.0) -> Array:
        """Rms over the task of departures, shape (n, p) [mm], shape (n,)."""
        square = np.einsum("np,pq,nq->n", d, self.weight, d, optimize=True)
        return np.asarray(np.sqrt(np.maximum(square, 0.0) + np.square(extra)))

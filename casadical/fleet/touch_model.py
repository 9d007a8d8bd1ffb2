"""Gaussian model of a calibrated robot's errors and changes, updated by a few touched points a day.

The robot file gives predicted positions of the touched points. Their measured deviations are
y = J x + r + J d + noise: x are the errors that the calibration left, with the second moment of the
file's [remaining] (or its covariance); r is an unexplained error that is the same at every visit of
a pose, with the file's mean square less the noise or, for planned touches far out, with all of it;
then follow daily differences, growth with a logged temperature, and changes d since some day, each
along few columns. Given one change the model is Gaussian; candidates, onsets, sizes and shares of
noise are summed over with the weights of `casadical compare`. The error of today is sampled from
the posterior.
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
from casadical.fleet.comparison import CAMPAIGNS_PER_YEAR, DAYS_PER_YEAR, weighted_hypotheses
from casadical.fleet.estimates import readings_of
from casadical.fleet.evidence import KAPPAS, RELATIVE_FREQUENCY, Candidate, candidates_of, daily, log_evidence
from casadical.identification.remaining_errors import residuals_and_jacobian
from casadical.measurements.measurements import STANDSTILL_TOLERANCE, Measurements, same_readings, unmeasured
from casadical.project.acceptance.budget import covariance_root
from casadical.robot.remaining_errors import with_joint_harmonics
from casadical.robot.robot import Robot

# Kinds of change that are usual between two days.
USUAL_KINDS = ("joint_zero", "tool", "foot", "lengths")
# Kind of change in which several zeros and the tool move together.
CRASH = "crash"
# Kind of change that no parameter explains.
UNKNOWN = "unknown"
# Relative frequency of each kind of change; a crash moves several zeros and the tool.
CHANGE_FREQUENCY = {**{kind: float(RELATIVE_FREQUENCY[kind]) for kind in USUAL_KINDS}, CRASH: 2.0, UNKNOWN: 1.0}
# Grid of the noise's share in the unexplained variance, where the noise is not declared.
NOISE_SHARES = (1.0, 0.5, 0.2, 0.08, 0.03, 0.01)
# Prior mean of the thermal growth of all lengths, where the temperature is logged [1/K].
GROWTH_PER_K = 12e-6
# Prior standard deviation of that growth [1/K].
GROWTH_SIGMA_PER_K = 6e-6
# Column of the logged temperature [degC].
TEMPERATURE = "temperature_degC"
# Number of random poses over which the error of the robot is averaged.
TASK_POSES = 1000
# Number of posterior samples.
NUMBER_OF_DRAWS = 4000
MM_PER_M = 1e3


@dataclass(frozen=True, eq=False)
class Draws:
    """Posterior samples of the changes until today, one per row.

    label : of the change, "" for none, shape (n,)
    since : first day that shows it, counted from 1, shape (n,)
    d : deviations of the parameters by the change, in units of scale, shape (n, p)
    x : deviations that the calibration left and those of today alone, in units of scale,
        shape (n, p)
    extra : rms of a change that no parameter explains [mm], shape (n,)
    """

    label: Array
    since: Array
    d: Array
    x: Array
    extra: Array

    def share(self, label: str) -> float:
        """Return the probability of a change."""
        return float(np.mean(self.label == label))


class _Hypotheses(NamedTuple):
    """Changes of one candidate with one course, at one share of noise.

    candidate : what changes
    factors : of the course on each day, shape (c, rows)
    Z : columns of the change at the touches, shape (rows, m) [mm a unit of scale]
    since : first day that shows the change, shape (c,)
    H, b : information and score of the amplitudes, as of `evidence.marginal_information`
    logs : log evidence for each size, shape (c, kappas)
    weight : prior probability, shape (c,)
    share : index of the share of noise
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
        """Return posterior samples of one change's amplitudes, shape (n, m)."""
        C = inverse_of(self.H[row] + np.diag((kappa * self.candidate.sizes) ** -2.0))
        return np.asarray(C @ self.b[row] + rng.normal(size=(n, len(C))) @ np.linalg.cholesky(C).T)


@dataclass(frozen=True, eq=False)
class TouchModel:
    """A calibrated robot, as its file describes it, and its touches, one table per day.

    robot : with the first harmonics of its joints, which the file's remaining errors include
    days : touched positions in the frame of the calibration
    names : parameters that may change, p of them
    factor : root F of the second moment F F' of the remaining errors, in units of scale,
        shape (p, r)
    rest : rms distance that no parameter explains [mm]
    weights : relative frequency of each kind of change
    noise : standard deviation of a coordinate [mm]; None: not known
    reference : temperature of the calibration [degC]; None: not known
    dates : of the days [d], None for one that is not known
    """

    robot: Robot
    days: tuple[Measurements, ...]
    names: tuple[str, ...]
    factor: Array
    rest: float
    weights: Mapping[str, float] = field(default_factory=lambda: CHANGE_FREQUENCY)
    noise: float | None = None
    reference: float | None = None
    dates: tuple[float | None, ...] = ()

    @staticmethod
    def of_robot(robot: Robot, days: Sequence[Measurements], noise: float | None = None, **more: Any) -> TouchModel:
        """Return the model from the file's [remaining], or from its covariance and the noise [m].

        Raises InputError: the file has neither.
        """
        wide = with_joint_harmonics(robot)
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
        stated = None if noise is None else MM_PER_M * noise
        return TouchModel(wide, tuple(days), names, own, MM_PER_M * rest, noise=stated, reference=reference, **more)

    @cached_property
    def usual_candidates(self) -> tuple[Candidate, ...]:
        """The candidates for usual changes: zeros, tool, foot (the base) and lengths."""
        return tuple(c for c in candidates_of(self.robot, self.names) if c.kind in USUAL_KINDS and c.names)

    @cached_property
    def candidates(self) -> tuple[Candidate, ...]:
        """All candidates for changes, including a crash and an unknown change."""
        usual = self.usual_candidates
        parts = [c for c in usual if c.kind in ("joint_zero", "tool")]
        columns, sizes = np.hstack([c.columns for c in parts]), np.concatenate([c.sizes for c in parts])
        crash = Candidate(CRASH, None, tuple(n for c in parts for n in c.names), columns, sizes)
        none = np.zeros((len(self.names), 0))
        # An unknown change displaces each coordinate of each pose independently, by 0.3 mm
        # (standard deviation).
        return (*usual, crash, Candidate(UNKNOWN, None, (), none, np.full(3 * self._poses.max() + 3, 0.3)))

    @cached_property
    def day(self) -> Array:
        """The day of each coordinate, counted from 1, shape (rows,)."""
        return np.repeat(np.arange(1, len(self.days) + 1), [3 * len(m) for m in self.days])

    @cached_property
    def _poses(self) -> Array:
        """A number of each touch's pose, the same on all days, shape (rows / 3,)."""
        return same_readings(np.concatenate([m.q for m in self.days]), STANDSTILL_TOLERANCE)

    @cached_property
    def _evaluated(self) -> tuple[Array, Array]:
        """Measured less predicted, (rows,) [mm], and Jacobian, (rows, p) [mm per unit of scale]."""
        r, J = residuals_and_jacobian(self.robot, self.days, self.names)
        return -r.reshape(-1), J.reshape(-1, J.shape[2])

    @property
    def residual_mm(self) -> Array:
        """Measured less predicted positions in the calibration's frame, shape (touches, 3) [mm]."""
        return self._evaluated[0].reshape(-1, 3)

    @cached_property
    def temperatures(self) -> Array:
        """The mean temperature of each day, NaN where it is not logged, shape (days,) [degC]."""
        logged = [m.conditions.get(TEMPERATURE) for m in self.days]
        return np.array([np.nan if t is None else float(np.mean(t)) for t in logged])

    @cached_property
    def warming(self) -> Array:
        """The temperature above that of the calibration, or of the first day, shape (rows,) [K].

        It is zero where it is not known.
        """
        T = self.temperatures
        known = T[np.isfinite(T)]
        if not len(known):
            return np.zeros(len(self.day))
        reference = float(known[0]) if self.reference is None else self.reference
        return np.asarray(np.nan_to_num(T - reference)[self.day - 1])

    @property
    def _times(self) -> tuple[Array, bool]:
        """The times of the calibration and of each day [years], and whether they come from dates.

        The calibration is taken to be a month before the first day.
        """
        if not self.dates or any(day is None for day in self.dates):
            return np.arange(len(self.days) + 1) / CAMPAIGNS_PER_YEAR, False
        days = np.array(self.dates, dtype=float)
        return np.concatenate([[0.0], (days - days[0]) / DAYS_PER_YEAR + 1 / CAMPAIGNS_PER_YEAR]), True

    @cached_property
    def _gaussian_model(self) -> tuple[Array, Array, Array]:
        """The deviations y less thermal growth, their covariance without r and noise, a mask of r.

        The covariance is shape (rows, rows) [mm^2]; the last is a mask of equal coordinates of
        equal poses.
        """
        y, J = self._evaluated
        own = J @ self.factor
        S = own @ own.T
        usual = self.usual_candidates
        columns, sizes = daily(usual)
        D = (J @ columns) * sizes
        same_day = self.day[:, None] == self.day
        S += (D @ D.T) * same_day
        lengths = [J @ c.columns[:, 0] for c in usual if c.kind == "lengths"]
        if lengths:
            grown = lengths[0] * self.warming
            y = y - GROWTH_PER_K * grown
            S += GROWTH_SIGMA_PER_K**2 * np.outer(grown, grown)
        pose, axis = np.repeat(self._poses, 3), np.tile(np.arange(3), len(self._poses))
        return y, S, (pose[:, None] == pose) & (axis[:, None] == axis)

    @cached_property
    def noises(self) -> list[tuple[float, Array, Array, Array]]:
        """Posterior terms for each share of noise and unexplained error.

        They are the log likelihood, the inverse covariance, the whitened y, and the logarithms of
        the roots.
        """
        y, S, same = self._gaussian_model
        v = self.rest**2 / 3
        shares = NOISE_SHARES if self.noise is None else (min(1.0, self.noise**2 / v),)
        levels = []
        noises = [share * v if self.noise is None else self.noise**2 for share in shares]
        for noise, unexplained in [(n, r) for n in noises for r in (max(v - n, 0.0), v)]:
            whole = S + noise * np.eye(len(y)) + unexplained * same
            (W,) = whitening_of(whole[None]).W
            z, roots = W @ y, -np.log(np.diag(W))
            levels.append((-0.5 * float(z @ z) - float(roots.sum()), W.T @ W, z, roots))
        return levels

    def control_chart(self) -> Array:
        """Return T^2 of each day given the days before it, if nothing changed, shape (days,).

        The shares of noise are weighted by the days before, so that a day that changed does not
        widen its own limit. The value has the same tail probability as the weighted mean of the
        shares.
        """
        numbers = np.bincount(self.day)[1:].astype(float)
        own = [(np.bincount(self.day, z**2)[1:], np.bincount(self.day, roots)[1:]) for *_, z, roots in self.noises]
        T2, roots = np.array(own).transpose(1, 0, 2)
        # Log likelihood of the days before each day.
        known = np.cumsum(-0.5 * T2 - roots, axis=1) + 0.5 * T2 + roots
        weight = np.exp(known - np.logaddexp.reduce(known, axis=0))
        tail = np.clip((weight * chdtrc(numbers, T2)).sum(axis=0), 1e-300, 1 - 1e-12)
        return np.asarray(chdtri(numbers, tail))

    def _columns(self, candidate: Candidate) -> Array:
        """Return the displacement of the touched points by a change, shape (rows, m) [mm]."""
        if candidate.kind != UNKNOWN:
            return np.asarray(self._evaluated[1] @ candidate.columns)
        at = 3 * np.repeat(self._poses, 3) + np.tile(np.arange(3), len(self._poses))
        return np.asarray(np.eye(len(candidate.sizes))[at])

    def _hypotheses(self) -> Iterator[_Hypotheses]:
        """Yield the hypotheses of each candidate, course and share of noise, without seasons."""
        y, (times, dated) = self._gaussian_model[0], self._times
        for c, course, weight, since, courses in weighted_hypotheses(self.candidates, self.weights, times, dated=dated):
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
        """Return posterior samples of the changes and the remaining errors."""
        rng, every = np.random.default_rng(seed), list(self._hypotheses())
        prior = sum(float(h.weight.sum()) for h in every) / len(self.noises)
        none = np.array([n[0] for n in self.noises]) + np.log(max(1 - prior, 1e-12))
        logs = [h.logs + np.log(h.weight)[:, None] - np.log(len(KAPPAS)) for h in every]
        flat = np.concatenate([none, *(own.ravel() for own in logs)])
        p = np.exp(flat - np.logaddexp.reduce(flat))
        chosen = rng.choice(len(flat), size=NUMBER_OF_DRAWS, p=p / p.sum())
        label, since = np.full(NUMBER_OF_DRAWS, "", dtype=object), np.zeros(NUMBER_OF_DRAWS, dtype=int)
        d, extra = np.zeros((NUMBER_OF_DRAWS, len(self.names))), np.zeros(NUMBER_OF_DRAWS)
        x, left = np.zeros_like(d), [self._conditional_sampler(k, rng) for k in range(len(none))]
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
                if h.candidate.kind == UNKNOWN:  # displacements of the poses of the last day
                    moved = a.reshape(len(a), -1, 3)[:, np.unique(self._poses[(self.day == len(self.days))[::3]])]
                    extra[own] = np.sqrt((moved**2).sum(axis=2).mean(axis=1))
                else:
                    d[own] = h.factors[row, -1] * a @ h.candidate.columns.T
            begins += h.logs.size
        return Draws(label, since, d, x, extra)

    def _conditional_sampler(self, share: int, rng: np.random.Generator) -> Callable[[Array], Array]:
        """Return a function that samples x from its posterior, given displacements by changes.

        The displacements have shape (n, rows) [mm]; x, shape (n, p), includes today's own
        differences.
        """
        y, J, P = self._gaussian_model[0], self._evaluated[1], self.noises[share][1]
        columns, sizes = daily(self.usual_candidates)
        D, M = columns * sizes, self.factor @ self.factor.T
        today = self.day == len(self.days)
        warm = float(self.warming[-1])
        L = next((c.columns[:, 0] for c in self.usual_candidates if c.kind == "lengths"), np.zeros(len(self.names)))
        V = M + D @ D.T + (GROWTH_SIGMA_PER_K * warm) ** 2 * np.outer(L, L)
        cross = M @ J.T + (D @ D.T @ J.T) * today
        cross = cross + GROWTH_SIGMA_PER_K**2 * warm * np.outer(L, (J @ L) * self.warming)
        K = cross @ P
        values, U = np.linalg.eigh(V - K @ cross.T)
        root = (U * np.sqrt(np.maximum(values, 0.0))) @ U.T  # symmetric: independent of eigenvector signs
        mean = GROWTH_PER_K * warm * L

        def draw(moved: Array) -> Array:
            return np.asarray(mean + (y - moved) @ K.T + rng.normal(size=(len(moved), len(root))) @ root.T)

        return draw

    @cached_property
    def task(self) -> Array:
        """Jacobian at random poses in the learnt joint ranges, (n, 3, p) [mm per unit of scale]."""
        J = residuals_and_jacobian(self.robot, [unmeasured(readings_of(self.robot, TASK_POSES))], self.names)[1]
        return np.asarray(J[np.isfinite(J).all(axis=(1, 2))])

    @cached_property
    def weight(self) -> Array:
        """The mean of J'J over the task's poses, shape (p, p) [mm^2]."""
        return np.asarray(np.einsum("kip,kiq->pq", self.task, self.task, optimize=True) / len(self.task))

    @property
    def stated(self) -> float:
        """The rms error over the task's poses that the robot file itself states [mm]."""
        return float(np.sqrt(self.rest**2 + np.sum(self.weight * (self.factor @ self.factor.T))))

    def size_of(self, d: Array, extra: Array | float = 0.0) -> Array:
        """Return the rms displacement over the task's poses by deviations d, shape (n,) [mm].

        d : deviations in units of scale, shape (n, p); extra : rms of what no parameter explains
            [mm]
        """
        square = np.einsum("np,pq,nq->n", d, self.weight, d, optimize=True)
        return np.asarray(np.sqrt(np.maximum(square, 0.0) + np.square(extra)))

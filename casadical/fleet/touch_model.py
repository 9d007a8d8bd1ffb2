"""Gaussian model of a calibrated robot's errors and changes, updated by a few touched points a day.

The robot file gives predicted positions of the touched points. Their measured deviations are
y = J x + r + J d + noise: x are the errors after the calibration, with the second moment of the
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
from casadical.core.linear_gaussian.noise import log_gain_by_size, whitening_of
from casadical.core.linear_gaussian.normal_equations import inverse_of
from casadical.fleet.comparison import CAMPAIGNS_PER_YEAR, DAYS_PER_YEAR, weighted_hypotheses
from casadical.fleet.estimates import readings_of
from casadical.fleet.evidence import KAPPAS, RELATIVE_FREQUENCY, Candidate, candidates_of, daily
from casadical.identification.remaining_errors import residuals_and_jacobian
from casadical.measurements.measurements import STANDSTILL_TOLERANCE, Measurements, same_readings, unmeasured
from casadical.project.acceptance.budget import covariance_root
from casadical.robot.robot import Robot, with_joint_harmonics

# Kinds of change (see `Candidate.kind`) that are usual between two days.
USUAL_KINDS = ("joint_zero", "tool", "foot", "lengths")
# Kind of change in which several zeros and the tool move together.
CRASH = "crash"
# Kind of change that no parameter explains.
UNKNOWN = "unknown"
# Frequency of each kind of change between two days, as a count, to which a fleet's may be added.
CHANGE_FREQUENCY = {**{kind: float(RELATIVE_FREQUENCY[kind]) for kind in USUAL_KINDS}, CRASH: 2.0, UNKNOWN: 1.0}
# Prior mean of the thermal growth of all lengths, where the temperature is logged [1/K].
GROWTH_PER_K = 12e-6
# Prior standard deviation of the thermal growth of all lengths [1/K].
GROWTH_SIGMA_PER_K = 6e-6
# Column of the logged temperature [degC].
TEMPERATURE = "temperature_degC"
# Millimetres per metre.
MM_PER_M = 1e3


@dataclass(frozen=True, eq=False)
class Draws:
    """Posterior samples of the changes until today, one per row.

    label : label of the changed candidate, "" for no change, shape (n,)
    since : first day that shows the change, counted from 1, 0 for no change, shape (n,)
    d : deviations of the parameters by the change until the last day, shape (n, p), in units of
        scale
    x : deviations after the calibration plus those of the last day alone, shape (n, p), in
        units of scale
    extra : rms displacement of the last day's poses by a change that no parameter explains,
        shape (n,) [mm]
    """

    label: Array
    since: Array
    d: Array
    x: Array
    extra: Array

    def probability(self, label: str) -> float:
        """Return the posterior probability of the change with this label; "" is no change."""
        return float(np.mean(self.label == label))


class _Hypotheses(NamedTuple):
    """Changes of one candidate with one course, one for each of c onsets, at one level of noise.

    candidate : what changes, along m columns
    factors : factor of the course at each touched coordinate, shape (c, rows)
    Z : displacement of the touched points per unit of amplitude, shape (rows, m) [mm]
    since : first day that shows the change, from 1, shape (c,)
    H, b : information, (c, m, m), and score, (c, m), of the amplitudes
    logs : log likelihood for each size on the grid `KAPPAS`, without its constant, shape
        (c, kappas)
    weight : prior probability of each change, shape (c,)
    level : index into `TouchModel.likelihood_terms`
    """

    candidate: Candidate
    factors: Array
    Z: Array
    since: Array
    H: Array
    b: Array
    logs: Array
    weight: Array
    level: int

    def amplitudes(self, row: int, kappa: float, n: int, rng: np.random.Generator) -> Array:
        """Return n posterior samples of the amplitudes of the change at index `row`, shape (n, m).

        They are factors of the candidate's columns, so that their products are in units of scale;
        for a change that no parameter explains they are displacements [mm].
        """
        C = inverse_of(self.H[row] + np.diag((kappa * self.candidate.sizes) ** -2.0))
        return np.asarray(C @ self.b[row] + rng.normal(size=(n, len(C))) @ np.linalg.cholesky(C).T)


@dataclass(frozen=True, eq=False)
class TouchModel:
    """A calibrated robot, as its file describes it, and its touches, one table per day.

    robot : the calibrated robot with the first harmonics of its joints' errors added as parameters
    days : touched positions of each day in the measuring frame of the calibration, the last day is
        the one that is judged; they have `rows` coordinates together
    names : parameters that may change, p of them
    factor : root F of the second moment F F' of the errors after the calibration, shape (p, r),
        in units of scale
    rest : rms distance between model and measurement that no parameter explains [mm]
    weights : relative frequency of each kind of change
    noise : standard deviation of a touched coordinate [mm]; None: unknown
    reference : temperature of the calibration [degC]; None: unknown
    dates : dates of the days, since 1970 [d]; None for an unknown one
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
        """Return the model of a robot as its file has it, and touches of several days.

        The remaining errors are those of the file's [remaining], else of its covariance and noise.

        days : one table per day, in the order of time
        noise : standard deviation of a touched coordinate [m]; None: unknown
        more : further fields of the model, by name
        Raises InputError: the file has no [remaining], and no covariance or no noise is given.
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
                f"{robot.name}: its file does not say how far it may be off ([remaining], or a "
                "covariance, with --noise-mm); write it with `casadical calibrate --out` from 30 "
                "positions or more"
            )
        temperatures = robot.knowledge.conditions.get(TEMPERATURE) if robot.knowledge else None
        reference = None if temperatures is None else float(np.mean(temperatures))
        own = own / scale[:, None]
        stated = None if noise is None else MM_PER_M * noise
        return TouchModel(wide, tuple(days), names, own, MM_PER_M * rest, noise=stated, reference=reference, **more)

    @cached_property
    def usual_candidates(self) -> tuple[Candidate, ...]:
        """Return the candidates of `USUAL_KINDS`: joint zeros, tool, foot (the base) and all lengths."""
        return tuple(c for c in candidates_of(self.robot, self.names) if c.kind in USUAL_KINDS and c.names)

    @cached_property
    def candidates(self) -> tuple[Candidate, ...]:
        """Return the usual candidates, then a crash and an unknown change.

        A crash changes all joint zeros and the tool at once; an unknown change displaces each
        coordinate of each pose independently.
        """
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
        """Return the day on which each coordinate was touched, counted from 1, shape (rows,)."""
        return np.repeat(np.arange(1, len(self.days) + 1), [3 * len(m) for m in self.days])

    @cached_property
    def _poses(self) -> Array:
        """Return the index of each touch's pose, from 0, shape (rows / 3,), equal for equal readings."""
        return same_readings(np.concatenate([m.q for m in self.days]), STANDSTILL_TOLERANCE)

    @cached_property
    def _evaluated(self) -> tuple[Array, Array]:
        """Return measured less predicted coordinates, shape (rows,) [mm], and the prediction's Jacobian.

        The Jacobian has the shape (rows, p) and is in mm per unit of scale.
        """
        r, J = residuals_and_jacobian(self.robot, self.days, self.names)
        return -r.reshape(-1), J.reshape(-1, J.shape[2])

    @property
    def residual_mm(self) -> Array:
        """Return measured less predicted positions in the measuring frame, shape (touches, 3) [mm]."""
        return self._evaluated[0].reshape(-1, 3)

    @cached_property
    def temperatures(self) -> Array:
        """Return the mean temperature of each day, NaN where it is not logged, shape (days,) [degC]."""
        logged = [m.conditions.get(TEMPERATURE) for m in self.days]
        return np.array([np.nan if t is None else float(np.mean(t)) for t in logged])

    @cached_property
    def warming(self) -> Array:
        """Return the temperature above that of the calibration at each coordinate, shape (rows,) [K].

        If that is unknown, it is above the first logged day's; it is zero on a day without one.
        """
        T = self.temperatures
        finite = T[np.isfinite(T)]
        if not len(finite):
            return np.zeros(len(self.day))
        reference = float(finite[0]) if self.reference is None else self.reference
        return np.asarray(np.nan_to_num(T - reference)[self.day - 1])

    @property
    def _times(self) -> tuple[Array, bool]:
        """Return the times of the calibration and of each day, (days + 1,) [years], and whether dated.

        The calibration is assumed to be a month before the first day. If any date is unknown, each
        day is a month before the next one.
        """
        if not self.dates or any(day is None for day in self.dates):
            return np.arange(len(self.days) + 1) / CAMPAIGNS_PER_YEAR, False
        days = np.array(self.dates, dtype=float)
        return np.concatenate([[0.0], (days - days[0]) / DAYS_PER_YEAR + 1 / CAMPAIGNS_PER_YEAR]), True

    @cached_property
    def _gaussian_model(self) -> tuple[Array, Array, Array]:
        """Return the deviations y, (rows,) [mm], their covariance S, (rows, rows) [mm^2], and a mask.

        y is measured less predicted, less the expected thermal growth. S does not include the
        unexplained error r and noise. The mask, (rows, rows), is true for pairs of the same
        coordinate of the same pose, which have the same r.
        """
        y, J = self._evaluated
        own = J @ self.factor
        S = own @ own.T
        usual = self.usual_candidates
        D = J @ daily(usual)
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
    def likelihood_terms(self) -> list[tuple[float, Array, Array, Array]]:
        """Return the likelihood terms of the deviations y without a change, by level of noise.

        A level is a pair of noise variance and unexplained variance. Its terms are the log
        likelihood without its constant, the inverse covariance of y, (rows, rows) [1/mm^2], the
        whitened y, (rows,), and the logarithms of the diagonal of the covariance's Cholesky factor,
        (rows,).
        """
        y, S, same = self._gaussian_model
        v = self.rest**2 / 3
        # Grid of the ratio of the noise variance of a coordinate to its unexplained variance, the
        # square of `TouchModel.rest` over 3, where the noise is not declared.
        shares = (1.0, 0.5, 0.2, 0.08, 0.03, 0.01) if self.noise is None else (min(1.0, self.noise**2 / v),)
        levels = []
        noises = [share * v if self.noise is None else self.noise**2 for share in shares]
        for noise, unexplained in [(n, r) for n in noises for r in (max(v - n, 0.0), v)]:
            whole = S + noise * np.eye(len(y)) + unexplained * same
            (W,), _ = whitening_of(whole[None])
            z, roots = W @ y, -np.log(np.diag(W))
            levels.append((-0.5 * float(z @ z) - float(roots.sum()), W.T @ W, z, roots))
        return levels

    def control_chart(self) -> Array:
        """Return Hotelling's T^2 of each day, given the days before and no change, shape (days,).

        Its degrees of freedom are the number of the day's coordinates. The levels of noise are
        weighted by the likelihood of the days before, so that a day that changed does not widen its
        own limit; T^2 has the tail probability that is their weighted mean.
        """
        numbers = np.bincount(self.day)[1:].astype(float)
        own = [
            (np.bincount(self.day, z**2)[1:], np.bincount(self.day, roots)[1:])
            for *_, z, roots in self.likelihood_terms
        ]
        T2, roots = np.array(own).transpose(1, 0, 2)
        # Log likelihood of the days before each day.
        log_odds = np.cumsum(-0.5 * T2 - roots, axis=1) + 0.5 * T2 + roots
        weight = np.exp(log_odds - np.logaddexp.reduce(log_odds, axis=0))
        tail = np.clip((weight * chdtrc(numbers, T2)).sum(axis=0), 1e-300, 1 - 1e-12)
        return np.asarray(chdtri(numbers, tail))

    def _columns(self, candidate: Candidate) -> Array:
        """Return the touched points' displacement per unit of amplitude, shape (rows, m) [mm].

        The m amplitudes are those of the candidate's columns; an unknown change has one for each
        coordinate of each pose.
        """
        if candidate.kind != UNKNOWN:
            return np.asarray(self._evaluated[1] @ candidate.columns)
        at = 3 * np.repeat(self._poses, 3) + np.tile(np.arange(3), len(self._poses))
        return np.asarray(np.eye(len(candidate.sizes))[at])

    def _hypotheses(self) -> Iterator[_Hypotheses]:
        """Yield the hypotheses of each candidate, each course except "season" and each noise level.

        Noise levels are those of `likelihood_terms`.
        """
        y, (times, dated) = self._gaussian_model[0], self._times
        for c, course, weight, since, courses in weighted_hypotheses(self.candidates, self.weights, times, dated=dated):
            if course == "season":
                continue
            Z, factors = self._columns(c), courses[:, :, 0][:, self.day]
            X = factors[:, :, None] * Z
            for k, (base, P, *_) in enumerate(self.likelihood_terms):
                PX = P @ X
                H, b = X.transpose(0, 2, 1) @ PX, PX.transpose(0, 2, 1) @ y
                logs = log_gain_by_size(c.sizes[:, None] * H * c.sizes, c.sizes * b, KAPPAS) + base
                yield _Hypotheses(c, factors, Z, since, H, b, logs, weight, k)

    def drawn(self, seed: int = 0) -> Draws:
        """Return 4000 posterior samples of the change and the remaining errors.

        seed : seed of the random generator
        """
        rng, every = np.random.default_rng(seed), list(self._hypotheses())
        prior = sum(float(h.weight.sum()) for h in every) / len(self.likelihood_terms)
        none = np.array([n[0] for n in self.likelihood_terms]) + np.log(max(1 - prior, 1e-12))
        logs = [h.logs + np.log(h.weight)[:, None] - np.log(len(KAPPAS)) for h in every]
        flat = np.concatenate([none, *(own.ravel() for own in logs)])
        p = np.exp(flat - np.logaddexp.reduce(flat))
        draws = 4000
        chosen = rng.choice(len(flat), size=draws, p=p / p.sum())
        label, since = np.full(draws, "", dtype=object), np.zeros(draws, dtype=int)
        d, extra = np.zeros((draws, len(self.names))), np.zeros(draws)
        x, samplers = np.zeros_like(d), [self._conditional_sampler(k, rng) for k in range(len(none))]
        for k in range(len(none)):
            own = np.flatnonzero(chosen == k)
            x[own] = samplers[k](np.zeros((len(own), len(self.day))))
        begins = len(none)
        for h in every:
            inside = chosen[(chosen >= begins) & (chosen < begins + h.logs.size)]
            for number in np.unique(inside):
                own = np.flatnonzero(chosen == number)
                row, kappa = divmod(int(number) - begins, len(KAPPAS))
                a = h.amplitudes(row, float(KAPPAS[kappa]), len(own), rng)
                label[own], since[own] = h.candidate.label, h.since[row]
                x[own] = samplers[h.level](h.factors[row] * (a @ h.Z.T))
                if h.candidate.kind == UNKNOWN:  # displacements of the poses of the last day
                    moved = a.reshape(len(a), -1, 3)[:, np.unique(self._poses[(self.day == len(self.days))[::3]])]
                    extra[own] = np.sqrt((moved**2).sum(axis=2).mean(axis=1))
                else:
                    d[own] = h.factors[row, -1] * a @ h.candidate.columns.T
            begins += h.logs.size
        return Draws(label, since, d, x, extra)

    def _conditional_sampler(self, level: int, rng: np.random.Generator) -> Callable[[Array], Array]:
        """Return a function that samples x of `Draws` from its posterior, given a change.

        The function takes displacements of the touched points by changes, shape (n, rows) [mm], and
        returns one sample for each, shape (n, p), in units of scale.
        """
        y, J, P = self._gaussian_model[0], self._evaluated[1], self.likelihood_terms[level][1]
        D, M = daily(self.usual_candidates), self.factor @ self.factor.T
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
            """Return samples of x, shape (n, p), given displacements, shape (n, rows) [mm]."""
            return np.asarray(mean + (y - moved) @ K.T + rng.normal(size=(len(moved), len(root))) @ root.T)

        return draw

    @cached_property
    def task(self) -> Array:
        """Return the position Jacobian at random poses in the learnt joint ranges, shape (n, 3, p).

        It is in mm per unit of scale; of 1000 random poses in the learnt ranges those that the
        robot can take are used.
        """
        J = residuals_and_jacobian(self.robot, [unmeasured(readings_of(self.robot, 1000))], self.names)[1]
        return np.asarray(J[np.isfinite(J).all(axis=(1, 2))])

    @cached_property
    def weight(self) -> Array:
        """Return the mean of J'J over the task's poses, shape (p, p) [mm^2 per squared unit of scale]."""
        return np.asarray(np.einsum("kip,kiq->pq", self.task, self.task, optimize=True) / len(self.task))

    @property
    def stated(self) -> float:
        """Return the rms error over the task's poses that the robot file itself states [mm]."""
        return float(np.sqrt(self.rest**2 + np.sum(self.weight * (self.factor @ self.factor.T))))

    def size_of(self, d: Array, extra: Array | float = 0.0) -> Array:
        """Return the rms displacement over the task's poses by deviations d, shape (n,) [mm].

        d : deviations of the parameters, shape (n, p), in units of scale
        extra : rms displacement that no parameter explains, shape (n,) or a number [mm], added as
            independent
        """
        square = np.einsum("np,pq,nq->n", d, self.weight, d, optimize=True)
        return np.asarray(np.sqrt(np.maximum(square, 0.0) + np.square(extra)))

"""Rows of a log of commands and positions alone: positions in a simulated replay of the commands.

Base and causes are parameters of the simulated response (see `response`), which is linearised at
the base's fit: the columns of a cause are differences of two simulations. A cause's torque loads
the joint, or moves the limit of its dry friction where it reverses with the direction of motion; a
cause's position error changes the command.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from casadical.core.basics import Array
from casadical.core.levenberg_marquardt import Evaluated, levenberg_marquardt
from casadical.core.statistics import first_of_best
from casadical.diagnosis.candidates import Candidate
from casadical.diagnosis.motion.engine import MIN_SPAN_RAD, LogProblem, Rows
from casadical.diagnosis.motion.response import simulated
from casadical.diagnosis.motion.torque_rows import WARM_UP_TIME_S
from casadical.diagnosis.motion.view import LogView, Signals

# The base's parameters of a joint with, each, the prior standard deviation for a declared drive (see
# `_prior`), that of its change from day to day, and the step of finite differences. Logarithms are
# compliance (one over the gain), friction, damping and inertia (divided by the gain). The others:
# offset [rad], delay beyond the declared one [s], friction divided by the load, sizes of the two
# combinations of body parameters that load the joint most [prior sigmas], excess of friction and of
# damping in the cold arm, of friction near rest [relative], of damping by speed [relative, s/rad].
BASE_PARAMETERS = {
    "compliance": (0.15, 0.02, 1e-2),
    "offset": (0.01, 2e-3, 1e-4),
    "friction": (1.0, 0.18, 1e-2),
    "damping": (0.25, 0.12, 1e-2),
    "inertia": (0.3, 0.04, 1e-2),
    "delay": (4e-3, 2e-3, 1e-3),
    "load friction": (0.05, 0.015, 5e-3),
    "gravity": (1.0, 0.05, 5e-2),
    "gravity 2": (1.0, 0.05, 5e-2),
    "cold": (0.05, 0.05, 2e-2),
    "cold viscous": (0.05, 0.05, 2e-2),
    "dip": (0.3, 0.1, 5e-2),
    "curved": (0.2, 0.05, 2e-2),
}
PARAMETER_COUNT = len(BASE_PARAMETERS)
CLOCK_STEPS = 0.25  # prior mean (negative) and standard deviation of an additional delay [samples]
CAPACITY_SHARES = (0.5, 0.7, 0.85, 0.95)  # tried torque limits, divided by the largest torque


@dataclass(frozen=True, eq=False)
class Replay:
    """Simulation of a log, with variants of its parameters and signals.

    view : signals; loads : torques of the bodies, without that of each joint's own acceleration,
        shape (samples, joints) [N m]
    gravity : loads by two combinations of the bodies' parameters, shape (2, samples, joints) [N m]
    starts : first samples of the runs; length : of the longest run
    """

    view: LogView
    loads: Array
    gravity: Array
    starts: Array
    length: int

    def by_run(self, values: Array) -> Array:
        """Return samples by run, shape (length, runs, ...), the last one repeated.

        values : shape (samples, ...)
        """
        ends = np.append(self.starts[1:], len(values))
        at = np.minimum(self.starts + np.arange(self.length)[:, None], ends - 1)
        return np.asarray(values[at])

    def angles(self, joint: Array, x: Array, signals: Sequence[Signals], capacity: Array | None = None) -> Array:
        """Return simulated angles of variants, shape (samples, variants) [rad].

        joint : of each variant; x : parameters, shape (variants, PARAMETER_COUNT)
        signals : of each variant, by name: load "torque" and "limit" of friction beyond the base's
            [N m], and "position" error [rad], which is subtracted from the command
        capacity : largest position error that the servo acts on, shape (variants,) [rad]
        """
        # Number of samples of all variants that are simulated at once.
        batch = max(1, 1_000_000 // len(self.view.motion.q))
        out = [np.zeros((len(self.view.motion.q), 0))]
        out += [
            self._angles(joint[s], x[s], signals[s], None if capacity is None else capacity[s])
            for k in range(0, len(x), batch)
            for s in [slice(k, k + batch)]
        ]
        return np.concatenate(out, axis=1)

    def _angles(self, joint: Array, x: Array, signals: Sequence[Signals], capacity: Array | None) -> Array:
        """Return the result of `angles` for one batch of variants."""
        m = self.view.motion
        assert m.command is not None
        assert m.command_v is not None
        yields, friction, damping, inertia = np.exp(x[:, [0, 2, 3, 4]]).T
        loads = self.loads[:, joint] + sum(x[:, 7 + k] * self.gravity[k][:, joint] for k in (0, 1))
        limit = friction + np.maximum(x[:, 6], 0.0) * yields * np.abs(loads)
        cold = np.exp(-m.time / WARM_UP_TIME_S)[:, None]
        speed = m.v[:, joint]
        # Speed at which the excess of friction at low speed has fallen to 1/e.
        limit *= 1 + x[:, 9] * cold + x[:, 11] * np.exp(-np.abs(speed) / 0.1)
        drag = damping * speed * (x[:, 10] * cold + x[:, 12] * np.abs(speed))
        command = m.command[:, joint] - x[:, 5] * m.command_v[:, joint]
        for k, own in enumerate(signals):
            for (kind, _), values in own.items():
                if kind == "torque":
                    loads[:, k] += values
                elif kind == "limit":
                    limit[:, k] += yields[k] * values
                else:
                    command[:, k] -= values
        command, rest, limit = (
            self.by_run(a) for a in (command, command - yields * loads - drag - x[:, 1], np.maximum(limit, 0.0))
        )
        middle = (rest[1:] + rest[:-1]) / 2
        start = self.by_run(m.position)[0][:, joint]
        q = simulated(
            middle,
            len(middle),
            start,
            np.array(m.step),
            limit,
            damping,
            inertia,
            commands=None if capacity is None else (command[1:] + command[:-1]) / 2,
            capacity=capacity,
        )
        runs = np.searchsorted(self.starts, np.arange(len(m.q)), side="right") - 1
        return np.asarray(q[np.arange(len(m.q)) - self.starts[runs], runs])


def servo_problem(views: Sequence[LogView]) -> tuple[LogProblem, Replay, Array]:
    """Return the problem of a log, its simulation, and the base's fit, shape (joints, PARAMETER_COUNT).

    views : the log and, if there is one, its reference, whose fit is the prior then
    """
    statics = [v.arm.regressor(v.motion.q, 0 * v.motion.q, 0 * v.motion.q) for v in views]
    turns = _turns(statics, views[0].arm.spread)
    mean, width = _prior(views[0])
    covariance = np.stack([np.diag(w**2) for w in width])
    # Typical noise of a position in a replay, without the reading's resolution.
    sigma = np.hypot(1.5e-3, views[0].motion.quantum / np.sqrt(12))
    for view, static in reversed([*zip(views, statics, strict=True)]):
        replay = _replay(view, static, turns)
        x, problem = _fitted(replay, mean, covariance, sigma)
        if view is not views[0]:
            fit = problem.fit
            every = np.linalg.inv(fit.precision)
            daily = np.diag([daily**2 for _, daily, _ in BASE_PARAMETERS.values()])
            daily[5, 5] += (CLOCK_STEPS * view.motion.step) ** 2
            own = [slice(k, k + PARAMETER_COUNT) for k in range(0, len(every), PARAMETER_COUNT)]
            covariance = np.stack([every[joint, joint] + daily for joint in own])
            mean, sigma = x, np.sqrt(fit.variance)
    return problem, replay, x


def _turns(statics: Sequence[Array], spread: Array) -> Array:
    """Return two combinations of the bodies' parameters for each joint, (joints, 10 joints, 2).

    They load the joint most, by one prior standard deviation of each.
    statics : regressors of gravity in each log; spread : see `Arm`
    """
    out = []
    for j in range(statics[0].shape[1]):
        every = np.concatenate([static[:, j] @ spread for static in statics])
        out.append(spread @ np.linalg.svd(np.linalg.qr(every - every.mean(axis=0))[1])[2][:2].T)
    return np.stack(out)


def _replay(view: LogView, static: Array, turns: Array) -> Replay:
    """Return the simulation of a log. static : regressor of gravity; turns : see `_turns`"""
    m = view.motion
    starts = np.flatnonzero(np.diff(m.run, prepend=m.run[0] - 1))
    length = int(np.diff(np.append(starts, len(m.run))).max())
    gravity = np.einsum("tjp,jpk->ktj", static, turns)
    coupled = (view.Y - static) @ view.arm.inertial
    for j in range(len(turns)):
        a = np.zeros_like(m.a)
        a[:, j] = m.a[:, j]
        coupled[:, j] -= ((view.arm.regressor(m.q, 0 * a, a) - static)[:, j]) @ view.arm.inertial
    return Replay(
        view, static @ view.arm.inertial + coupled, gravity - gravity.mean(axis=1, keepdims=True), starts, length
    )


def _prior(view: LogView) -> tuple[Array, Array]:
    """Return prior means and standard deviations of the base, shapes (joints, PARAMETER_COUNT) each."""
    arm, n = view.arm, view.arm.joints
    mean = np.zeros((n, PARAMETER_COUNT))
    mean[:, 0] = -np.log(view.gain)
    # Prior median of dry friction divided by the gain.
    mean[:, 2] = np.log(0.01)
    # Prior median of damping / gain [s]: motors add to the servo's declared kd.
    damping = 0.06 if arm.kd is None or not arm.kd.any() else 1.5 * arm.kd / view.gain
    mean[:, 3] = np.log(np.maximum(damping, 5e-3))
    # Prior median of inertia / rotor inertia of the robot's drives.
    mean[:, 4] = np.log(np.maximum(1.6 * arm.rotor / view.gain, 1e-4))
    mean[:, 5] = -CLOCK_STEPS * view.motion.step
    if arm.kd is not None and arm.kd.any():
        # D acts on the speed, or on the speed's error, where the command's speed moves it ahead.
        m, ahead = view.motion, arm.kd / view.gain
        slopes = [
            np.linalg.lstsq(np.column_stack([v, np.sign(v), 0 * v + 1]), e, rcond=None)[0][0]
            for v, e in zip(m.v.T, (m.command - m.position).T, strict=True)
        ]
        mean[:, 5] -= ahead * (np.median(slopes) < 0.5 * np.median(ahead))
    # Prior mean of friction divided by the load.
    mean[:, 6] = 0.08
    width = np.tile([sigma for sigma, *_ in BASE_PARAMETERS.values()], (n, 1))
    width[:, 5] = np.hypot(width[:, 5], CLOCK_STEPS * view.motion.step)
    if arm.kp is None:
        width[:, 0] = 0.5
    if arm.kd is None:
        width[:, 3:5] = 1.0
    if arm.delay is None:
        width[:, 5] = 0.03
    return mean, width


def _fitted(replay: Replay, mean: Array, covariance: Array, sigma: Array) -> tuple[Array, LogProblem]:
    """Return the parameters of highest density, (joints, PARAMETER_COUNT), and the problem linearised there."""
    # With a variance that contains the misfit of the start, priors would hold the parameters there.
    # At the start of the base's fit the noise is twice the typical one.
    small, starts = 4.0 * sigma**2, []
    # Frictions at the start of the base's fit / their prior median.
    for factor in (1.0, 3.0):
        start = mean.copy()
        start[:, 2] += np.log(factor)
        starts.append(_descended(replay, start, mean, covariance, sigma, small))
    best = [first_of_best(-own) for own in np.stack([cost for _, cost, _ in starts], axis=1)]
    x = np.stack([starts[k][0][j] for j, k in enumerate(best)])
    rows = tuple(starts[k][2].rows[j] for j, k in enumerate(best))
    variance = replace(starts[0][2], rows=rows, mean=(mean - x).ravel()).fit.variance
    x, _, problem = _descended(replay, x, mean, covariance, sigma, variance)
    return x, problem


def _descended(
    replay: Replay, x: Array, mean: Array, covariance: Array, sigma: Array, variance: Array
) -> tuple[Array, Array, LogProblem]:
    """Return parameters, cost of each joint and problem after steps from x with a given noise."""
    prior, problems = np.linalg.inv(covariance), list[LogProblem]()
    low, high = np.tile([[-np.inf], [np.inf]], PARAMETER_COUNT)
    low[5:7], high[5:7] = (-0.2, 0.0), (0.4, 2.0)  # delay and load friction

    def evaluate(x: Array) -> Evaluated:
        """Return cost and normal equations of all joints at x."""
        problem, pull = _linearised(replay, x, mean, covariance, sigma), (prior @ (mean - x)[..., None])[..., 0]
        grams = [[values / s2 for values in r.grams] for r, s2 in zip(problem.rows, variance, strict=True)]
        H, b, squares = (np.stack(values) for values in zip(*grams, strict=True))
        problems.append(problem)
        return squares + ((mean - x) * pull).sum(axis=1), lambda of: ((H + prior)[of], (b + pull)[of])

    # Largest number of Levenberg-Marquardt steps of the base's fit with one noise.
    for end in levenberg_marquardt(
        evaluate,
        x,
        1 + 12,
        move=lambda x, step: np.clip(x + step, low, high),
        first=0.1,
        factors=(6, 6),
    ):
        accepted, trial = problems[0], problems.pop()
        rows = zip(accepted.rows, trial.rows, end.gain > 0, strict=True)
        problems[:] = [replace(trial, rows=tuple(new if ok else old for old, new, ok in rows))]
        # Decrease of the cost below which the fit ends.
        if (np.abs(end.gain) < 0.1).all():
            break
    return end.point, end.cost, replace(problems[0], mean=(mean - end.point).ravel())


def _linearised(replay: Replay, x: Array, mean: Array, covariance: Array, sigma: Array) -> LogProblem:
    """Return the problem of the base linearised at parameters x, shape (joints, PARAMETER_COUNT)."""
    m, n = replay.view.motion, len(x)
    steps = np.array([step for *_, step in BASE_PARAMETERS.values()])
    variants = np.concatenate([x[:, None], x[:, None] + np.diag(steps)], axis=1)
    q = replay.angles(
        np.repeat(np.arange(n), PARAMETER_COUNT + 1),
        variants.reshape(-1, PARAMETER_COUNT),
        [Signals()] * (n * (PARAMETER_COUNT + 1)),
    )
    used = np.ones(len(m.q), dtype=bool)
    for start in replay.starts:
        # Time at the start of each run that is not used [s].
        used[start : start + int(0.3 / m.step)] = False
    fold = m.run if len(replay.starts) > 1 else np.floor(3 * np.arange(len(m.q)) / len(m.q))
    whole = np.zeros((n * PARAMETER_COUNT, n * PARAMETER_COUNT))
    rows = []
    for j in range(n):
        own = np.arange(PARAMETER_COUNT * j, PARAMETER_COUNT * j + PARAMETER_COUNT)
        whole[np.ix_(own, own)] = covariance[j]
        angles = q[:, (PARAMETER_COUNT + 1) * j : (PARAMETER_COUNT + 1) * (j + 1)]
        J = (angles[:, 1:] - angles[:, :1]) / steps
        residual = m.position[:, j] - angles[:, 0]
        rows.append(Rows("position", j, used, residual[used], J[used], own, sigma[j], fold[used], 1 / m.step))
    names = tuple(("position", str(j), name) for j in range(n) for name in BASE_PARAMETERS)
    return LogProblem(tuple(rows), (mean - x).ravel(), whole, names)


def simulated_columns(
    replay: Replay, x: Array, causes: Iterable[tuple[Candidate, list[Signals], list[Signals]]]
) -> Iterator[tuple[Candidate, list[Signals]]]:
    """Yield each variant of each cause with its parameters' columns.

    x : the base's fit, shape (joints, PARAMETER_COUNT)
    causes : with signals of each parameter while all joints slide one way, and the other
    """
    peaks, n, causes = replay.view.peak_torque, len(x), iter(causes)
    moves = np.ptp(replay.view.motion.position, axis=0) > MIN_SPAN_RAD
    base = replay.angles(np.arange(n), x, [Signals()] * n)
    while batch := [*islice(causes, 20)]:  # so few, as they are held in memory
        joints, signals, owners = [], [], []
        for candidate, plus, minus in batch:
            # Causes of many parameters are about linear in them: one size is enough.
            # Factors on a cause's typical size for its columns; of many parameters the last.
            for scale in (0.3, 1.0)[-1 if len(plus) > 1 else 0 :]:
                places = [(p, j) for p, s in enumerate(plus) for j in sorted({j for _, j in s if moves[j]})]
                owners.append((candidate, scale, places))
                for p, j in places:
                    own, position = Signals(), plus[p].get(("position", j))
                    if position is not None:
                        own["position", j] = scale * position
                    if ("torque", j) in plus[p]:
                        a, b = (scale * peaks[j] * s[p]["torque", j] for s in (plus, minus))
                        own |= {("torque", j): (a + b) / 2, ("limit", j): (a - b) / 2}
                    joints.append(j)
                    signals.append(own)
        q = iter(replay.angles(np.array(joints, dtype=int), x[joints], signals).T)
        for candidate, scale, places in owners:
            columns: dict[int, Signals] = {}
            for p, j in places:
                columns.setdefault(p, Signals())["position", j] = (next(q) - base[:, j]) / scale
            yield candidate, [*columns.values()]


def saturation_columns(replay: Replay, x: Array) -> list[tuple[int, Signals]]:
    """Return the column of saturation for each joint (0-based) that moves and each torque limit."""
    n, m = len(x), replay.view.motion
    assert m.command is not None
    most = np.quantile(np.abs(m.command - m.position), 0.999, axis=0)
    joints = np.repeat(np.arange(n), 1 + len(CAPACITY_SHARES))
    capacity = (most[:, None] * np.array([np.inf, *CAPACITY_SHARES])).ravel()
    q = replay.angles(joints, x[joints], [Signals()] * len(joints), capacity).reshape(len(m.q), n, -1)
    moves = np.flatnonzero(np.ptp(m.position, axis=0) > MIN_SPAN_RAD)
    return [(int(j), {("position", int(j)): q[:, j, k] - q[:, j, 0]}) for j in moves for k in range(1, q.shape[2])]

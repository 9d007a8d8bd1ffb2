"""The response of each joint to its command: a servo that yields, dry friction, damping, inertia, a delay.

J q'' + b q' + F sign(q') + g(c) + o = kp (c(t - delay) - q), and within F of balance a joint stands: droop under
gravity, hysteresis over the command's history, lag and delay, as a simulator's joint has them. Stepped by the implicit
midpoint rule, dry friction as in Moreau's (1988) time stepping. Fitted by Levenberg and Marquardt's steps with priors,
outliers at less weight, without the samples at a surface that the arm rests on; masses are those of the robot file.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.drive import Drive
from casadical.diagnosis.motion.floor import AT, Floor, floor_of
from casadical.diagnosis.motion.signals import RATE, Arm, arm_of, even, kernel_of, late, smoothed, torque_of
from casadical.measurements.logs.log import JointLog
from casadical.robot.dynamics import Dynamics
from casadical.robot.robot import Robot

# A fit goes over pieces of a run of this length, each from its first reading [s].
PIECE = 30.0
# Logarithms of a joint's friction and times [rad, s, s^2, s], and of its yield: one sigma; what times usually are.
YIELD, KNOWN_GAIN, TOLD_GAIN, DRY, TIMES = 0.5, 0.1, 0.02, 1.5, 1.5
# A joint that gravity loads by less than this share of the most has a gain near that of the others: of its logarithm.
LIGHT, ALIKE = 0.1, 0.25
LAG, INERTIA, DELAY = 0.05, 0.002, 0.02
# One sigma of a constant part of the error [rad].
OFFSET = 0.05
# Of the samples so many tell something new; residuals beyond so many sigma weigh less.
EFFECTIVE, OUTLIER = 0.05, 3.0
ROUNDS, STEPS, ENOUGH, DIFFERENCE = 4, 6, 1e-3, 1e-4
# Decimals of a step: where the cost has kinks (a delay that passes a sample, a joint that sticks), each step multiplies
# what rounding had changed, and processors would end at other parameters.
KEPT = 6
# A joint whose commands go through less than this tells nothing of its response [rad], which stays within this share.
STILL, USUAL = 0.02, 0.05
# A torque that a servo gives in proportion has so great a correlation to its error, later by one of these [s].
SERVED, LATES = 0.95, (0.0, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.06)
# From this speed on a joint slides [rad/s]; rows of a run whose torques are told.
SLIDES, FEWEST = 0.01, 20
# No residual is judged finer than this [rad].
LEAST = 5e-4
# Least share of a joint's inertia that is its rotor's.
LEAST_ROTOR = 0.05
# Of each joint: logarithm of its yield, offset, logarithms of friction, lag, inertia and delay.
LOCAL = 6
_LOGS = (0, 2, 3, 4, 5)


@dataclass(frozen=True, eq=False)
class Piece:
    """Uniform samples of a part of a run; command, position : shape (samples, joints); step [s]."""

    command: Array
    position: Array
    step: float


@dataclass(frozen=True, eq=False)
class Response:
    """What a joint does with its command, of all joints, each of shape (joints,), SI.

    gain : of the servo [N m/rad]; bias : a constant torque [N m]; friction [N m]; damping [N m s/rad]
    inertia : of the joint, rotor included [kg m^2]; delay [s]
    beside : of logged torques, what the bodies leave: dry and viscous friction, rotor, constant, shape (joints, 4)
    floor : surface that the tool came to rest on, or None
    fitted : sources of the logs; moved : which joints did in them: of others the response is a usual one
    """

    dynamics: Dynamics
    gain: Array
    bias: Array
    friction: Array
    damping: Array
    inertia: Array
    delay: Array
    fitted: tuple[str, ...]
    moved: Array
    beside: Array | None = None
    floor: Floor | None = None

    def predicted(self, log: JointLog) -> Array:
        """Positions of a log's runs by its commands alone, from the first reading of each, shape (rows, joints)."""
        out = []
        for run in log.runs():
            (piece,) = pieces_of(run, np.inf)
            load = self.dynamics.torque(piece.command, *[np.zeros_like(piece.command)] * 2)
            friction, lag, inertia = (each / self.gain for each in (self.friction, self.damping, self.inertia))
            balance = late(piece.command, self.delay / piece.step) - (load + self.bias) / self.gain
            q = simulated(
                _middles(balance), len(balance) - 1, piece.position[0], np.array(piece.step), friction, lag, inertia,
                self.floor, self.gain,
            )  # fmt: skip
            t = run.time[0] + piece.step * np.arange(len(q))
            out.append(np.column_stack([np.interp(run.time, t, column) for column in q.T]))
        return np.concatenate(out)

    def torques(self, run: JointLog, position: Array) -> tuple[Array, Array]:
        """Of the drives in a run, as the bodies need it along the command, and with what the fitted logs had beside.

        position : that of the replay, as of `predicted`; shapes (rows, joints) [N m]; some runs had torques
        """
        assert self.beside is not None
        assert run.command is not None
        bodies, _ = bodies_and_terms(self.dynamics, run, run.command)
        moved, terms = bodies_and_terms(self.dynamics, run, position)
        return bodies, moved + (terms * self.beside).sum(axis=2)

    def friction_of(self, run: JointLog) -> tuple[Array, Array]:
        """Speed [rad/s] and friction [N m] of a run, shapes (samples, joints), by the servo's law."""
        (piece,) = pieces_of(run, np.inf)
        q = smoothed(piece.position, np.hanning(9)[1:-1] / 4)
        v = np.gradient(q, piece.step, axis=0)
        load = self.dynamics.torque(q, *[np.zeros_like(q)] * 2)
        wanted = late(piece.command, self.delay / piece.step)
        inertia = self.inertia * np.gradient(v, piece.step, axis=0)
        return v, self.gain * (wanted - q) - load - self.bias - inertia

    def robot(self) -> Robot:
        """The robot with these drives."""
        return replace(self.dynamics.given, drive=self.drive())

    @cached_property
    def armature(self) -> Array:
        """Rotor inertia at the joint: what the links in the middle of their range leave of it, shape (joints,)."""
        d, n = self.dynamics, len(self.gain)
        middle, none = np.tile(np.mean(d.robot.limits, axis=0), (n, 1)), np.zeros((n, n))
        links = np.diag(d.torque(middle, none, np.eye(n), np.append(d.values[: 10 * n], np.zeros(n)), np.zeros(3)))
        return np.asarray(np.maximum(self.inertia - links, LEAST_ROTOR * self.inertia))

    def drive(self) -> Drive:
        """The table [drive] with what was found, and what was known beside."""
        numbers = {
            "kp": self.gain, "bias": self.bias, "friction": self.friction, "damping": self.damping,
            "rotor_inertia_at_joint": self.armature, "delay": self.delay,
        }  # fmt: skip
        rounded: dict[str, Any] = {name: [float(f"{v:.4g}") for v in each] for name, each in numbers.items()}
        if self.floor:
            rounded["floor"] = round(self.floor.height, 4)
        return (self.dynamics.given.drive or Drive()).model_copy(update=rounded)


def pieces_of(run: JointLog, length: float = PIECE) -> list[Piece]:
    """A run on a uniform time, in pieces of some length [s]; none of a run that is shorter than two seconds.

    Raises InputError: no commands in it.
    """
    if run.command is None:
        raise InputError(f"{run.source}: no commands, and so no replay; log command1_rad ...")
    seconds = float(run.time[-1] - run.time[0])
    if not run.step or (seconds < 2 and length < np.inf):
        return []
    step = run.step * max(1, int(1 / (run.step * RATE)))
    t = np.arange(run.time[0], run.time[-1] + step / 2, step)
    command, position = (even(values, run.time, t) for values in (run.command, run.position))
    count = max(1, round(seconds / length)) if length < np.inf else 1
    ends = np.linspace(0, len(t), count + 1).astype(int)
    return [Piece(command[a:b], position[a:b], step) for a, b in pairwise(ends.tolist())]


def _middles(values: Array) -> Array:
    return np.asarray((values[1:] + values[:-1]) / 2)


def simulated(
    balance: Iterable[Array], steps: int, start: Array, step: Array, friction: Array, lag: Array, inertia: Array,
    floor: Floor | None = None, gain: Array | None = None,
) -> Array:  # fmt: skip
    """Angles of joints that follow their commands, shape (1 + steps, ...), from the first ones, `start` [rad].

    balance : where each joint would come to rest, in the middle of each step, arrays (...) that may be changed [rad]
    friction [rad], lag [s], inertia [s^2] are over the gain; step : between samples [s]
    floor : surface that the tool stays above, of a run alone, shape (n, joints), with the gains [N m/rad]
    """
    keeps, gives = 2 * inertia / step, 1 / (2 * inertia / step + lag + step / 2)
    shape = np.broadcast_shapes(start.shape, gives.shape)
    out, q, v = np.empty((1 + steps, *shape)), np.broadcast_to(start, shape).astype(float), np.zeros(shape)
    pushed, held, least = 0.0, np.empty(shape), -friction

    def slid(push: Array) -> Array:
        np.minimum(push, friction, out=held)
        np.maximum(held, least, out=held)
        push -= held
        push *= gives
        return push

    def ends(q: Array, push: Array, torque: Array) -> Array:
        return np.asarray(q + step * slid(push + torque / gain))

    out[0] = q
    for k, push in enumerate(balance, 1):
        push -= q
        push += keeps * v
        if floor is not None and gain is not None:
            torque, pushed = floor.torque(partial(ends, q, push), step * gives / gain, pushed)
            push += torque / gain
        slid(push)
        v = push.copy() if pushed else (2 * push - v) * (push != 0)
        q = np.add(q, step * push, out=out[k])
    return out


@dataclass(frozen=True, eq=False)
class _Problem:
    """Pieces side by side, shape (steps, pieces, joints); weight : 0 behind a piece's end; load : of gravity [N m]

    step : between samples, shape (pieces, joints) [s]; middle, width : of the priors, shape (joints, LOCAL)
    """

    command: Array
    position: Array
    weight: Array
    load: Array
    step: Array
    middle: Array
    width: Array

    def angles(self, x: Array) -> Array:
        """Of variants of the parameters, x : shape (joints, LOCAL, variants): (steps, pieces, joints, variants)."""
        x = x.copy()
        x[:, _LOGS] = np.exp(x[:, _LOGS])
        yields, offset, friction, lag, inertia, delay = x.transpose(1, 0, 2)
        # Of the variants only the last is of another delay.
        first, last = (
            _middles(np.stack([late(c, d / h) for c, h in zip(self.command.swapaxes(0, 1), self.step, strict=True)], 1))
            for d in (delay[:, 0], delay[:, -1])
        )

        def balance() -> Iterator[Array]:  # of all steps at once it would be large
            for command, more, load in zip(first, last - first, _middles(self.load), strict=True):
                rest = command[..., None] - yields * load[..., None]
                rest -= offset
                rest[..., -1] += more
                yield rest

        return simulated(
            balance(), len(first), self.position[0][..., None], self.step[..., None], friction, lag, inertia
        )

    def left(self, x: Array) -> tuple[Array, Array]:
        """What parameters leave, (steps, pieces, joints), and how angles change with each, (..., LOCAL)."""
        variants = np.repeat(x[:, :, None], 1 + LOCAL, axis=2)
        variants[:, np.arange(LOCAL), 1 + np.arange(LOCAL)] += DIFFERENCE
        angles = self.angles(variants)
        return self.position - angles[..., 0], (angles[..., 1:] - angles[..., :1]) / DIFFERENCE


def fitted(robot: Robot, *parts: Sequence[JointLog]) -> list[Response]:
    """The response of each joint as it is in all runs of some logs, and of others: simulated side by side, which costs
    little more than one.

    Raises InputError: logs without commands, or without a run of two seconds.
    """
    arm = arm_of(robot)
    runs = [[run for log in logs for run in log.runs()] for logs in parts]
    pieces = [[piece for run in each for piece in pieces_of(run)] for each in runs]
    for logs, each in zip(parts, pieces, strict=True):
        if not each:
            raise InputError(f"{logs[0].source}: no run of two seconds or more; log 20 s or more of motion")
    problems = [_problem(arm.dynamics, p, _gains_by_torque(r, arm)) for p, r in zip(pieces, runs, strict=True)]
    responses = []
    for (x, floor), logs, p, r in zip(_above_floors(arm.dynamics, problems), parts, pieces, runs, strict=True):
        gain = np.exp(-x[:, 0])
        friction, lag, inertia, delay = np.exp(x[:, 2:]).T
        sources = tuple(log.source for log in logs)
        responses.append(Response(
            arm.dynamics, gain, gain * x[:, 1], gain * friction, gain * lag, gain * inertia, delay, sources, _moves(p),
            _beside(arm, r, floor), floor,
        ))  # fmt: skip
    return responses


def _above_floors(dynamics: Dynamics, problems: Sequence[_Problem]) -> list[tuple[Array, Floor | None]]:
    """Of each: parameters of all joints, and the surface that the tool came to rest on, or that the drives know of."""
    free, known = Floor(dynamics), (dynamics.given.drive or Drive()).floor
    heights = [free.above(p.position) for p in problems]

    def solved(there: Mapping[int, Array], starts: Mapping[int, Array]) -> dict[int, Array]:
        parts = [replace(problems[k], weight=problems[k].weight * rows[..., None]) for k, rows in there.items()]
        x = _solved(_together(parts), np.concatenate([starts[k] for k in there]))
        return dict(zip(there, np.split(x, len(parts)), strict=True))

    def surface(k: int) -> Floor | None:
        p, seen = problems[k], problems[k].weight[..., 0] > 0
        return floor_of(dynamics, p.position[seen], p.angles(x[k][:, :, None])[..., 0][seen])

    off = {}
    for k, (z, p) in enumerate(zip(heights, problems, strict=True)):
        low = z[p.weight[..., 0] > 0].min()
        off[k] = (z > low + AT) | (free.above(p.command) > low - AT)
    x = solved(off, {k: p.middle for k, p in enumerate(problems)})
    floors = {k: floor for k in x if (floor := surface(k))}
    if floors:
        x |= solved({k: heights[k] > floor.height + AT for k, floor in floors.items()}, x)
        floors = {k: surface(k) or floor for k, floor in floors.items()}
    usual = None if known is None else Floor(dynamics, known)
    return [(x[k], floors.get(k, usual)) for k in x]


def _together(problems: Sequence[_Problem]) -> _Problem:
    """Problems as one, with the joints of each, which do not know of each other; pieces beyond weigh nothing."""
    steps, pieces = (max(p.command.shape[k] for p in problems) for k in (0, 1))

    def wide(of: Callable[[_Problem], Array]) -> Array:
        parts = [np.pad(of(p), ((0, steps - len(of(p))), (0, pieces - of(p).shape[1]), (0, 0))) for p in problems]
        return np.concatenate(parts, axis=2)

    every = [np.pad(p.step, ((0, pieces - len(p.step)), (0, 0)), "edge") for p in problems]
    return _Problem(
        wide(lambda p: p.command), wide(lambda p: p.position), wide(lambda p: p.weight), wide(lambda p: p.load),
        np.concatenate(every, axis=1), np.concatenate([p.middle for p in problems]),
        np.concatenate([p.width for p in problems]),
    )  # fmt: skip


def bodies_and_terms(dynamics: Dynamics, run: JointLog, position: Array) -> tuple[Array, Array]:
    """Torque of the bodies along a motion with the times of a run, and what friction, rotor and offset follow.

    position : shape (rows, joints); returns shapes (rows, joints) [N m] and (rows, joints, 4)
    """
    q = smoothed(position, kernel_of(run.step))
    v = np.gradient(q, run.time, axis=0)
    a = np.gradient(v, run.time, axis=0)
    return dynamics.torque(q, v, a), np.stack([np.tanh(v / SLIDES), v, a, np.ones_like(v)], axis=2)


def _beside(arm: Arm, runs: Sequence[JointLog], floor: Floor | None) -> Array | None:
    """Least squares of what the bodies leave of torques off the floor; None where a run has none [N m]."""
    H, b = np.zeros((arm.joints, 4, 4)), np.zeros((arm.joints, 4))
    for run in runs:
        logged = torque_of(run, arm)
        if logged is None or (run.torque is None and arm.per_ampere is None) or len(run) < FEWEST:
            return None
        bodies, terms = bodies_and_terms(arm.dynamics, run, run.position)
        known = np.isfinite(logged - bodies)
        if floor is not None:
            known &= (floor.above(np.nan_to_num(run.position)) > AT)[:, None]
        left = np.where(known, logged - bodies, 0.0)
        H += np.einsum("tja,tjb->jab", terms * known[..., None], terms)
        b += np.einsum("tja,tj->ja", terms, left)
    H += (1e-9 * np.trace(H, axis1=1, axis2=2)[:, None, None] + 1e-30) * np.eye(4)  # zero of a joint without torque
    return np.asarray(np.linalg.solve(H, b[..., None])[..., 0])


def _moves(pieces: Sequence[Piece]) -> Array:
    """Which joints were sent somewhere, shape (joints,)."""
    return np.asarray(np.max([np.ptp(piece.command, axis=0) for piece in pieces], axis=0) > STILL)


def _gains_by_torque(runs: Sequence[JointLog], arm: Arm) -> Array:
    """Gains where logged torques are proportional to the error of position, else NaN, shape (joints,) [N m/rad]."""
    runs = [r for r in runs if r.step]
    torques = [None if r.torque is None and arm.per_ampere is None else torque_of(r, arm) for r in runs]
    best, gains = np.full(arm.joints, SERVED), np.full(arm.joints, np.nan)
    for delay in LATES if all(t is not None for t in torques) else ():
        errors = [late(np.asarray(r.command), delay / r.step) - r.position for r in runs]
        e, torque = (np.concatenate([np.asarray(v) for v in each]) for each in (errors, torques))
        e, torque = (v - np.nansum(v, axis=0) / np.maximum(np.isfinite(v).sum(axis=0), 1) for v in (e, torque))
        both, ee, tt = (np.nansum(v, axis=0) + 1e-30 for v in (e * torque, e * e, torque * torque))
        better = both / np.sqrt(ee * tt) > best
        best, gains = np.where(better, both / np.sqrt(ee * tt), best), np.where(better, both / ee, gains)
    return gains


def _problem(dynamics: Dynamics, pieces: Sequence[Piece], told: Array) -> _Problem:
    n, longest = dynamics.robot.n, max(len(piece.command) for piece in pieces)
    command, position, weight = (np.zeros((longest, len(pieces), n)) for _ in range(3))
    for s, piece in enumerate(pieces):
        size = len(piece.command)
        for of, values in ((command, piece.command), (position, piece.position)):
            of[:, s] = np.pad(values, ((0, longest - size), (0, 0)), "edge")
        weight[:size, s] = 1.0
    flat = command.reshape(-1, n)
    load = dynamics.torque(flat, *[np.zeros_like(flat)] * 2)
    error = np.sqrt((weight * (position - command) ** 2).sum(axis=(0, 1)) / weight.sum(axis=(0, 1))) + 1e-5
    heavy = np.sqrt((load**2).mean(axis=0)) + 1e-9
    drive = dynamics.given.drive or Drive()
    gain, delay = (drive.of_joints(name, n) for name in ("kp", "delay"))
    middle = np.zeros((n, LOCAL))
    middle[:, 0] = np.log(np.median((error / heavy)[heavy > LIGHT * heavy.max()])) if gain is None else -np.log(gain)
    if gain is None:
        middle[:, 0] = np.where(np.isfinite(told), -np.log(told), middle[:, 0])
    middle[:, 2:] = np.log(np.column_stack([error / 3, *(np.full(n, v) for v in (LAG, INERTIA, DELAY))]))
    if delay is not None:
        middle[:, 5] = np.log(np.maximum(delay, 1e-4))
    # What an earlier log told is where this one begins, and where joints stay that it did not move.
    yields = np.exp(middle[:, 0])
    for k, name in ((2, "friction"), (3, "damping"), (1, "bias")):
        if (known := drive.of_joints(name, n)) is not None:
            middle[:, k] = known * yields if k == 1 else np.log(np.maximum(known * yields, 1e-6))
    light = heavy < LIGHT * heavy.max()
    width = np.tile([YIELD if gain is None else KNOWN_GAIN, OFFSET, DRY, TIMES, TIMES, TIMES], (n, 1))
    if gain is None:
        width[light, 0] = ALIKE
        width[np.isfinite(told), 0] = TOLD_GAIN
    width[np.ix_(~_moves(pieces), np.array(_LOGS))] = USUAL
    steps = np.repeat([[piece.step] for piece in pieces], n, axis=1)
    return _Problem(command, position, weight, load.reshape(command.shape), steps, middle, width)


def _solved(p: _Problem, start: Array) -> Array:
    """Parameters at the least cost, shape (joints, LOCAL); joints do not know of each other."""
    x, damping = start.round(KEPT), np.full(len(start), 1e-3)
    left, slope = p.left(x)
    for _ in range(ROUNDS):
        sigma = (
            1.4826 * np.array([np.median(np.abs(e[w > 0])) for e, w in zip(left.T, p.weight.T, strict=True)]) + LEAST
        )
        before = _cost(p, left, sigma, x)
        for _ in range(STEPS):
            H, b = _normal(p, sigma, x, left, slope)
            step = np.linalg.solve(H + damping[:, None, None] * H * np.eye(LOCAL), b[..., None])[..., 0].round(KEPT)
            further, slopes = p.left(x + step)
            now = _cost(p, further, sigma, x + step)
            better = now < before
            x[better] += step[better]
            left[:, :, better], slope[:, :, better] = further[:, :, better], slopes[:, :, better]
            damping = np.clip(np.where(better, damping / 5, damping * 8), 1e-9, 1e9)
            done = (np.abs(before - now) < ENOUGH * before).all()
            before = np.where(better, now, before)
            if done:
                break
    return x


def _cost(p: _Problem, left: Array, sigma: Array, x: Array) -> Array:
    """Of each joint, shape (joints,)."""
    rows = p.weight * 2 * OUTLIER**2 * (np.sqrt(1 + (left / (OUTLIER * sigma)) ** 2) - 1)
    return np.asarray(EFFECTIVE * rows.sum(axis=(0, 1)) + (((x - p.middle) / p.width) ** 2).sum(axis=1))


def _normal(p: _Problem, sigma: Array, x: Array, left: Array, slope: Array) -> tuple[Array, Array]:
    """Normal equations of each joint, shapes (joints, LOCAL, LOCAL) and (joints, LOCAL); outliers at less weight."""
    n = left.shape[2]
    weight = EFFECTIVE * p.weight / (sigma**2 * np.sqrt(1 + (left / (OUTLIER * sigma)) ** 2))
    A = slope.reshape(-1, n, LOCAL).transpose(1, 2, 0)
    weighted = A * weight.reshape(-1, n).T[:, None]
    b = (weighted @ left.reshape(-1, n).T[..., None])[..., 0]
    return weighted @ A.transpose(0, 2, 1) + np.eye(LOCAL) / p.width[:, None, :] ** 2, b - (x - p.middle) / p.width**2

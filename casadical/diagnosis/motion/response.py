"""The response of each joint to its command: a servo that yields, dry friction, damping, inertia, a delay.

J q'' + b q' + F sign(q') + g(c) + o = kp (c(t - delay) - q), and within F of balance a joint stands: droop under
gravity, hysteresis over the command's history, lag and delay, as a simulator's joint has them. Stepped by the implicit
midpoint rule, dry friction as in Moreau's (1988) time stepping. Fitted by Levenberg and Marquardt's steps with priors,
outliers (contacts) at less weight; masses are those of the robot file.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.drive import Drive
from casadical.diagnosis.motion.arm import Arm, arm_of
from casadical.diagnosis.motion.signals import RATE, kernel_of, torque_of
from casadical.measurements.logs.log import JointLog
from casadical.robot.dynamics import Dynamics
from casadical.robot.robot import Robot

# A fit goes over pieces of a run of this length, each from its first reading [s].
PIECE = 30.0
# Logarithms of a joint's friction and times [rad, s, s^2, s], and of its yield: one sigma; what times usually are.
YIELD, KNOWN_GAIN, DRY, TIMES = 1.0, 0.1, 1.5, 1.5
LAG, INERTIA, DELAY = 0.05, 0.002, 0.02
# One sigma of a constant part of the error [rad].
OFFSET = 0.05
# Of the samples so many tell something new; residuals beyond so many sigma weigh less.
EFFECTIVE, OUTLIER = 0.05, 3.0
ROUNDS, STEPS, ENOUGH, DIFFERENCE = 4, 6, 1e-3, 1e-4
# A joint whose commands go through less than this tells nothing of its response [rad], which stays within this share.
STILL, USUAL = 0.02, 0.05
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

    def predicted(self, log: JointLog) -> Array:
        """Positions of a log's runs by its commands alone, from the first reading of each, shape (rows, joints)."""
        out = []
        for run in log.runs():
            (piece,) = pieces_of(run, np.inf)
            load = self.dynamics.torque(piece.command, *[np.zeros_like(piece.command)] * 2)
            known = (self.friction, self.damping, self.inertia)
            q = simulated(
                late(piece.command, self.delay / piece.step), (load + self.bias) / self.gain, piece.position[0],
                np.array(piece.step), *(each / self.gain for each in known),
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
        q, kernel = piece.position, np.hanning(9)[1:-1] / 4
        padded = np.pad(q, ((3, 3), (0, 0)), "edge")
        q = np.column_stack([np.convolve(column, kernel, "valid") for column in padded.T])
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
        found = {
            "kp": self.gain, "bias": self.bias, "friction": self.friction, "damping": self.damping,
            "rotor_inertia_at_joint": self.armature, "delay": self.delay,
        }  # fmt: skip
        rounded = {name: [float(f"{v:.4g}") for v in each] for name, each in found.items()}
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
    command, position = (np.column_stack([_even(t, run.time, c) for c in v.T]) for v in (run.command, run.position))
    count = max(1, round(seconds / length)) if length < np.inf else 1
    ends = np.linspace(0, len(t), count + 1).astype(int)
    return [Piece(command[a:b], position[a:b], step) for a, b in pairwise(ends.tolist())]


def _even(t: Array, time: Array, column: Array) -> Array:
    known = np.isfinite(column)
    return np.interp(t, time[known], column[known]) if known.any() else np.zeros(len(t))


def late(values: Array, samples: Array) -> Array:
    """Columns that come so many samples later, shape (n, columns); samples : shape (columns,)."""
    at = np.arange(len(values))
    return np.column_stack([np.interp(at - d, at, v) for v, d in zip(values.T, np.atleast_1d(samples), strict=True)])


def simulated(
    command: Array, droop: Array, start: Array, step: Array, friction: Array, lag: Array, inertia: Array
) -> Array:
    """Angles of joints that follow their commands, shape (n, ...) as command and droop [rad].

    friction [rad], lag [s], inertia [s^2] are over the gain; start : first angles; step : between samples [s]
    """
    out, v = np.empty(np.broadcast_shapes(command.shape, droop.shape)), np.zeros(droop.shape[1:])
    force = (command[1:] + command[:-1] - droop[1:] - droop[:-1]) / 2
    keeps, gives = 2 * inertia / step, 1 / (2 * inertia / step + lag + step / 2)
    q = np.broadcast_to(start, out.shape[1:]).astype(float)
    out[0] = q
    for k, now in enumerate(force, 1):
        push = now - q
        push += keeps * v
        push -= np.clip(push, -friction, friction)
        push *= gives
        v = np.where(push == 0, 0.0, 2 * push - v)
        q = q + step * push
        out[k] = q
    return out


@dataclass(frozen=True, eq=False)
class _Problem:
    """Pieces side by side, shape (steps, pieces, joints); weight : 0 behind a piece's end; load : of gravity [N m]

    middle, width : of the priors, shape (joints, LOCAL)
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
        command = np.empty((*self.command.shape, x.shape[2]))
        for s, h in enumerate(self.step):
            command[:, s] = late(self.command[:, s], delay[:, 0] / h)[..., None]
            if x.shape[2] > 1:  # of the variants only the last is of another delay
                command[:, s, :, -1] = late(self.command[:, s], delay[:, -1] / h)
        droop = yields * self.load[..., None] + offset
        return simulated(command, droop, self.position[0][..., None], self.step[:, None, None], friction, lag, inertia)


def fitted(robot: Robot, logs: Sequence[JointLog]) -> Response:
    """The response of each joint as it is in all runs of some logs.

    Raises InputError: logs without commands, or without a run of two seconds.
    """
    dynamics = Dynamics(robot)
    pieces = [piece for log in logs for run in log.runs() for piece in pieces_of(run)]
    if not pieces:
        raise InputError(f"{logs[0].source}: no run of two seconds or more; log 20 s or more of motion")
    x = _solved(_problem(dynamics, pieces))
    gain = np.exp(-x[:, 0])
    friction, lag, inertia, delay = np.exp(x[:, 2:]).T
    sources = tuple(log.source for log in logs)
    return Response(
        dynamics, gain, gain * x[:, 1], gain * friction, gain * lag, gain * inertia, delay, sources, _moves(pieces),
        _beside(dynamics, arm_of(robot), [run for log in logs for run in log.runs()]),
    )  # fmt: skip


def bodies_and_terms(dynamics: Dynamics, run: JointLog, position: Array) -> tuple[Array, Array]:
    """Torque of the bodies along a motion with the times of a run, and what friction, rotor and offset follow.

    position : shape (rows, joints); returns shapes (rows, joints) [N m] and (rows, joints, 4)
    """
    kernel = kernel_of(run.step)
    padded = np.pad(position, ((len(kernel) // 2,) * 2, (0, 0)), "edge")
    q = np.column_stack([np.convolve(column, kernel, "valid") for column in padded.T])
    v = np.gradient(q, run.time, axis=0)
    a = np.gradient(v, run.time, axis=0)
    return dynamics.torque(q, v, a), np.stack([np.tanh(v / SLIDES), v, a, np.ones_like(v)], axis=2)


def _beside(dynamics: Dynamics, arm: Arm, runs: Sequence[JointLog]) -> Array | None:
    """Least squares of what the bodies leave of torques; None where a run has none [N m]."""
    H, b = np.zeros((dynamics.robot.n, 4, 4)), np.zeros((dynamics.robot.n, 4))
    for run in runs:
        logged = torque_of(run, arm)
        if logged is None or (run.torque is None and arm.per_ampere is None) or len(run) < FEWEST:
            return None
        bodies, terms = bodies_and_terms(dynamics, run, run.position)
        known = np.isfinite(logged - bodies)
        left = np.where(known, logged - bodies, 0.0)
        H += np.einsum("tja,tjb->jab", terms * known[..., None], terms)
        b += np.einsum("tja,tj->ja", terms, left)
    H += 1e-9 * np.trace(H, axis1=1, axis2=2)[:, None, None] * np.eye(4)
    return np.asarray(np.linalg.solve(H, b[..., None])[..., 0])


def _moves(pieces: Sequence[Piece]) -> Array:
    """Which joints were sent somewhere, shape (joints,)."""
    return np.asarray(np.max([np.ptp(piece.command, axis=0) for piece in pieces], axis=0) > STILL)


def _problem(dynamics: Dynamics, pieces: Sequence[Piece]) -> _Problem:
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
    middle[:, 0] = np.log(np.median((error / heavy)[heavy > 0.1 * heavy.max()])) if gain is None else -np.log(gain)
    middle[:, 2:] = np.log(np.column_stack([error / 3, *(np.full(n, v) for v in (LAG, INERTIA, DELAY))]))
    if delay is not None:
        middle[:, 5] = np.log(np.maximum(delay, 1e-4))
    # What an earlier log told is where this one begins, and where joints stay that it did not move.
    yields = np.exp(middle[:, 0])
    for k, name in ((2, "friction"), (3, "damping"), (1, "bias")):
        if (known := drive.of_joints(name, n)) is not None:
            middle[:, k] = known * yields if k == 1 else np.log(np.maximum(known * yields, 1e-6))
    width = np.tile([YIELD if gain is None else KNOWN_GAIN, OFFSET, DRY, TIMES, TIMES, TIMES], (n, 1))
    width[np.ix_(~_moves(pieces), np.array(_LOGS))] = USUAL
    steps = np.array([piece.step for piece in pieces])
    return _Problem(command, position, weight, load.reshape(command.shape), steps, middle, width)


def _solved(p: _Problem) -> Array:
    """Parameters at the least cost, shape (joints, LOCAL); joints do not know of each other."""
    x = p.middle.copy()
    damping = np.full(len(x), 1e-3)
    for _ in range(ROUNDS):
        left = p.position - p.angles(x[:, :, None])[..., 0]
        sigma = (
            1.4826 * np.array([np.median(np.abs(e[w > 0])) for e, w in zip(left.T, p.weight.T, strict=True)]) + LEAST
        )
        before = _cost(p, left, sigma, x)
        for _ in range(STEPS):
            H, b = _normal(p, sigma, x)
            step = np.linalg.solve(H + damping[:, None, None] * H * np.eye(LOCAL), b[..., None])[..., 0]
            now = _cost(p, p.position - p.angles((x + step)[:, :, None])[..., 0], sigma, x + step)
            better = now < before
            x = np.where(better[:, None], x + step, x)
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


def _normal(p: _Problem, sigma: Array, x: Array) -> tuple[Array, Array]:
    """Normal equations of each joint, shapes (joints, LOCAL, LOCAL) and (joints, LOCAL); outliers at less weight."""
    variants = np.repeat(x[:, :, None], 1 + LOCAL, axis=2)
    variants[:, np.arange(LOCAL), 1 + np.arange(LOCAL)] += DIFFERENCE
    angles = p.angles(variants)
    left = p.position - angles[..., 0]
    slope = (angles[..., 1:] - angles[..., :1]) / DIFFERENCE
    weight = EFFECTIVE * p.weight / (sigma**2 * np.sqrt(1 + (left / (OUTLIER * sigma)) ** 2))
    H = np.einsum("tsja,tsj,tsjb->jab", slope, weight, slope, optimize=True)
    b = np.einsum("tsja,tsj,tsj->ja", slope, weight, left, optimize=True)
    return H + np.eye(LOCAL) / p.width[:, None, :] ** 2, b - (x - p.middle) / p.width**2

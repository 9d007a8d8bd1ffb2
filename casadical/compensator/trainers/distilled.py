"""A network distilled from a Gaussian process, which is fitted to the measured poses and predicts many others.

Fifty poses do not tell a network with one ridge for all weights which joints matter; a process with a length for each
joint they do (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, ch. 5): squared exponential
kernel, noise, zero mean, by the largest likelihood, climbed by sign steps (Rprop, Riedmiller and Braun 1993). Its mean
at poses drawn in the box of the measured ones is then what Levenberg-Marquardt fits.
"""

from dataclasses import dataclass, field
from typing import ClassVar, Self

import numpy as np

from casadical.compensator.network import Task
from casadical.compensator.trainers.base import Trainer
from casadical.compensator.trainers.levenberg_marquardt import LevenbergMarquardt, LmRun
from casadical.core.basics import Array, InputError

_LENGTHS = (0.1, 100.0)
_MANY = 300  # poses that the lengths are found from; the process itself takes all


@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """A process with its data: inputs (n, d), solved (n, outputs); lengths (d,), size and noise of the outputs."""

    inputs: Array
    solved: Array
    lengths: Array
    size: float
    noise: float

    @classmethod
    def fit(cls, inputs: Array, targets: Array, steps: int = 120) -> Self:
        """Fit to inputs (n, d) and targets (n, outputs); the lengths are found from the first 300."""
        few, wanted = inputs[:_MANY], targets[:_MANY]
        rms = np.log(np.sqrt(np.mean(wanted**2)) + 1e-12)
        width = inputs.shape[1]
        low = np.r_[np.full(width, np.log(_LENGTHS[0])), rms - 4, rms - 5]
        high = np.r_[np.full(width, np.log(_LENGTHS[1])), rms + 2, rms + 1]
        starts = [np.r_[np.full(width, np.log(s)), rms, rms - 1] for s in (1.0, 3.0)]  # of half the box
        logs = min((_climb(few, wanted, start, low, high, steps) for start in starts), key=lambda end: end[1])[0]
        lengths, size, noise = np.exp(logs[:-2]), float(np.exp(logs[-2])), float(np.exp(logs[-1]))
        K = size**2 * _correlation(inputs, inputs, lengths) + noise**2 * np.eye(len(inputs))
        solved = np.asarray(np.linalg.solve(K, targets), dtype=np.float64)
        return cls(inputs, solved, lengths, size, noise)

    def mean(self, at: Array) -> Array:
        """Return the mean at inputs (m, d), shape (m, outputs)."""
        return np.asarray(self.size**2 * _correlation(at, self.inputs, self.lengths) @ self.solved)


def _correlation(a: Array, b: Array, lengths: Array) -> Array:
    a, b = a / lengths, b / lengths
    square = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
    return np.asarray(np.exp(-0.5 * np.maximum(square, 0)))


def cost_and_slope(logs: Array, x: Array, y: Array) -> tuple[float, Array]:
    """Negative log likelihood, constants left out, and its gradient; logs : of the lengths, size and noise."""
    lengths, size, noise = np.exp(logs[:-2]), np.exp(logs[-2]), np.exp(logs[-1])
    smooth = size**2 * _correlation(x, x, lengths)
    K = smooth + noise**2 * np.eye(len(x))
    inverse = np.linalg.inv(K)
    solved = inverse @ y
    cost = 0.5 * float(np.sum(y * solved)) + 0.5 * y.shape[1] * float(np.linalg.slogdet(K)[1])
    weight = 0.5 * (y.shape[1] * inverse - solved @ solved.T)
    each = weight * smooth
    rows = each.sum(axis=1)
    # sum over pairs of each * (x_i - x_j)^2, input by input
    spread = 2 * (rows @ x**2 - np.einsum("id,id->d", x, each @ x))
    return cost, np.r_[spread / lengths**2, 2 * rows.sum(), 2 * noise**2 * np.trace(weight)]


def _climb(x: Array, y: Array, start: Array, low: Array, high: Array, steps: int) -> tuple[Array, float]:
    """Go down the cost by steps of the slope's sign, longer while it holds, shorter when it turns; the best seen."""
    at, step, before = start.copy(), np.full(len(start), 0.2), np.zeros(len(start))
    best, least = start, np.inf
    for _ in range(steps):
        cost, slope = cost_and_slope(at, x, y)
        if cost < least:
            best, least = at.copy(), cost
        same = np.sign(slope) * before
        step = np.clip(step * np.where(same > 0, 1.2, np.where(same < 0, 0.5, 1.0)), 1e-4, 0.5)
        before = np.where(same < 0, 0.0, np.sign(slope))
        at = np.clip(at - step * before, low, high)
    return best, least


@dataclass(frozen=True)
class Taught(Trainer):
    """Settings: poses that the process answers, and the training on its answers.

    Not for periodic inputs, whose box is no box of joint angles.
    """

    name: ClassVar[str] = "taught"
    method: ClassVar[str] = "GP-NN-SKCM"

    lessons: int = 600
    lm: LevenbergMarquardt = field(default_factory=lambda: LevenbergMarquardt(restarts=4, ridges=(1e-5,)))

    def __post_init__(self) -> None:
        if self.lessons < 10:
            raise InputError(f"lessons must be at least 10 poses; got {self.lessons}")

    def begin(self, task: Task, seed: int) -> LmRun:
        lessons, note = self._lessons(task, seed)
        return self.lm.begin(lessons, seed).noted(note)

    def _lessons(self, task: Task, seed: int) -> tuple[Task, str]:
        """The task to learn from, and what the process found."""
        if task.layout.periodic:
            raise InputError("the trainer 'taught' takes no periodic inputs; take 'lm', or a layout without them")
        inputs, ones = task.inputs[:-1].T, task.inputs[-1]
        process = GaussianProcess.fit(inputs, task.targets.T)
        low, high = inputs.min(axis=0), inputs.max(axis=0)
        drawn = np.random.default_rng((seed, 2)).uniform(low, high, (self.lessons, len(low)))
        rows = np.vstack([drawn, inputs])
        taught = np.ascontiguousarray(process.mean(rows).T)
        lengths = ", ".join(f"{v:.2g}" for v in process.lengths)
        note = f"taught by a Gaussian process, lengths {lengths} half ranges"
        inputs = np.vstack([rows.T, np.full(len(rows), ones[0])])
        return Task(task.layout, inputs, taught, task.scale_mm, task.loss), note

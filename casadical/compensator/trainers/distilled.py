"""Network distilled from a Gaussian process that is fitted to the measured poses.

From fifty poses a network with one ridge for all weights cannot learn which joints matter; a
Gaussian process with a length scale for each joint can (Rasmussen and Williams, Gaussian Processes
for Machine Learning, 2006, ch. 5). It has a squared exponential kernel, noise and zero mean; its
hyperparameters maximise the likelihood, by sign steps (Rprop, Riedmiller and Braun 1993).
Levenberg-Marquardt then fits the network to the process's mean at the measured poses and at many
random ones in their box.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import ClassVar, Self

import numpy as np

from casadical.compensator.network import Task
from casadical.compensator.trainers.base import State, Trainer
from casadical.compensator.trainers.levenberg_marquardt import LevenbergMarquardt
from casadical.core.basics import Array, InputError


@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """A Gaussian process with its data.

    inputs : inputs of the n data, scaled joint angles, shape (n, d)
    solved : inverse covariance of the data times the targets, shape (n, outputs)
    lengths : length scale of each input, shape (d,), in its unit
    size, noise : standard deviations of the process and of the noise [unit of the targets]
    """

    inputs: Array
    solved: Array
    lengths: Array
    size: float
    noise: float

    @classmethod
    def fit(cls, inputs: Array, targets: Array, steps: int = 120) -> Self:
        """Return the process fitted to inputs, shape (n, d), and targets, shape (n, outputs).

        The hyperparameters are estimated from the first 300 poses.

        steps : number of steps of their maximum-likelihood search from each of two starts
        """
        few, wanted = inputs[:300], targets[:300]
        rms = np.log(np.sqrt(np.mean(wanted**2)) + 1e-12)
        width = inputs.shape[1]
        # Length scales are between 0.1 and 100 half ranges of the joints.
        low = np.r_[np.full(width, np.log(0.1)), rms - 4, rms - 5]
        high = np.r_[np.full(width, np.log(100.0)), rms + 2, rms + 1]
        starts = [np.r_[np.full(width, np.log(s)), rms, rms - 1] for s in (1.0, 3.0)]  # of half the box
        logs = min(
            (_minimise_by_sign_steps(few, wanted, start, low, high, steps) for start in starts), key=lambda end: end[1]
        )[0]
        lengths, size, noise = np.exp(logs[:-2]), float(np.exp(logs[-2])), float(np.exp(logs[-1]))
        K = size**2 * _correlation(inputs, inputs, lengths) + noise**2 * np.eye(len(inputs))
        solved = np.asarray(np.linalg.solve(K, targets), dtype=np.float64)
        return cls(inputs, solved, lengths, size, noise)

    def mean(self, at: Array) -> Array:
        """Return the posterior mean at inputs (m, d), shape (m, outputs) [unit of the targets]."""
        return np.asarray(self.size**2 * _correlation(at, self.inputs, self.lengths) @ self.solved)


def _correlation(a: Array, b: Array, lengths: Array) -> Array:
    """Return the squared exponential correlation of two sets of inputs, shape (len(a), len(b)).

    a, b : shape (., d); lengths : length scale of each input, shape (d,)
    """
    a, b = a / lengths, b / lengths
    square = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
    return np.asarray(np.exp(-0.5 * np.maximum(square, 0)))


def cost_and_slope(logs: Array, x: Array, y: Array) -> tuple[float, Array]:
    """Return the negative log likelihood without constants, and its gradient by `logs`, (d + 2,).

    logs : logarithms of the d length scales, of size and of noise, see `GaussianProcess`
    x : inputs, shape (n, d); y : targets, shape (n, outputs)
    """
    lengths, size, noise = np.exp(logs[:-2]), np.exp(logs[-2]), np.exp(logs[-1])
    smooth = size**2 * _correlation(x, x, lengths)
    K = smooth + noise**2 * np.eye(len(x))
    inverse = np.linalg.inv(K)
    solved = inverse @ y
    cost = 0.5 * float(np.sum(y * solved)) + 0.5 * y.shape[1] * float(np.linalg.slogdet(K)[1])
    weight = 0.5 * (y.shape[1] * inverse - solved @ solved.T)
    each = weight * smooth
    rows = each.sum(axis=1)
    # Sum over pairs of each * (x_i - x_j)^2, for each input.
    spread = 2 * (rows @ x**2 - np.einsum("id,id->d", x, each @ x))
    return cost, np.r_[spread / lengths**2, 2 * rows.sum(), 2 * noise**2 * np.trace(weight)]


def _minimise_by_sign_steps(
    x: Array, y: Array, start: Array, low: Array, high: Array, steps: int
) -> tuple[Array, float]:
    """Return the hyperparameters of least cost on a path of sign steps (Rprop), and that cost.

    The step of a coordinate grows while the sign of its gradient stays, and shrinks when it
    changes. The cost is that of `cost_and_slope`.

    start, low, high : start and bounds of the logarithms, (d + 2,)
    """
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
    """Settings of a training on the predictions of a Gaussian process.

    It is not for periodic inputs, whose box is no box of joint angles.

    lessons : number of random poses at which the process predicts, besides the measured ones
    lm : trainer of the network on these predictions
    """

    name: ClassVar[str] = "taught"
    method: ClassVar[str] = "GP-NN-SKCM"

    lessons: int = 600
    lm: LevenbergMarquardt = field(default_factory=lambda: LevenbergMarquardt(restarts=4, ridges=(1e-5,)))

    def __post_init__(self) -> None:
        if self.lessons < 10:
            raise InputError(f"lessons must be at least 10 poses; got {self.lessons}")

    def states(self, task: Task, seed: int) -> Iterator[State]:
        """Yield the states of a training on predictions of the process fitted to the task.

        Raises InputError: periodic inputs.
        """
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
        yield from self.lm.states(Task(task.layout, inputs, taught, task.scale_mm, task.loss), seed, note=note)

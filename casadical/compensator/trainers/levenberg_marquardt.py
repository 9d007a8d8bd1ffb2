"""Training along the gradient: back-propagation, and Levenberg-Marquardt with restarts.

Back-propagation is the paper's baseline, one gradient descent from one random start.

The ridge of Levenberg-Marquardt is chosen by cross-validation: every fold is trained from a few
random starts at the weakest ridge, and from there at stronger and stronger ones; the ridge with the
smallest mean square error on the held-out poses is taken; after two worse ones, no stronger one is
tried. (From strong to weak, a ridge that is too strong would end the search: it sets all weights to
zero, a stationary point of every weaker ridge.) Then the network is trained on all poses with
restarts at that ridge; the one with the lowest cost is taken. The cost is the mean squared norm of
errors plus the ridge's term, without the paper's maximum term.

Many small networks are trained at once. Problem p minimises
sum_n m[p, n] |outputs - targets|^2 + ridge[p] * sum of squared weights, without the biases of the
output layer. The sample weights m of a problem sum to one, so that a large ridge leaves only the
mean residual.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import ClassVar, Self

import numpy as np

from casadical.compensator.network import Task, forward, gradient, outputs_and_jacobian, random_weights, training_masks
from casadical.compensator.trainers.base import Trainer
from casadical.core.basics import Array, InputError
from casadical.core.levenberg_marquardt import Descent, Evaluated, levenberg_marquardt


@dataclass(frozen=True)
class Backprop(Trainer):
    """Full-batch gradient descent with momentum and an adaptive learning rate.

    steps : number of gradient steps
    rate : initial learning rate, of the loss in squared units of the output layer
    momentum : factor of the previous step in the next one
    faster : factor on the rate after a step that lowers the loss
    slower : factor on the rate after a step that raises the loss by more than `tolerance` or makes
        it infinite; that step is undone
    tolerance : largest relative increase of the loss that is accepted
    """

    name: ClassVar[str] = "backprop"
    method: ClassVar[str] = "NN-SKCM"
    output_scale_mm: ClassVar[float | None] = 1.0  # the paper's

    steps: int = 3000
    rate: float = 0.01
    momentum: float = 0.9
    faster: float = 1.05
    slower: float = 0.7
    tolerance: float = 0.04

    def begin(self, task: Task, seed: int) -> "BackpropRun":
        """Return a gradient descent from random weights, with no step done."""
        weights = random_weights(task.layout, np.random.default_rng(seed), 1)
        return BackpropRun(self, task, weights)


class BackpropRun:
    """One descent; a step is one gradient step."""

    def __init__(self, trainer: Backprop, task: Task, weights: Array):
        self.trainer, self.task = trainer, task
        self.weights, self.velocity = weights, np.zeros_like(weights)
        self.rate, self.steps = trainer.rate, 0
        self.loss, self.slope = self._value_and_slope(weights)
        self.best_weights, self.best_loss = weights, self.loss

    def _value_and_slope(self, weights: Array) -> tuple[float, Array]:
        """Return the task's `Loss` in squared units of the outputs, and its gradient, (1, count).

        weights : shape (1, count)
        """
        task = self.task
        errors = np.asarray(forward(task.layout, weights, task.inputs) - task.targets, dtype=np.float64)
        slope = gradient(task.layout, weights, task.inputs, task.loss.slope(errors))
        return float(task.loss.value(errors)[0]), slope

    def step(self) -> None:
        """Do one gradient step with momentum, or none if it would raise the loss beyond a tolerance.

        The learning rate grows after a step that lowers the loss, and shrinks after a refused one.
        """
        t = self.trainer
        velocity = t.momentum * self.velocity - (1 - t.momentum) * self.rate * self.slope
        weights = self.weights + velocity
        loss, slope = self._value_and_slope(weights)
        if loss > (1 + t.tolerance) * self.loss or not np.isfinite(loss):
            self.rate *= t.slower
            self.velocity = np.zeros_like(velocity)
        else:
            self.rate *= t.faster if loss < self.loss else 1.0
            self.weights, self.velocity, self.loss, self.slope = weights, velocity, loss, slope
        if self.loss < self.best_loss:
            self.best_weights, self.best_loss = self.weights, self.loss
        self.steps += 1

    def reasons(self) -> tuple[str, ...]:
        """Return why the descent is over; empty as long as it continues."""
        return (f"steps: all {self.trainer.steps} gradient steps done",) if self.steps >= self.trainer.steps else ()

    def best(self) -> Array:
        """Return the weights of the lowest loss so far, shape (count,)."""
        return np.asarray(self.best_weights[0], dtype=np.float64)

    def note(self) -> str:
        """Return an empty text: nothing is chosen here."""
        return ""


def descent(task: Task, weights: Array, samples: Array, ridge: Array, relative: float = 1e-7) -> Iterator[Descent]:
    """Yield the state of P training problems before each step, as long as one has not ended.

    weights : start of each network, shape (P, count)
    samples : weight of each pose, shape (P, N); ridge : of each problem, shape (P,)
    relative : reduction of the cost in a step at or below which a problem ends
    """

    def evaluate(points: Array) -> Evaluated:
        """Return the cost of each problem, and the function of its normal equations."""

        def sums(mask: Array) -> tuple[Array, Array]:
            """Return Hessians and negative gradients, halved, of the problems of a mask."""
            at = np.flatnonzero(mask)
            # The Jacobian is computed in parts of at most 4,000,000 doubles, to limit memory.
            size = max(1, 4_000_000 // (task.layout.count * task.targets.size))
            parts = (at[i : i + size] for i in range(0, len(at), size))
            normal = [_normal_equations(task, points[k], samples[k], ridge[k]) for k in parts]
            slope, curvature = map(np.concatenate, zip(*normal, strict=True))
            return curvature, -slope

        errors = forward(task.layout, points, task.inputs) - task.targets
        fit = np.einsum("pon,pon,pn->p", errors, errors, samples)
        return np.asarray(fit + ridge * ((points * _penalty_mask(task)) ** 2).sum(axis=1), dtype=np.float64), sums

    most, scale = sys.maxsize, np.ones_like
    return levenberg_marquardt(evaluate, weights, most, scale=scale, least=1e-14, relative=relative)


def _normal_equations(task: Task, weights: Array, samples: Array, ridge: Array) -> tuple[Array, Array]:
    """Return half the cost's gradient, (P, count), and Gauss-Newton Hessian, (P, count, count)."""
    outputs, jacobian = outputs_and_jacobian(task.layout, weights, task.inputs)
    count, total = weights.shape
    root = np.sqrt(samples)[:, None]
    errors = ((outputs - task.targets) * root).reshape(count, -1)
    jacobian *= root[:, None]
    flat = jacobian.reshape(count, total, -1)
    curvature = flat @ flat.transpose(0, 2, 1)
    slope = (flat @ errors[..., None])[..., 0]
    penalty = ridge[:, None] * _penalty_mask(task)
    np.einsum("pii->pi", curvature)[...] += penalty
    return slope + penalty * weights, curvature


def _penalty_mask(task: Task) -> Array:
    """Return 1 for each weight that the ridge penalises, 0 for output biases, shape (count,)."""
    return np.asarray(~task.layout.output_biases(), dtype=np.float64)


@dataclass(frozen=True)
class LevenbergMarquardt(Trainer):
    """Settings of the Levenberg-Marquardt training.

    restarts : number of random starts of the final training
    iterations : largest number of steps of the final training
    ridges : candidates, strongest first; the ridge is the cost per unit of squared weight, divided
        by the mean squared norm of the targets. A single one skips the cross-validation.
    folds : number of folds of the cross-validation
    fold_starts : number of random starts of each fold
    """

    name: ClassVar[str] = "lm"
    method: ClassVar[str] = "LM-NN-SKCM"

    restarts: int = 10
    iterations: int = 200
    ridges: tuple[float, ...] = field(default=(0.1, 0.03, 0.01, 0.003, 0.001, 3e-4, 1e-4, 3e-5, 1e-5, 1e-6))
    folds: int = 5
    fold_starts: int = 3

    def __post_init__(self) -> None:
        object.__setattr__(self, "ridges", tuple(float(r) for r in self.ridges))
        if not self.ridges or min(self.ridges) < 0 or list(self.ridges) != sorted(self.ridges, reverse=True):
            raise InputError(f"ridges must be given from strong to weak and not be negative; got {self.ridges}")
        if min(self.restarts, self.iterations, self.fold_starts) < 1 or self.folds < 2:
            raise InputError(f"needs restarts, iterations, fold_starts >= 1 and folds >= 2; got {self}")

    @classmethod
    def for_method(cls) -> Self:
        """Return the trainer with 20 restarts."""
        return cls(restarts=20)

    def begin(self, task: Task, seed: int, starts: Array | None = None) -> "LmRun":
        """Return a training with no step done.

        seed : seed of folds and random starts
        starts : weights, shape (k, count), that replace the random starts of the final training
        """
        return LmRun(self, task, seed, starts)


class LmRun:
    """One training; a step is one damped step of all its problems together."""

    def __init__(self, trainer: LevenbergMarquardt, task: Task, seed: int, starts: Array | None):
        self.trainer, self.task, self.seed, self.starts = trainer, task, seed, starts
        self.folds = min(trainer.folds, task.targets.shape[1])
        self._candidates = trainer.ridges[::-1]
        self.steps, self.level, self.inner = 0, 0, 0
        self.chosen = ""  # in words, in place of the ridge
        # None while the cross-validation that chooses it is running
        self.ridge: float | None = trainer.ridges[0] if len(trainer.ridges) == 1 or self.folds < 2 else None
        self.scores: list[float] = []
        self._unit = float(np.mean(np.sum(task.targets**2, axis=0)))
        self._begin()

    def step(self) -> None:
        """Do one damped step of all problems, and begin the next ridge when its steps are done."""
        self.batch = next(self._descent)
        self.steps, self.inner = self.steps + 1, self.inner + 1
        # There are 100 iterations at the weakest ridge, and 20 at each stronger one.
        if self.ridge is None and (self.inner >= (20 if self.level else 100) or not self.batch.active.any()):
            # Score the current ridge on held-out poses and begin the next or the final training.
            cost = self.batch.cost.reshape(self.folds, -1)
            chosen = np.argmin(cost, axis=1) + np.arange(self.folds) * cost.shape[1]
            weights, inputs, targets = self.batch.point[chosen], self.task.inputs, self.task.targets
            squares = (forward(self.task.layout, weights, inputs) - targets) ** 2
            held_out = (self.samples[chosen] == 0)[:, None]
            self.scores.append(float(np.sum(squares * held_out) / targets.shape[1]))
            best = int(np.argmin(self.scores))
            self.level, self.inner = self.level + 1, 0
            if self.level == len(self._candidates) or self.level > best + 2:
                self.ridge = self._candidates[best]
                self._begin()
            else:
                self._begin(self.batch.point)

    def reasons(self) -> tuple[str, ...]:
        """Return why the training is over; empty as long as it continues."""
        if self.ridge is None:
            return ()
        if not self.batch.active.any():
            return ("converged: no start gains any more",)
        return (f"iterations: all {self.trainer.iterations} done",) if self.inner >= self.trainer.iterations else ()

    def best(self) -> Array:
        """Return the weights of the lowest cost in the current batch, shape (count,)."""
        return np.asarray(self.batch.point[np.argmin(self.batch.cost)])

    def note(self) -> str:
        """Return the ridge and how it was chosen, in words."""
        if self.chosen:
            return self.chosen
        if not self.scores:
            return f"ridge {self.ridge:g}, given"
        return f"ridge {self.ridge:g}, chosen by {self.folds}-fold cross-validation from {len(self.scores)} candidates"

    def _begin(self, weights: Array | None = None) -> None:
        """Begin the problems, folds or the final training, of the current ridge.

        weights : start of each problem; None: random ones, or the given starts of the final one
        """
        if weights is None:
            final, t = self.ridge is not None, self.trainer
            random = np.random.default_rng((self.seed, int(not final)))
            count = t.restarts if final else self.folds * t.fold_starts
            weights = random_weights(self.task.layout, random, count)
            weights = self.starts if final and self.starts is not None else weights
        total, ridge = self.task.targets.shape[1], self.ridge
        masks = np.ones((len(weights), total))
        if ridge is None:
            ridge, folds = self._candidates[self.level], training_masks(total, self.folds, self.seed)
            masks = np.repeat(folds, self.trainer.fold_starts, axis=0)
        self.samples: Array = masks / masks.sum(axis=1, keepdims=True)
        ridges = np.full(len(weights), ridge * self._unit)
        self._descent = descent(self.task, weights, self.samples, ridges)
        self.batch = next(self._descent)

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
from casadical.compensator.trainers.base import State, Trainer
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

    def states(self, task: Task, seed: int) -> Iterator[State]:
        """Yield the state before and after each gradient step with momentum, from random weights.

        A step that would raise the loss beyond the tolerance is not done. The learning rate grows
        after a step that lowers the loss, and shrinks after a refused one.
        """

        def value_and_slope(weights: Array) -> tuple[float, Array]:
            """Return the task's loss in squared units of the outputs, and its gradient, (1, p)."""
            errors = np.asarray(forward(task.layout, weights, task.inputs) - task.targets, dtype=np.float64)
            slope = gradient(task.layout, weights, task.inputs, task.loss.slope(errors))
            return float(task.loss.value(errors)[0]), slope

        weights = best = random_weights(task.layout, np.random.default_rng(seed), 1)
        velocity, rate = np.zeros_like(weights), self.rate
        loss, slope = value_and_slope(weights)
        least = loss
        for steps in range(self.steps):
            yield State(steps, np.asarray(best[0], dtype=np.float64))
            faster = self.momentum * velocity - (1 - self.momentum) * rate * slope
            new_loss, new_slope = value_and_slope(weights + faster)
            if new_loss > (1 + self.tolerance) * loss or not np.isfinite(new_loss):
                rate *= self.slower
                velocity = np.zeros_like(velocity)
            else:
                rate *= self.faster if new_loss < loss else 1.0
                weights, velocity, loss, slope = weights + faster, faster, new_loss, new_slope
            if loss < least:
                best, least = weights, loss
        reasons = (f"steps: all {self.steps} gradient steps done",)
        yield State(self.steps, np.asarray(best[0], dtype=np.float64), reasons)


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

    def states(self, task: Task, seed: int, starts: Array | None = None, note: str = "") -> Iterator[State]:
        """Yield the state before and after each damped step of all problems together.

        The problems are the folds with one ridge after the other, then the final training.

        seed : seed of folds and random starts
        starts : weights, shape (k, count), that replace the random starts of the final training
        note : in words what was chosen, in place of the ridge
        """
        total, unit = task.targets.shape[1], float(np.mean(np.sum(task.targets**2, axis=0)))
        folds, candidates, scores = min(self.folds, total), self.ridges[::-1], list[float]()
        # None while the cross-validation that chooses it is running
        ridge: float | None = self.ridges[0] if len(self.ridges) == 1 or folds < 2 else None

        def problems(weights: Array | None) -> tuple[Array, Iterator[Descent]]:
            """Return sample weights and states of the problems of the current ridge.

            weights : start of each; None: random ones, or the given starts of the final training
            """
            final = ridge is not None
            if weights is None:
                random = np.random.default_rng((seed, int(not final)))
                weights = random_weights(task.layout, random, self.restarts if final else folds * self.fold_starts)
                weights = starts if final and starts is not None else weights
            masks = np.ones((len(weights), total))
            if not final:
                masks = np.repeat(training_masks(total, folds, seed), self.fold_starts, axis=0)
            samples: Array = masks / masks.sum(axis=1, keepdims=True)
            ridges = np.full(len(weights), (candidates[len(scores)] if ridge is None else ridge) * unit)
            return samples, descent(task, weights, samples, ridges)

        samples, batches = problems(None)
        batch, steps, inner = next(batches), 0, 0
        while True:
            reasons: tuple[str, ...] = ()
            if ridge is not None and not batch.active.any():
                reasons = ("converged: no start gains any more",)
            elif ridge is not None and inner >= self.iterations:
                reasons = (f"iterations: all {self.iterations} done",)
            if reasons and not note:
                note = f"ridge {ridge:g}, given"
                if scores:
                    note = f"ridge {ridge:g}, chosen by {folds}-fold cross-validation from {len(scores)} candidates"
            best = np.asarray(batch.point[np.argmin(batch.cost)])
            yield State(steps, best, reasons, note if reasons else "")
            if reasons:
                return
            batch, steps, inner = next(batches), steps + 1, inner + 1
            # There are 100 iterations at the weakest ridge, and 20 at each stronger one.
            if ridge is None and (inner >= (20 if scores else 100) or not batch.active.any()):
                # Score the ridge on held-out poses and begin the next one or the final training.
                cost = batch.cost.reshape(folds, -1)
                chosen = np.argmin(cost, axis=1) + np.arange(folds) * cost.shape[1]
                squares = (forward(task.layout, batch.point[chosen], task.inputs) - task.targets) ** 2
                scores.append(float(np.sum(squares * (samples[chosen] == 0)[:, None]) / total))
                least = int(np.argmin(scores))
                if len(scores) == len(candidates) or len(scores) > least + 2:
                    ridge = candidates[least]
                samples, batches = problems(batch.point if ridge is None else None)
                batch, inner = next(batches), 0

"""Back-propagation, the paper's baseline: one gradient descent from one random start."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from casadical.compensator.network import Task, forward, gradient, random_weights
from casadical.compensator.trainers.base import Trainer
from casadical.core.basics import Array


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

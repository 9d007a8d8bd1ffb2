"""What a trainer is given: scaled inputs and targets, folds of them, and the paper's loss (eqs. 12 and 14)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from casadical.compensator.layout import JointBox, Layout, network_inputs
from casadical.compensator.network import Memory, forward
from casadical.core.basics import Array, InputError


@dataclass(frozen=True)
class Loss:
    """The loss l1 * mean(E) + l2 * max(E), E a pose's mean square error [mm^2] (eqs. 12, 14); paper: 1 and 0.7."""

    mean: float = 1.0
    max: float = 0.7

    def __post_init__(self) -> None:
        if not (self.mean >= 0 and self.max >= 0 and self.mean + self.max > 0):
            raise InputError(f"the weights of the loss must not be negative nor both zero; got {self}")

    def value(self, errors: Array) -> Array:
        """The loss of every network, shape (P,) [mm^2]; errors : shape (P, outputs, N) [mm]."""
        _, outputs, samples = errors.shape
        totals = np.einsum("pon,pon->pn", errors, errors)
        losses = np.maximum.reduce(totals, axis=1)
        losses *= self.max
        losses += totals @ np.full(samples, self.mean / samples, errors.dtype)
        losses /= outputs
        return np.asarray(losses)

    def slope(self, errors: Array) -> Array:
        """A (sub)gradient of the loss by the errors, both of shape (P, outputs, N) [mm]."""
        networks, outputs, samples = errors.shape
        weight = np.full((networks, samples), self.mean / samples)
        worst = np.einsum("pon,pon->pn", errors, errors).argmax(axis=1)
        weight[np.arange(networks), worst] += self.max
        return np.asarray(2.0 / outputs * weight[:, None] * errors, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Task:
    """A training problem.

    inputs : shape (features + 1, N): as of `network_inputs`
    targets : shape (outputs, N) [units of the output layer]: residuals divided by ``scale_mm``
    scale_mm : millimetres of one unit of the output layer [mm]; loss : what is minimised
    """

    layout: Layout
    inputs: Array
    targets: Array
    scale_mm: float = 1.0
    loss: Loss = Loss()

    def losses(self, weights: Array) -> Array:
        """The loss of every row of weights, shape (P,) [mm^2]; weights : shape (P, count)."""
        try:  # another thread takes memory of its own
            memory = self._idle.pop()
        except IndexError:
            memory = Memory()
        errors = forward(self.layout, weights, self.inputs, memory)
        errors -= self.targets
        losses = self.loss.value(errors)
        self._idle.append(memory)
        return np.asarray(self.scale_mm**2 * losses)

    @cached_property
    def _idle(self) -> list[Memory]:
        return []

    def errors_mm(self, weights: Array) -> Array:
        """Target minus output of one network (eq. 11), shape (N, outputs) [mm]; weights : shape (count,)."""
        outputs = forward(self.layout, weights[None], self.inputs)[0]
        return np.asarray(self.scale_mm * (self.targets - outputs).T, dtype=np.float64)


def make_task(
    layout: Layout, box: JointBox, q: Array, residual_mm: Array, *, scale_mm: float = 1.0, loss: Loss | None = None
) -> Task:
    """Prepare joint angles and residuals for training.

    layout : sizes of the network
    box : joint ranges of the input scaling [rad]
    q : shape (n, joints) [rad]: joint readings
    residual_mm : shape (n, outputs) [mm]: residuals
    scale_mm : millimetres of one unit of the output layer [mm]
    loss : what is minimised; None: the paper's
    Raises InputError: a scale that is not positive.

    Examples
    --------
    >>> from casadical.compensator import JointBox, Layout, make_task
    >>> make_task(Layout(2), JointBox((-3.0, -3.0), (3.0, 3.0)), poses.q, residual_mm).targets.shape
    (3, 40)
    """
    if not (np.isfinite(scale_mm) and scale_mm > 0):
        raise InputError(f"output_scale_mm must be positive and finite; got {scale_mm}")
    inputs = network_inputs(layout, box, q)
    targets = np.ascontiguousarray(residual_mm.T) / scale_mm
    return Task(layout, inputs, targets, scale_mm, loss if loss is not None else Loss())


def random_weights(layout: Layout, random: np.random.Generator, count: int) -> Array:
    """Draw starting weights, shape (count, layout.count): normal, divided by the square root of a neuron's inputs."""
    spread = layout.weights([np.full(shape, shape[1] ** -0.5) for shape in layout.shapes])
    return np.asarray(spread * random.standard_normal((count, layout.count)), dtype=np.float64)


def training_masks(samples: int, folds: int, seed: int) -> Array:
    """Split samples at random into folds of sizes that differ by one at most.

    Returns a boolean array of shape (folds, samples), true where a sample is trained on.
    """
    order = np.random.default_rng(seed).permutation(samples)
    masks = np.ones((folds, samples), dtype=bool)
    for mask, held_out in zip(masks, np.array_split(order, folds), strict=True):
        mask[held_out] = False
    return masks

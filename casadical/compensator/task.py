"""What a trainer is given: scaled inputs and targets, and the paper's loss (eqs. 12 and 14)."""

from dataclasses import dataclass

import numpy as np

from casadical.compensator.forward import forward
from casadical.compensator.layout import JointBox, Layout, network_inputs
from casadical.core.arrays import Array
from casadical.core.errors import InputError


@dataclass(frozen=True)
class Loss:
    """The paper's loss l1 * mean(E) + l2 * max(E), E the mean square error of a pose's outputs [mm^2] (eqs. 12, 14).

    mean, max : l1 and l2; the paper's are 1 and 0.7.
    """

    mean: float = 1.0
    max: float = 0.7

    def __post_init__(self) -> None:
        if not (self.mean >= 0 and self.max >= 0 and self.mean + self.max > 0):
            raise InputError(f"the weights of the loss must not be negative nor both zero; got {self}")

    def of(self, errors: Array) -> Array:
        """Return the loss of every network: errors of shape (P, outputs, N) [mm] -> shape (P,) [mm^2]."""
        squares = np.einsum("pon,pon->pn", errors, errors)
        samples = errors.shape[2]
        total = self.mean / samples * (squares @ np.ones(samples, squares.dtype)) + self.max * squares.max(axis=1)
        return np.asarray(total / errors.shape[1])

    def slope(self, errors: Array) -> Array:
        """Return a (sub)gradient of the loss by the errors, both of shape (P, outputs, N) [mm]."""
        networks, outputs, samples = errors.shape
        weight = np.full((networks, samples), self.mean / samples)
        worst = np.einsum("pon,pon->pn", errors, errors).argmax(axis=1)
        weight[np.arange(networks), worst] += self.max
        return np.asarray(2.0 / outputs * weight[:, None] * errors, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Task:
    """A training problem.

    inputs : array, shape (features + 1, N), from `network_inputs`. targets : array, shape (outputs, N), residuals
    divided by ``scale_mm``, the millimetres of one unit of the linear output layer.
    """

    layout: Layout
    inputs: Array
    targets: Array
    scale_mm: float = 1.0
    loss: Loss = Loss()

    def losses(self, weights: Array) -> Array:
        """Return the loss of every row of weights, shape (P, count) -> (P,) [mm^2]."""
        errors = forward(self.layout, weights, self.inputs)
        errors -= self.targets
        return np.asarray(self.scale_mm**2 * self.loss.of(errors))

    def errors_mm(self, weights: Array) -> Array:
        """Return target minus output of one network, shape (N, outputs) [mm] (eq. 11)."""
        outputs = forward(self.layout, weights[None], self.inputs)[0]
        return np.asarray(self.scale_mm * (self.targets - outputs).T, dtype=np.float64)


def make_task(
    layout: Layout, box: JointBox, q: Array, residual_mm: Array, *, scale_mm: float = 1.0, loss: Loss | None = None
) -> Task:
    """Prepare joint angles, shape (n, joints) [rad], and residuals, shape (n, outputs) [mm], for training.

    Raises InputError for a scale that is not positive.
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

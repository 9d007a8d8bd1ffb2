"""Values of the noise's sigma and ratios and of a cause's size, and log likelihoods over them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from casadical.core.basics import Array

# A sigma counts where the log likelihood may come within so much of a group's greatest one.
NEGLIGIBLE = 40.0


@dataclass(frozen=True, eq=False)
class Grid:
    """Values at which a model is judged.

    sigmas : of white noise, rising, in units of the residual; ratios : of each noise component over sigma, by name,
        shape (points,) each; kappas : sizes of a cause in units of its usual one, rising
    """

    sigmas: Array
    ratios: Mapping[str, Array]
    kappas: Array

    @property
    def points(self) -> int:
        """How many combinations of ratios there are."""
        return len(next(iter(self.ratios.values()))) if self.ratios else 1

    def at(self, point: int) -> dict[str, float]:
        """The ratios of one point, by component."""
        return {name: float(values[point]) for name, values in self.ratios.items()}


def log_gain(sigmas: Array, kappas: Array, log_base: Array, value: Array, turned: Array) -> Array:
    """Log likelihood with groups of columns, shape (groups, sigmas, kappas), from that without, shape (sigmas,).

    sigmas : of the noise [m]; kappas : sizes of the cause in units of its usual one, rising
    value, turned : eigenvalues of their visible products, and products with what is left, shapes (groups, width)
    Only at sigmas where it counts; it is minus infinity at the others (see `NEGLIGIBLE`).
    """
    value, square = np.maximum(value, 0), turned**2
    # An upper bound: the gain at the greatest kappa, without what its width costs.
    bound = log_base + 0.5 * _explained((sigmas / kappas[-1]) ** 2, value, square) / sigmas**2
    best = bound.argmax(axis=1)
    unit = (sigmas[best, None] / kappas) ** 2
    least = log_base[best] + gain(unit, sigmas[best, None], value, square).max(axis=1)
    likely = np.flatnonzero((bound > least[:, None] - NEGLIGIBLE).any(axis=0))
    out = np.full((len(value), len(sigmas), len(kappas)), -np.inf)
    unit, own = ((sigmas[likely, None] / kappas) ** 2).ravel(), np.repeat(sigmas[likely], len(kappas))
    gained = gain(unit, own, value, square).reshape(len(value), len(likely), len(kappas))
    out[:, likely] = log_base[likely, None] + gained
    return out


def _explained(unit: Array, value: Array, square: Array) -> Array:
    """Sum of squares / (unit + value) over a group's directions, shape (groups, units)."""
    total = np.zeros(np.broadcast_shapes(unit.shape, (len(value), 1)))
    for v, s in zip(value.T[:, :, None], square.T[:, :, None], strict=True):
        total += s / (unit + v)
    return total


def gain(unit: Array, sigma: Array | float, value: Array, square: Array) -> Array:
    """What groups gain in log likelihood, shape (groups, units); unit : squared sigma over kappa."""
    total = np.zeros(np.broadcast_shapes(unit.shape, (len(value), 1)))
    product, log = np.ones_like(total), np.zeros_like(total)
    for k, (v, s) in enumerate(zip(value.T[:, :, None], square.T[:, :, None], strict=True), 1):
        wide = unit + v
        total += s / wide
        product *= wide
        # Factors of a determinant that are multiplied before a logarithm is taken.
        if k % 8 == 0 or k == value.shape[1]:
            log += np.log(product)
            product[:] = 1.0
    return np.asarray(0.5 * (total / sigma**2 - log + value.shape[1] * np.log(unit)))

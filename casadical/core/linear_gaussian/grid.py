"""Grid of noise levels, noise ratios and effect sizes, and log-likelihood gains over it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from casadical.core.basics import Array

# Largest difference of log likelihoods [nats] by which a sigma of the grid may be below the maximum
# of a group of columns; sigmas beyond it for all groups of a call are skipped.
SIGMA_LOG_LIKELIHOOD_WINDOW = 40.0


@dataclass(frozen=True, eq=False)
class Grid:
    """Grid over which the likelihood of a model is computed and integrated.

    sigmas : standard deviations of the white noise, rising, in the unit of the residual
    ratios : standard deviation of each noise component divided by sigma, by the component's name,
        shape (points,) each; a point of the grid is one combination of them
    kappas : prior standard deviations of a cause's parameters in units of their typical sizes,
        rising
    """

    sigmas: Array
    ratios: Mapping[str, Array]
    kappas: Array

    @property
    def points(self) -> int:
        """Return the number of combinations of noise ratios."""
        return len(next(iter(self.ratios.values()))) if self.ratios else 1

    def at(self, point: int) -> dict[str, float]:
        """Return the noise ratios of one grid point, by component."""
        return {name: float(values[point]) for name, values in self.ratios.items()}


def log_gain(
    sigmas: Array, kappas: Array, log_base: Array, value: Array, projected: Array, residual_square: float = np.inf
) -> Array:
    """Return the log likelihood with each group of columns, shape (groups, sigmas, kappas).

    The parameters of a group are integrated out. The result is minus infinity at sigmas where it is
    negligible for all groups, by `SIGMA_LOG_LIKELIHOOD_WINDOW`, and for a group that would explain
    more than the residual: its columns were lost in round-off.

    sigmas : standard deviations of the white noise, in the unit of the residual
    kappas : prior standard deviations of the parameters in typical sizes, rising
    log_base : log likelihood without any of the groups, shape (sigmas,)
    value : eigenvalues of the Gram matrix of each group's columns, whitened for sigma = 1 and
        orthogonal to the base, shape (groups, width)
    projected : products of the residual with the columns along the eigenvectors, shape (groups,
        width)
    residual_square : squared norm of the residual, whitened for sigma = 1
    """
    value, square = np.maximum(value, 0), projected**2
    # This is an upper bound: the gain at the greatest kappa without the penalty of its determinant.
    explained = np.zeros((len(value), len(sigmas)))
    for v, s in zip(value.T[:, :, None], square.T[:, :, None], strict=True):
        explained += s / ((sigmas / kappas[-1]) ** 2 + v)
    upper_bound = log_base + 0.5 * explained / sigmas**2
    best = upper_bound.argmax(axis=1)
    unit = (sigmas[best, None] / kappas) ** 2
    lower_bound = log_base[best] + gain(unit, sigmas[best, None], value, square).max(axis=1)
    likely = np.flatnonzero((upper_bound > lower_bound[:, None] - SIGMA_LOG_LIKELIHOOD_WINDOW).any(axis=0))
    out = np.full((len(value), len(sigmas), len(kappas)), -np.inf)
    unit, own = ((sigmas[likely, None] / kappas) ** 2).ravel(), np.repeat(sigmas[likely], len(kappas))
    gained = gain(unit, own, value, square).reshape(len(value), len(likely), len(kappas))
    out[:, likely] = log_base[likely, None] + gained
    out[explained.max(axis=1) > 1.001 * residual_square] = -np.inf
    return out


def gain(unit: Array, sigma: Array | float, value: Array, square: Array) -> Array:
    """Return the gain in log likelihood by each group of columns, shape (groups, units).

    unit : (sigma / kappa)^2, shape (units,) or (groups, units)
    sigma : standard deviation of the white noise for each unit, in the unit of the residual
    value : eigenvalues of each group's whitened Gram matrix, shape (groups, width)
    square : squared products of the residual with the columns along the eigenvectors, the same
        shape
    """
    total = np.zeros(np.broadcast_shapes(unit.shape, (len(value), 1)))
    product, log = np.ones_like(total), np.zeros_like(total)
    for k, (v, s) in enumerate(zip(value.T[:, :, None], square.T[:, :, None], strict=True), 1):
        wide = unit + v
        total += s / wide
        product *= wide
        # Eight factors of the determinant are multiplied before a logarithm is taken, for speed.
        if k % 8 == 0 or k == value.shape[1]:
            log += np.log(product)
            product[:] = 1.0
    return np.asarray(0.5 * (total / sigma**2 - log + value.shape[1] * np.log(unit)))

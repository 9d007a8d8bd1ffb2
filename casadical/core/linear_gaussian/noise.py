"""Noise of rows in blocks: white noise, noise that the rows of a block share, and AR(1) noise.

A block's covariance is sigma^2 (I + rho^2 Jq Jq'): sources (for example the joints of a robot),
whose independent deviations of standard deviation rho sigma reach the rows through Jq.
Autocorrelated noise (`SerialNoise`) is a first-order autoregressive process over the blocks.
`log_gain` is the gain in log likelihood over a grid of noise levels and effect sizes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array


@dataclass(frozen=True, eq=False)
class Axes:
    """Eigenvectors of each block's noise covariance, common to all points of the noise grid.

    rotation : eigenvectors as columns, shape (n, m, m)
    precision : inverse variance along each eigenvector in units of 1 / sigma^2, shape (points, n,
        m)
    log_det : log determinant of the covariance of all blocks in units of sigma^2, shape (points,)
    plain : whether there is white noise only, so that rows need no rotation
    """

    rotation: Array
    precision: Array
    log_det: Array
    plain: bool = False

    def at(self, points: Sequence[int]) -> "Axes":
        """Return the same eigenvectors for the points with these indices."""
        return replace(self, precision=self.precision[points], log_det=self.log_det[points])

    def rotated(self, rows: Array, blocks: slice = slice(None)) -> Array:
        """Return rows of some blocks in the eigenbasis, shape (k, m, columns).

        rows : rows of these k blocks, shape (k, m, columns)
        """
        if self.plain:
            return rows
        return np.asarray(self.rotation[blocks].transpose(0, 2, 1) @ rows)


def axes_of(Jq: Array, ratios: Array) -> Axes:
    """Return the eigenbasis of the noise covariance, common to all ratios, shape (points,).

    Jq : derivative of the rows by the sources of noise, shape (n, m, sources)
    """
    shared = covariance_of(Jq, 1.0, 0.0)
    square, rotation = np.linalg.eigh(shared)
    variance = np.multiply.outer(ratios**2, np.maximum(square, 0.0))
    return Axes(rotation, 1 / (1 + variance), np.log1p(variance).sum(axis=(1, 2)), not shared.any())


def covariance_of(Jq: Array, ratio: float | Array, white: float = 1.0) -> Array:
    """Return the noise covariance of each block, shape (n, m, m), in units of sigma^2.

    Given standard deviations in place of `ratio` and `white`, the result is in their unit squared.

    Jq : derivative of the rows by the sources of noise, shape (n, m, sources)
    ratio : standard deviation of the sources divided by sigma, or one of each, shape (sources,)
    white : standard deviation of the white noise divided by sigma
    """
    A = Jq * ratio
    return np.asarray(white**2 * np.eye(Jq.shape[1]) + A @ A.transpose(0, 2, 1))


def whitening_of(covariance: Array) -> tuple[Array, float]:
    """Return the whitening matrix of each block, and the log determinant of all blocks' covariance.

    The matrix W has W C W' = I for the covariance C of a block, both of shape (n, m, m).
    """
    L = np.linalg.cholesky(covariance)
    return np.linalg.inv(L), 2 * float(np.log(np.diagonal(L, axis1=1, axis2=2)).sum())


@dataclass(frozen=True, eq=False)
class SerialNoise:
    """Autocorrelated (AR(1)) noise: (row - ar_coefficient * previous row) * weight is white.

    ar_coefficient : factor of the previous block's noise, zero where a run of blocks begins
    weight : inverse standard deviation of the innovations
    Both have the shape (n,), or (n, m) with one number per row.
    """

    ar_coefficient: Array
    weight: Array

    @property
    def is_autocorrelated(self) -> bool:
        """Return whether any AR coefficient differs from zero."""
        return bool(self.ar_coefficient.any())

    def whiten(self, rows: Array) -> Array:
        """Return the whitened rows of all blocks in time order, shape (n, m, ...).

        rows : rows before the whitening, the same shape
        """
        ar_coefficient, weight = (
            a.reshape(*a.shape, *[1] * (rows.ndim - a.ndim)) for a in (self.ar_coefficient, self.weight)
        )
        out = np.array(rows)
        if self.is_autocorrelated:
            out[1:] -= ar_coefficient[1:] * rows[:-1]
        out *= weight
        return out

    def whiten_transposed(self, white: Array) -> Array:
        """Return W' white, shape (n, m), for the matrix W of the whitening `whiten`.

        Thus sum(whiten(rows) * white) = sum(rows * result).

        white : numbers of all blocks, shape (n, m)
        """
        weight, ar_coefficient = (a.reshape(len(white), -1) for a in (self.weight, self.ar_coefficient))
        out = weight * white
        out[:-1] -= ar_coefficient[1:] * out[1:]
        return np.asarray(out)


def serial_noise(ar_coefficient: Array | float, first: Array, weight: Array | float = 1.0) -> SerialNoise:
    """Return stationary AR(1) noise: its variance at the begin of a run is that of later blocks.

    ar_coefficient : factor of the previous block's noise, above -1 and below 1
    first : whether a run of blocks begins at each block
    weight : inverse standard deviation of each block's noise (not of the innovations)
    The shapes are (n,), or (n, m) with one number per row, or broadcastable to either.
    """
    share = np.where(first, 0.0, ar_coefficient)
    return SerialNoise(share, weight / np.sqrt(1 - share**2))


# Largest difference of log likelihoods [nats] by which a sigma of the grid may be below the maximum
# of a group of columns; sigmas beyond it for all groups of a call are skipped.
SIGMA_LOG_LIKELIHOOD_WINDOW = 40.0


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


def log_gain_by_size(H: Array, b: Array, kappas: Array) -> Array:
    """Return the log Bayes factor of each group of parameters against none, shape (groups, kappas).

    H, b : information, shape (groups, width, width), and score, shape (groups, width)
    kappas : prior standard deviations of all parameters of a group
    """
    value, vector = np.linalg.eigh(H)
    square = (vector.transpose(0, 2, 1) @ b[:, :, None])[:, :, 0] ** 2
    return gain(kappas**-2.0, 1.0, np.maximum(value, 0.0), square)

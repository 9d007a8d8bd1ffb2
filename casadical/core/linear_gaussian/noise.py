"""Noise of rows in blocks: white noise, components that rows of a block share, and AR(1) noise.

A block's covariance is sigma^2 (I + sum_k rho_k^2 A_k A_k'): component k has sources (for example
the joints of a robot) whose independent deviations of standard deviation rho_k sigma reach the rows
through A_k. Autocorrelated noise (`SerialNoise`) is a first-order autoregressive process over the
blocks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from casadical.core.basics import Array

# Standard deviation of a noise component's sources divided by sigma: one number for all of them, or
# one each, shape (sources,).
Ratio = float | Array


@dataclass(frozen=True, eq=False)
class Axes:
    """Eigenvectors of each block's noise covariance, common to several points of the noise grid.

    points : indices of these grid points, rising
    rotation : eigenvectors as columns, shape (n, m, m)
    precision : inverse variance along each eigenvector in units of 1 / sigma^2, shape (points, n,
        m)
    log_det : log determinant of the covariance of all blocks in units of sigma^2, shape (points,)
    plain : whether there is white noise only, so that rows need no rotation
    """

    points: tuple[int, ...]
    rotation: Array
    precision: Array
    log_det: Array
    plain: bool = False

    def rotated(self, rows: Array, blocks: slice = slice(None)) -> Array:
        """Return rows of some blocks in the eigenbasis, shape (k, m, columns).

        rows : rows of these k blocks, shape (k, m, columns)
        """
        if self.plain:
            return rows
        return np.asarray(self.rotation[blocks].transpose(0, 2, 1) @ rows)


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """White noise and components of n blocks of m rows.

    shape : (n, m)
    components : derivative A of the rows by the sources of each component, by its name, shape (n,
        m, sources)
    """

    shape: tuple[int, int]
    components: Mapping[str, Array]

    def at(self, blocks: Array | slice) -> "NoiseModel":
        """Return the noise model of some of the blocks, given by indices, a mask or a slice."""
        components = {name: A[blocks] for name, A in self.components.items()}
        return NoiseModel((len(np.arange(self.shape[0])[blocks]), self.shape[1]), components)

    def covariance(self, ratios: Mapping[str, Ratio], white: float = 1.0) -> Array:
        """Return the noise covariance of each block, shape (n, m, m), in units of sigma^2.

        Given standard deviations in place of `ratios` and `white`, the result is in their unit
        squared.

        ratios : standard deviation of each component's sources divided by sigma, by name
        white : standard deviation of the white noise divided by sigma
        """
        n, m = self.shape
        total = np.tile(white**2 * np.eye(m), (n, 1, 1))
        for name, ratio in ratios.items():
            A = self.components[name] * ratio
            total += A @ A.transpose(0, 2, 1)
        return total

    def whitening(self, ratios: Mapping[str, Ratio]) -> tuple[Array, float]:
        """Return matrices, (n, m, m), that whiten to the variance sigma^2, and a log determinant.

        ratios : as of `covariance`. The determinant is that of all blocks (see `whitening_of`).
        """
        return whitening_of(self.covariance(ratios))

    def axes(self, ratios: Mapping[str, Array]) -> list[Axes]:
        """Return the eigenbases of the noise covariance for all points of a grid.

        A single component has the same eigenvectors at every ratio, so that there is one entry for
        all points; with several components every point has its own.

        ratios : ratios of each component at the points, by its name, shape (points,) each
        """
        count = len(next(iter(ratios.values()))) if ratios else 1
        if len(ratios) > 1:
            at = [{name: float(values[k]) for name, values in ratios.items()} for k in range(count)]
            return [_axes(self.covariance(at[k], white=0.0), [k], np.ones(1)) for k in range(count)]
        each = [self.covariance({name: 1.0}, white=0.0) for name in ratios] or [self.covariance({}, white=0.0)]
        return [_axes(each[0], range(count), np.concatenate([*ratios.values(), np.zeros(0 if ratios else 1)]))]

    def mean_variance(self, ratios: Mapping[str, float], rows: float) -> float:
        """Return the mean noise variance of the measured rows in units of sigma^2.

        ratios : as of `covariance`; rows : number of measured rows
        """
        return 1 + sum(ratio**2 * float((self.components[k] ** 2).sum()) for k, ratio in ratios.items()) / rows


def _axes(shared: Array, points: Sequence[int], ratios: Array) -> Axes:
    """Return the eigenbasis of the covariances I + ratio^2 * shared, common to all ratios.

    shared : shape (n, m, m)
    points : indices of the grid points, one for each of `ratios`, shape (points,)
    """
    square, rotation = np.linalg.eigh(shared)
    variance = np.multiply.outer(ratios**2, np.maximum(square, 0.0))
    return Axes(tuple(points), rotation, 1 / (1 + variance), np.log1p(variance).sum(axis=(1, 2)), not shared.any())


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

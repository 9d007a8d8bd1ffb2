"""Noise of rows in blocks: white, named components that the rows of a block share, and what stays from block to block.

A block's covariance is sigma^2 (I + sum_k rho_k^2 A_k A_k'): component k has sources (the joints of a robot, say) whose
independent deviations of rho_k sigma reach the rows through A_k. Noise that follows itself keeps a share of the block
before it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from casadical.core.basics import Array

# Of a component: over sigma, alike for all of its sources, or of each of them, shape (sources,).
Ratio = float | Array


@dataclass(frozen=True, eq=False)
class Whitening:
    """At one noise: W of each block with W C W' = I, shape (n, m, m), and the log determinant of all C together."""

    W: Array
    log_det: float

    def __matmul__(self, rows: Array) -> Array:
        """White rows; rows : shape (n, m, columns)."""
        return np.asarray(self.W @ rows)


@dataclass(frozen=True, eq=False)
class Axes:
    """Axes of each block in which the noise is independent at several points of a grid.

    points : numbers of these points, rising; turn : axes as columns, shape (n, m, m)
    precision : of each axis in units of 1 / sigma^2, shape (points, n, m); log_det : of the covariance, shape (points,)
    plain : whether the axes are the rows themselves, for they share no noise
    """

    points: tuple[int, ...]
    turn: Array
    precision: Array
    log_det: Array
    plain: bool = False

    def turned(self, rows: Array, blocks: slice = slice(None)) -> Array:
        """Rows of some blocks in the axes; rows : shape (n, m, columns)."""
        if self.plain:
            return rows
        return np.asarray(self.turn[blocks].transpose(0, 2, 1) @ rows)


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Noise of n blocks of m rows; components : A of each by name, shape (n, m, sources)."""

    shape: tuple[int, int]
    components: Mapping[str, Array]

    def at(self, blocks: Array | slice) -> "NoiseModel":
        components = {name: A[blocks] for name, A in self.components.items()}
        return NoiseModel((len(np.arange(self.shape[0])[blocks]), self.shape[1]), components)

    def covariance(self, ratios: Mapping[str, Ratio], white: float = 1.0) -> Array:
        """Of each block, shape (n, m, m), in units of sigma^2; or with one sigma of everything as ratios and white."""
        n, m = self.shape
        total = np.tile(white**2 * np.eye(m), (n, 1, 1))
        for name, ratio in ratios.items():
            A = self.components[name] * ratio
            total += A @ A.transpose(0, 2, 1)
        return total

    def whitening(self, ratios: Mapping[str, Ratio]) -> Whitening:
        """What makes noise of variance sigma^2 of it, in units of sigma."""
        return whitening_of(self.covariance(ratios))

    def axes(self, ratios: Mapping[str, Array]) -> list[Axes]:
        """Axes for all points of a grid; ratios : by component, shape (points,) each.

        One component has the same axes at every ratio, so that rows are turned once; several have others at each point.
        """
        count = len(next(iter(ratios.values()))) if ratios else 1
        if len(ratios) > 1:
            at = [{name: float(values[k]) for name, values in ratios.items()} for k in range(count)]
            return [_axes(self.covariance(at[k], white=0.0), [k], np.ones(1)) for k in range(count)]
        each = [self.covariance({name: 1.0}, white=0.0) for name in ratios] or [self.covariance({}, white=0.0)]
        return [_axes(each[0], range(count), np.concatenate([*ratios.values(), np.zeros(0 if ratios else 1)]))]

    def mean_variance(self, ratios: Mapping[str, float], rows: float) -> float:
        """Mean over the measured rows of the noise's variance in units of sigma^2; rows : how many were measured."""
        return 1 + sum(ratio**2 * float((self.components[k] ** 2).sum()) for k, ratio in ratios.items()) / rows


def _axes(shared: Array, points: Sequence[int], ratios: Array) -> Axes:
    """Axes of I + ratio^2 * shared; shared : shape (n, m, m)."""
    square, turn = np.linalg.eigh(shared)
    variance = np.multiply.outer(ratios**2, np.maximum(square, 0.0))
    return Axes(tuple(points), turn, 1 / (1 + variance), np.log1p(variance).sum(axis=(1, 2)), not shared.any())


def whitening_of(covariance: Array) -> Whitening:
    """What makes noise of a covariance white, shape (n, m, m)."""
    L = np.linalg.cholesky(covariance)
    return Whitening(np.linalg.inv(L), 2 * float(np.log(np.diagonal(L, axis1=1, axis2=2)).sum()))


@dataclass(frozen=True, eq=False)
class SerialNoise:
    """Noise that keeps a share of what it was at the block before; without that share, times a weight, it is white.

    stays : the share, zero where a run of blocks begins; weight : shapes (n,), or (n, m) of each row
    """

    stays: Array
    weight: Array

    @property
    def follows(self) -> bool:
        """Whether anything stays at all."""
        return bool(self.stays.any())

    def white(self, rows: Array) -> Array:
        """Rows of all blocks whitened, shape (n, m, ...)."""
        stays, weight = (a.reshape(*a.shape, *[1] * (rows.ndim - a.ndim)) for a in (self.stays, self.weight))
        out = np.array(rows)
        if self.follows:
            out[1:] -= stays[1:] * rows[:-1]
        out *= weight
        return out

    def pulled(self, white: Array) -> Array:
        """What products with white rows are products with: white(rows) * white and rows * this sum alike.

        white : of all blocks, shape (n, m)
        """
        weight, stays = (a.reshape(len(white), -1) for a in (self.weight, self.stays))
        out = weight * white
        out[:-1] -= stays[1:] * out[1:]
        return np.asarray(out)


def serial_noise(stays: Array | float, first: Array, weight: Array | float = 1.0) -> SerialNoise:
    """Noise that is as large at the begin of a run as later, an AR(1) process in its steady state.

    stays : the share that stays; first : whether a run begins at a block; weight : of each, one over the noise; shapes
        (n,), or (n, m) of each row, or what numpy broadcasts to either
    """
    share = np.where(first, 0.0, stays)
    return SerialNoise(share, weight / np.sqrt(1 - share**2))

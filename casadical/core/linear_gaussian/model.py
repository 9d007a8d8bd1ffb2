"""The linear-Gaussian model that a user gives: residual, base, columns, priors, noise and the grid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import EVERY, Columns, Combined, combined
from casadical.core.linear_gaussian.grid import Grid
from casadical.core.linear_gaussian.noise import NoiseModel, Ratio, Whitening


@dataclass(frozen=True)
class Memory:
    """How much is held at a time; answers do not depend on it.

    columns, blocks : bytes of the columns that are added up at a time, and at least so many blocks
    kept : bytes up to which white columns are kept, else they are made again; part : so many at a time
    rows : up to so many, leaving some out is worked out among the observations instead of the parameters
    """

    columns: int = 128_000_000
    blocks: int = 256
    kept: int = 60_000_000
    part: int = 32_000_000
    rows: int = 1500


@dataclass(frozen=True, eq=False)
class LinearModel:
    """r = J delta + E theta + noise, delta ~ N(mean, (sigma / reference * prior)^2), theta ~ N(0, kappa^2).

    residual : r, shape (n, m); base : J, shape (n, m, P); mean, prior : of delta, shapes (P,)
    columns : E in units of the usual sizes of theta; held : one sigma of each theta once it is in the model, in sizes
    noise : its components; grid : where it is judged
    reference : sigma at which priors of what is in the model are as given; they grow with the noise
    count : how many numbers were measured; absorbed : numbers that the base takes, which tell nothing of the noise
        (REML: Harville 1977)
    near : points of the grid that are looked at; log_noise : what else is known of the noise, as a logarithm, shape
        (points, sigmas)
    memory : how much is held at a time
    """

    residual: Array
    base: Array
    mean: Array
    prior: Array
    columns: Columns
    held: Array
    noise: NoiseModel
    grid: Grid
    reference: float
    count: int
    absorbed: float = 0.0
    near: tuple[int, ...] = (0,)
    log_noise: Array | float = field(default=0.0)
    memory: Memory = Memory()

    @property
    def width(self) -> int:
        return self.columns.shape[2]

    def combined(self, columns: Array) -> Combined:
        """Some of the columns, in rising order, those of parts as combinations."""
        return combined(columns, self.columns.directions)

    def take(self, columns: Array, blocks: Array | slice = EVERY) -> Array:
        """Some of the columns at some blocks, shape (blocks, m, len(columns))."""
        return self.columns.take(columns, blocks)

    def with_base(self, columns: Array) -> LinearModel:
        """The model with these columns moved into the base, as wide as they are held there."""
        if not len(columns):
            return self
        new, prior = self.as_base(columns)
        base, mean = np.concatenate([self.base, new], axis=2), np.append(self.mean, np.zeros(len(prior)))
        return replace(self, base=base, mean=mean, prior=np.append(self.prior, prior))

    def as_base(self, columns: Array) -> tuple[Array, Array]:
        """Some columns as those of the base, combined, shape (n, m, k), and their priors' widths, shape (k,).

        columns : in rising order. Log likelihoods are less by what the directions left out would add, alike everywhere.
        """
        every = self.combined(columns)
        return self.columns.take(columns, EVERY, every), every.one_of_each(self.held[columns])

    def with_columns(self, columns: Columns, held: float) -> LinearModel:
        """The model with other columns; held : one sigma of each of them once it is in the model, in sizes."""
        return replace(self, columns=columns, held=np.full(columns.shape[2], held))

    @cached_property
    def absorbed_by_base(self) -> float:
        """How many numbers the base takes: the trace of what projects on it, priors included."""
        A = self.base.reshape(self.residual.size, -1) * (self.prior / self.reference)
        # Not of A' A: beside a wide prior's direction its eigenvalues lose those of narrow ones.
        square = np.linalg.svd(np.linalg.qr(A, mode="r"), compute_uv=False) ** 2
        return float((square / (1 + square)).sum())

    def log_over_sigmas(self, square: float, log_norm: float) -> Array:
        """Log likelihood, shape (sigmas,); square : of what is left; log_norm : what does not depend on sigma."""
        sigmas = self.grid.sigmas
        return np.asarray(log_norm - (self.count - self.absorbed) * np.log(sigmas) - 0.5 * square / sigmas**2)

    def projection(self, ratios: Mapping[str, Ratio]) -> Projection:
        """What makes rows white and orthogonal to the base at one noise."""
        whitening = self.noise.whitening(ratios)
        weights = self.reference / self.prior
        Q, log_det = axes_of_base((whitening @ self.base).reshape(self.residual.size, -1), weights)
        y = np.concatenate([(whitening @ self.residual[:, :, None]).ravel(), weights * self.mean])
        return Projection(whitening, Q, y - Q @ (Q.T @ y), -0.5 * (whitening.log_det + log_det))


def axes_of_base(A: Array, weights: Array) -> tuple[Array, float]:
    """Orthogonal axes of the base's white columns with the rows of its priors behind, and their log determinant.

    A : shape (rows, P); weights : one over the widths of the priors, shape (P,). The axes have the shape (rows + P, P).
    """
    A = np.concatenate([A, np.diag(weights)])
    # A parameter whose column is long is scaled first, so that rank is judged fairly.
    scale = np.linalg.norm(A, axis=0)
    Q, R = np.linalg.qr(A / scale)
    return Q, 2 * float(np.log(np.abs(np.diag(R)) * scale).sum())


def beside_base(Q: Array, K: Array) -> Array:
    """Covariance of white rows, and of those of the base's priors, orthogonal to the base: one, and what causes do.

    Q : axes of the base, shape (rows + P, P); K : what the causes do by their priors, shape (rows, rows)
    """
    whole = np.zeros((len(Q), len(Q)))
    whole[: len(K), : len(K)] = K
    whole -= Q @ (Q.T @ whole)
    whole -= (whole @ Q) @ Q.T
    whole[np.diag_indices(len(Q))] += 1.0
    return whole


@dataclass(frozen=True, eq=False)
class Projection:
    """A model at one noise, white and orthogonal to its base; the rows of the priors stand behind those of the blocks.

    y : what is left of the residual, shape (rows,); Q : axes of the base, shape (rows, P)
    log_norm : of the log likelihood, what depends neither on sigma nor on further columns
    """

    whitening: Whitening
    Q: Array
    y: Array
    log_norm: float

    def columns(self, E: Array) -> Array:
        """Columns, shape (n, m, k), as rows: shape (rows, k)."""
        flat = (self.whitening @ E).reshape(-1, E.shape[2])
        out = -self.Q @ (self.Q[: len(flat)].T @ flat)
        out[: len(flat)] += flat
        return np.asarray(out)

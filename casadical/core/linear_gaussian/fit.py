"""Estimates at one noise level: base and some columns fitted to all blocks, or to some of them."""

from functools import cached_property, reduce

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import Combined
from casadical.core.linear_gaussian.model import LinearModel, axes_of_base
from casadical.core.linear_gaussian.noise import covariance_of, whitening_of
from casadical.core.linear_gaussian.normal_equations import NormalSums, normal_sums, root_of_inverse


class Fit:
    """Joint estimate of the base and some columns of a model at one noise level.

    model : linear-Gaussian model of n blocks of m rows
    columns : indices of the columns in the fit, rising
    sigma : standard deviation of the white noise, in the unit of the residual
    ratio : standard deviation of the sources of noise divided by sigma
    combined : the columns, those of complete parts replaced by combinations (see `Combined`); as an
        argument, whether they are replaced
    y : whitened residual, shape (n m,)
    prior, mean : prior standard deviation and mean of every parameter or combination, those of the
        base first, shape (p,); they are as in the model at any sigma
    W : whitening matrix of each block, shape (n, m, m)
    sums : normal sums of the whitened columns and y
    rows_per_block : number m of rows of each block
    """

    def __init__(
        self, model: LinearModel, columns: Array, sigma: float, ratio: float, *, combined: bool = True
    ) -> None:
        self._base, self._E, self._columns = model.J, model.E, columns
        self.rows_per_block, self._memory = model.r.shape[1], model.memory
        self.combined = model.combined(columns) if combined else Combined(((0, len(columns), None),))
        self.W = whitening_of(covariance_of(model.Jq, ratio))[0] / sigma
        self.y = (self.W @ model.r[:, :, None]).ravel()
        self._widths = model.cause_prior_sigmas[columns]
        self.prior = np.concatenate([model.prior, self.combined.per_combination(self._widths)])
        self.mean = np.concatenate([model.delta0, np.zeros(self.combined.width)])
        p = len(self.prior)
        self._cached_columns = np.empty((len(self.y), p)) if 8 * len(self.y) * p <= model.memory.cache_bytes else None
        self.sums = NormalSums(np.zeros((p, p)), np.zeros(p), 0.0, 0)
        for some in self._parts():
            A = self._whitened(some)
            if self._cached_columns is not None:
                self._cached_columns[self._rows_of(some)] = A
            self.sums = self.sums.plus(normal_sums(self.y[self._rows_of(some)], A))

    def _rows(self, blocks: Array) -> Array:
        """Return the indices of the rows of some blocks, shape (len(blocks) m,)."""
        return np.asarray((self.rows_per_block * blocks[:, None] + np.arange(self.rows_per_block)).ravel())

    def _rows_of(self, blocks: slice) -> slice:
        """Return the slice of rows of a slice of blocks."""
        return slice(self.rows_per_block * blocks.start, self.rows_per_block * blocks.stop)

    def _by_block(self, rows: Array) -> Array:
        """Return rows, shape (blocks m,), by block, shape (blocks, m, 1)."""
        return rows.reshape(-1, self.rows_per_block, 1)

    def _parts(self) -> list[slice]:
        """Return slices of blocks by `MemoryLimits.part_bytes`, of 64 blocks or more."""
        step = max(64, self._memory.part_bytes // (24 * len(self.prior)))
        return [slice(k, min(k + step, len(self.W))) for k in range(0, len(self.W), step)]

    def _whitened(self, blocks: Array | slice) -> Array:
        """Compute and return the whitened columns of some blocks, shape (len(blocks) m, p).

        They are those of the base parameters, then those of the causes.
        """
        causes = self._E.take(self._columns, blocks, self.combined)
        A = np.concatenate([self._base[blocks], causes], axis=2)
        return np.asarray((self.W[blocks] @ A).reshape(-1, A.shape[2]))

    def _columns_of(self, blocks: Array | slice) -> Array:
        """Return `_whitened` of some blocks, shape (len(blocks) m, p), cached or computed."""
        if self._cached_columns is None:
            return self._whitened(blocks)
        return np.asarray(
            self._cached_columns[self._rows_of(blocks) if isinstance(blocks, slice) else self._rows(blocks)]
        )

    def _sums_of(self, blocks: Array) -> NormalSums:
        """Return the normal sums of some blocks.

        They are those of all blocks less those of the others if the others are fewer.
        """
        out = np.setdiff1d(np.arange(len(self.W)), blocks)
        fewer = out if len(out) < len(blocks) else blocks
        parts = np.array_split(fewer, 1 + len(fewer) // len(self.prior))
        sums = (normal_sums(self.y[self._rows(some)], self._columns_of(some)) for some in parts)
        total = reduce(NormalSums.plus, sums)
        return self.sums.less(total) if fewer is out else total

    def _solution(self, sums: NormalSums) -> Array:
        """Return the posterior mean of the parameters, shape (p,).

        sums : normal sums of the blocks that count; the prior is added
        """
        normal = sums.H + np.diag(self.prior**-2)
        scale = np.sqrt(np.diag(normal))
        right = (sums.g + self.mean / self.prior**2) / scale
        return np.asarray(np.linalg.solve(normal / np.outer(scale, scale), right) / scale)

    @cached_property
    def root(self) -> Array:
        """Return a root R of the posterior covariance R'R of the parameters, shape (p, p)."""
        return root_of_inverse(self.sums.H + np.diag(self.prior**-2))

    @cached_property
    def _hat_root(self) -> Array | None:
        """Return a root B of the hat matrix B B', shape (n m, p); None without cached columns."""
        return None if self._cached_columns is None else np.asarray(self._cached_columns @ self.root.T)

    @cached_property
    def x(self) -> Array:
        """Return the estimate (posterior mean) from all blocks, shape (p,)."""
        return self._solution(self.sums)

    @cached_property
    def covariance(self) -> Array:
        """Return the posterior covariance of the parameters, shape (p, p)."""
        return np.asarray(self.root.T @ self.root)

    @property
    def causes(self) -> tuple[Array, Array]:
        """Return estimates and standard errors of the parameters of `columns`, in typical sizes.

        Both have the shape (len(columns),); dropped directions add their prior variance.
        """
        first = len(self.prior) - self.combined.width
        directions = self.combined.values(np.eye(self.combined.width))
        variance = ((directions @ self.root.T[first:]) ** 2).sum(axis=1) + self._widths**2 * (
            1 - (directions**2).sum(axis=1)
        )
        return self.combined.values(self.x[first:]), np.sqrt(variance)

    def estimate_from(self, blocks: Array) -> Array:
        """Return the estimate from some blocks only, given by their indices, shape (p,)."""
        return self.x if len(blocks) == len(self.W) else self._solution(self._sums_of(blocks))

    def _whitened_residual_at(self, x: Array) -> Array:
        """Return the whitened residual at parameters x, shape (n m,)."""
        return np.asarray(self.y - np.concatenate([self._columns_of(some) @ x for some in self._parts()]))

    def residual(self, x: Array) -> Array:
        """Return the residual, not whitened, of every block at parameters x, (p,), shape (n, m)."""
        return np.asarray(np.linalg.solve(self.W, self._by_block(self._whitened_residual_at(x)))[:, :, 0])

    def mahalanobis_squared(self, x: Array, spread: Array) -> Array:
        """Return the squared Mahalanobis distance of each block's residual, shape (n,).

        x : parameters, shape (p,)
        spread : covariance of each block's whitened residual, shape (n, m, m)
        """
        whitened = self._by_block(self._whitened_residual_at(x))
        return np.asarray((whitened * np.linalg.solve(spread, whitened)).sum(axis=(1, 2)))

    def leverage(self, blocks: Array) -> Array:
        """Return the covariance of each block's whitened prediction, shape (n, m, m).

        It is by a fit to `blocks` alone; by a fit to all blocks it is the leverage, the diagonal
        blocks of the hat matrix.

        blocks : indices of the blocks in the fit
        """
        if len(blocks) == len(self.W):
            root = self.root
        else:
            root = root_of_inverse(self._sums_of(blocks).H + np.diag(self.prior**-2))
        return np.concatenate(
            [_blocks((self._columns_of(s) @ root.T).reshape(-1, self.rows_per_block, len(root))) for s in self._parts()]
        )

    @cached_property
    def _residual_maker(self) -> Array | None:
        """Return the residual maker, shape (n m, n m), of a fit with fewer rows than parameters.

        None is returned for more rows, also than `MemoryLimits.max_observation_rows`, and without
        cached columns.
        """
        rows, p = len(self.y), len(self.prior)
        if rows > min(p, self._memory.max_observation_rows) or self._cached_columns is None:
            return None
        first = p - self.combined.width
        Q, _ = axes_of_base(self._cached_columns[:, :first], 1 / self.prior[:first])
        wide = self._cached_columns[:, first:] * self.prior[first:]
        # Prior covariance by the causes, projected orthogonally to the base, plus that of the noise.
        covariance = np.zeros((len(Q), len(Q)))
        covariance[: len(wide), : len(wide)] = wide @ wide.T
        covariance -= Q @ (Q.T @ covariance)
        covariance -= (covariance @ Q) @ Q.T
        covariance[np.diag_indices(len(Q))] += 1.0
        return np.asarray((np.linalg.inv(covariance) - Q @ Q.T)[:rows, :rows])

    @cached_property
    def _residual_of_prior_mean(self) -> Array:
        """Return the whitened residual at the prior mean, shape (n m,)."""
        return self._whitened_residual_at(self.mean)

    @cached_property
    def whitened_residual(self) -> Array:
        """Return the whitened residual of the fit to all blocks, shape (n m,)."""
        return self._whitened_residual_at(self.x)

    def residual_without(self, blocks: Array) -> Array:
        """Return the residual of some blocks for a fit to all others, shape (len(blocks), m).

        It is not whitened.
        """
        rows = self._rows(blocks)
        maker = self._residual_maker
        if maker is not None:  # the deletion formula in the space of observations
            residual = np.linalg.solve(maker[np.ix_(rows, rows)], maker[rows] @ self._residual_of_prior_mean)
        elif len(rows) < len(self.prior) and self._hat_root is not None:
            B = self._hat_root[rows]
            residual = np.linalg.solve(np.eye(len(rows)) - B @ B.T, self.whitened_residual[rows])
        else:
            A, y = self._columns_of(blocks), self.y[rows]
            residual = y - A @ self._solution(self.sums.less(normal_sums(y, A)))
        return np.asarray(np.linalg.solve(self.W[blocks], self._by_block(residual))[:, :, 0])

    def leave_one_out_residuals(self) -> Array:
        """Return the residual, not whitened, of each block by a fit to all others, shape (n, m)."""
        if self._residual_maker is not None:
            return np.concatenate([self.residual_without(np.array([k])) for k in range(len(self.W))])
        leverage = self.leverage(np.arange(len(self.W)))
        residual = np.linalg.solve(np.eye(self.rows_per_block) - leverage, self._by_block(self.whitened_residual))
        return np.asarray(np.linalg.solve(self.W, residual)[:, :, 0])


def _blocks(B: Array) -> Array:
    """Return the diagonal blocks of B B', shape (n, m, m); B : shape (n, m, p)."""
    return np.asarray(B @ B.transpose(0, 2, 1))

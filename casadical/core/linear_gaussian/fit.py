"""Estimates at one noise: base and some columns fitted together to the blocks, and to all but some of them."""

from collections.abc import Mapping
from functools import cached_property, reduce

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import Combined
from casadical.core.linear_gaussian.model import LinearModel, axes_of_base
from casadical.core.linear_gaussian.noise import Ratio
from casadical.core.linear_gaussian.normal_equations import NormalSums, normal_sums, root_of_inverse


class Fit:
    """Base and some columns of a model, estimated at one noise.

    columns : that are in it, in rising order; combined : with combinations for those of parts (see `columns`)
    y : residual made white, shape (n m,); prior, mean : of every parameter or combination, shape (p,)
    W : what makes each block white, shape (n, m, m)
    sums : of the white columns and y
    """

    def __init__(
        self, model: LinearModel, columns: Array, sigma: float, ratios: Mapping[str, Ratio], *, combined: bool = True
    ) -> None:
        self._base, self._E, self._columns = model.J, model.E, columns
        self.numbers, self._memory = model.r.shape[1], model.memory
        self.combined = model.combined(columns) if combined else Combined(((0, len(columns), None),))
        self.W = model.noise.whitening(ratios).W / sigma
        self.y = (self.W @ model.r[:, :, None]).ravel()
        self._widths = model.widths[columns]
        self.prior = np.concatenate([model.prior, self.combined.one_of_each(self._widths)])
        self.mean = np.concatenate([model.delta0, np.zeros(self.combined.width)])
        p = len(self.prior)
        self._kept = np.empty((len(self.y), p)) if 8 * len(self.y) * p <= model.memory.kept else None
        self.sums = NormalSums(np.zeros((p, p)), np.zeros(p), 0.0, 0)
        for some in self._parts():
            A = self._white(some)
            if self._kept is not None:
                self._kept[self._rows_of(some)] = A
            self.sums = self.sums.plus(normal_sums(self.y[self._rows_of(some)], A))

    def _rows(self, blocks: Array) -> Array:
        return np.asarray((self.numbers * blocks[:, None] + np.arange(self.numbers)).ravel())

    def _rows_of(self, blocks: slice) -> slice:
        return slice(self.numbers * blocks.start, self.numbers * blocks.stop)

    def _by_block(self, rows: Array) -> Array:
        """Rows as columns of numbers, shape (blocks, numbers, 1)."""
        return rows.reshape(-1, self.numbers, 1)

    def _parts(self) -> list[slice]:
        """The blocks in parts whose columns take little memory."""
        step = max(64, self._memory.part // (24 * len(self.prior)))
        return [slice(k, min(k + step, len(self.W))) for k in range(0, len(self.W), step)]

    def _white(self, blocks: Array | slice) -> Array:
        """Columns of some blocks made white, shape (blocks m, p)."""
        causes = self._E.take(self._columns, blocks, self.combined)
        A = np.concatenate([self._base[blocks], causes], axis=2)
        return np.asarray((self.W[blocks] @ A).reshape(-1, A.shape[2]))

    def _columns_of(self, blocks: Array | slice) -> Array:
        if self._kept is None:
            return self._white(blocks)
        return np.asarray(self._kept[self._rows_of(blocks) if isinstance(blocks, slice) else self._rows(blocks)])

    def _sums_of(self, blocks: Array) -> NormalSums:
        """Sums of some blocks alone: theirs, or those of all less the others', whichever are fewer."""
        out = np.setdiff1d(np.arange(len(self.W)), blocks)
        fewer = out if len(out) < len(blocks) else blocks
        parts = np.array_split(fewer, 1 + len(fewer) // len(self.prior))
        sums = (normal_sums(self.y[self._rows(some)], self._columns_of(some)) for some in parts)
        total = reduce(NormalSums.plus, sums)
        return self.sums.less(total) if fewer is out else total

    def _solution(self, sums: NormalSums) -> Array:
        normal = sums.H + np.diag(self.prior**-2)
        scale = np.sqrt(np.diag(normal))
        right = (sums.g + self.mean / self.prior**2) / scale
        return np.asarray(np.linalg.solve(normal / np.outer(scale, scale), right) / scale)

    @cached_property
    def root(self) -> Array:
        """Root of the inverse of the normal matrix, shape (p, p)."""
        return root_of_inverse(self.sums.H + np.diag(self.prior**-2))

    @cached_property
    def _pulled(self) -> Array | None:
        """Columns in which the inverse of the normal matrix is one, shape (n m, p); None if they are not kept."""
        return None if self._kept is None else np.asarray(self._kept @ self.root.T)

    @cached_property
    def x(self) -> Array:
        return self._solution(self.sums)

    @cached_property
    def covariance(self) -> Array:
        return np.asarray(self.root.T @ self.root)

    @property
    def causes(self) -> tuple[Array, Array]:
        """Values and standard errors of the causes' parameters, in sizes, shapes (columns,)."""
        first = len(self.prior) - self.combined.width
        known = self.combined.values(np.eye(self.combined.width))
        variance = ((known @ self.root.T[first:]) ** 2).sum(axis=1) + self._widths**2 * (1 - (known**2).sum(axis=1))
        return self.combined.values(self.x[first:]), np.sqrt(variance)

    def to(self, blocks: Array) -> Array:
        """Fit to some blocks alone, given by their numbers, shape (p,)."""
        return self.x if len(blocks) == len(self.W) else self._solution(self._sums_of(blocks))

    def _left(self, x: Array) -> Array:
        """What a fit leaves, white, shape (n m,)."""
        return np.asarray(self.y - np.concatenate([self._columns_of(some) @ x for some in self._parts()]))

    def left(self, x: Array) -> Array:
        """What a fit leaves at every block, shape (n, m); x : its parameters, shape (p,)."""
        return np.asarray(np.linalg.solve(self.W, self._by_block(self._left(x)))[:, :, 0])

    def distance(self, x: Array, spread: Array) -> Array:
        """Squared Mahalanobis distance of what a fit leaves at each block, shape (n,); spread : shape (n, m, m)."""
        white = self._by_block(self._left(x))
        return np.asarray((white * np.linalg.solve(spread, white)).sum(axis=(1, 2)))

    def pull(self, blocks: Array) -> Array:
        """Covariance of the fit to some blocks at each block, in units of its noise, shape (n, m, m)."""
        if len(blocks) == len(self.W):
            if self._pulled is not None:
                return _blocks(self._pulled.reshape(len(self.W), self.numbers, -1))
            root = self.root
        else:
            root = root_of_inverse(self._sums_of(blocks).H + np.diag(self.prior**-2))
        return np.concatenate(
            [_blocks((self._columns_of(s) @ root.T).reshape(-1, self.numbers, len(root))) for s in self._parts()]
        )

    @cached_property
    def _left_of(self) -> Array | None:
        """What takes observations to what a fit to all leaves of them, shape (n m, n m); None for too many blocks."""
        rows, p = len(self.y), len(self.prior)
        if rows > self._memory.rows or self._kept is None:
            return None
        if rows > p and self._pulled is not None:
            return np.asarray(np.eye(rows) - self._pulled @ self._pulled.T)
        first = p - self.combined.width
        Q, _ = axes_of_base(self._kept[:, :first], 1 / self.prior[:first])
        wide = self._kept[:, first:] * self.prior[first:]
        return np.asarray((np.linalg.inv(beside_base(Q, wide @ wide.T)) - Q @ Q.T)[:rows, :rows])

    @cached_property
    def _missed(self) -> Array:
        """What the priors' mean leaves, white, shape (n m,)."""
        return self._left(self.mean)

    @cached_property
    def rest(self) -> Array:
        """What the fit to all blocks leaves, white, shape (n m,)."""
        return self._left(self.x)

    def without(self, blocks: Array) -> Array:
        """What is left at some blocks by a fit to all others, shape (len(blocks), m)."""
        rows = self._rows(blocks)
        whole = self._left_of
        if whole is not None:  # what all blocks leave, freed of these blocks' own pull on the fit
            left = np.linalg.solve(whole[np.ix_(rows, rows)], whole[rows] @ self._missed)
        elif len(rows) < len(self.prior) and self._pulled is not None:
            B = self._pulled[rows]
            left = np.linalg.solve(np.eye(len(rows)) - B @ B.T, self.rest[rows])
        else:
            A, y = self._columns_of(blocks), self.y[rows]
            left = y - A @ self._solution(self.sums.less(normal_sums(y, A)))
        return np.asarray(np.linalg.solve(self.W[blocks], self._by_block(left))[:, :, 0])

    def alone(self) -> Array:
        """What is left at each block by a fit to all others, shape (n, m)."""
        if self._left_of is not None:
            return np.concatenate([self.without(np.array([k])) for k in range(len(self.W))])
        pull = self.pull(np.arange(len(self.W)))
        left = np.linalg.solve(np.eye(self.numbers) - pull, self._by_block(self.rest))
        return np.asarray(np.linalg.solve(self.W, left)[:, :, 0])


def _blocks(B: Array) -> Array:
    """Each block's own block of B B', shape (n, m, m); B : shape (n, m, p)."""
    return np.asarray(B @ B.transpose(0, 2, 1))


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

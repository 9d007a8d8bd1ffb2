"""Gram matrices of the whitened columns for the evaluated points of the noise grid.

In the axes of a block's noise its whitening is a weight for each of its rows (see `noise.Axes`), so
that columns are rotated once and weighted for each point. Products are accumulated some blocks at a
time and when they are asked for, so that memory does not grow with blocks times columns. When
blocks become outliers or inliers, their sums are subtracted or added.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import WHOLE_AXIS, Columns, Factors, as_slice, combined
from casadical.core.linear_gaussian.model import LinearModel
from casadical.core.linear_gaussian.noise import Axes, axes_of

# Largest number of columns of a narrow group. The Gram matrices of narrow groups are accumulated
# together at all grid points, those of wider ones one by one.
MAX_NARROW_GROUP_COLUMNS = 64


class GridSums:
    """Whitened Gram matrices of base, residual and columns at the points `LinearModel.near`.

    Whitening is for sigma = 1.

    E : columns of the candidates; shape : numbers of blocks and of rows of each
    near : indices of the grid points, which are the axis "points" of the arrays
    base : Gram matrix of the P base columns and the residual, in this order, shape (points, P + 1,
        P + 1)
    log_det : log determinant of the noise covariance of all blocks in units of sigma^2, shape
        (points,)
    """

    def __init__(self, model: LinearModel, same: GridSums | None = None) -> None:
        """Accumulate the sums of base and residual, or take over the `same` of another model.

        same : sums of a model with the same blocks and base, evaluated at these points or more
        """
        self.E, self.shape, self._memory = model.E, model.r.shape, model.memory
        self.near = model.near
        self._given, width = (model.J, model.r[:, :, None]), model.J.shape[2] + 1
        if same:
            places = [same.near.index(k) for k in self.near]
            self._axes: Axes = same._axes.at(places)
            self.base: Array = same.base[places]
        else:
            self._axes = axes_of(model.Jq, model.ratios[[*self.near]])
            self.base = np.zeros((len(self.near), width, width))
            for blocks in self._slices(width):
                rotated = self._rotated_base(blocks)
                for total, precision in zip(self.base, self._axes.precision, strict=True):
                    white = (rotated * np.sqrt(precision[blocks, :, None])).reshape(-1, width)
                    total += white.T @ white
        self.log_det = self._axes.log_det
        self._own: dict[bytes, Array] = {}
        self._wide: dict[tuple[bytes, int], Array] = {}
        self._cross: dict[tuple[int, int, int], CachedRows] = {}

    def _rotated_base(self, blocks: slice) -> Array:
        """Return base columns and residual of some blocks in the eigenbasis, (blocks, m, P + 1)."""
        return self._axes.rotated(np.concatenate([rows[blocks] for rows in self._given], axis=2), blocks)

    @cached_property
    def columns(self) -> list[CachedRows]:
        """Return whitened products of all columns with the P base columns and with the residual.

        There is a cache of rows of P + 1 numbers, the residual's last, for each grid point.
        """
        made = [CachedRows(self.E.shape[2], self.base.shape[1]) for _ in self.near]
        self._add_products_with_base(made, np.arange(self.E.shape[2]), self.E)
        return made

    def extend(self, other: GridSums) -> None:
        """Take over the cached sums of a model with the same blocks and the first of these columns.

        Products of the additional columns with base and residual are computed, too.

        other : sums at these grid points or more
        """
        width, places = other.E.shape[2], [other.near.index(k) for k in self.near]
        same = self.near == other.near
        self._own = dict(other._own) if same else {k: own[places] for k, own in other._own.items()}
        self._wide = {key: own for key, own in other._wide.items() if key[1] in self.near}
        cross = {key: rows for key, rows in other._cross.items() if key[2] in self.near}
        self._cross = {key: rows.widened(self.E.shape[2]) for key, rows in cross.items()}
        self.columns = [other.columns[i].widened(self.E.shape[2]) for i in places]
        if self.E.shape[2] > width:
            more = np.arange(width, self.E.shape[2])
            self._add_products_with_base(self.columns, more, self.E.only(more))

    def move(self, other: GridSums, lost: GridSums, gained: GridSums) -> None:
        """Take over the cached sums of a model with other blocks, at the same grid points.

        The sums of the lost blocks are subtracted, those of the gained ones added.
        """
        parts = [(sign, part) for sign, part in ((-1.0, lost), (1.0, gained)) if part.shape[0]]
        every = np.arange(self.E.shape[2])
        self.columns = [CachedRows(len(every), rows.numbers) for rows in other.columns]
        for i, rows in enumerate(self.columns):
            changes = (sign * part.columns[i][every] for sign, part in parts)
            rows.add(every, other.columns[i][every] + sum(changes))
        groups = [np.frombuffer(key, dtype=np.int64) for key in other._own]
        for _, part in parts:
            part.gram_matrices(groups)
        self._own = {k: own + sum(sign * part._own[k] for sign, part in parts) for k, own in other._own.items()}
        for (key, k), own in other._wide.items():
            group = np.frombuffer(key, dtype=np.int64)
            self._wide[key, k] = own + sum(sign * part.wide_gram_matrix(group, k) for sign, part in parts)
        runs_by_columns: dict[tuple[bytes, int], list[Array]] = {}
        for (first, last, k), cross in other._cross.items():
            runs_by_columns.setdefault((np.flatnonzero(cross.place >= 0).tobytes(), k), []).append(
                np.arange(first, last + 1)
            )
        for (key, k), runs in runs_by_columns.items():
            at = np.frombuffer(key, dtype=np.int64)
            for _, part in parts:
                part.add_cross_products(runs, [k], at)
            for run in runs:
                cross = other._cross[_key(run, k)]
                self._cross[_key(run, k)] = more = CachedRows(len(cross.place), cross.numbers)
                more.add(at, cross[at] + sum(sign * part._cross[_key(run, k)][at] for sign, part in parts))

    def gram_matrices(self, groups: Iterable[Array]) -> dict[bytes, Array]:
        """Return the Gram matrices of all narrow groups so far, by the bytes of their indices.

        Each has the shape (points, width, width); new ones come from one pass over the blocks.

        groups : indices of the columns of each group, rising; wider groups are ignored
        """
        new = {g.tobytes(): g for g in groups if len(g) <= MAX_NARROW_GROUP_COLUMNS and g.tobytes() not in self._own}
        by_width: dict[int, list[Array]] = {}
        for g in new.values():
            by_width.setdefault(len(g), []).append(g)
        if not new:
            return self._own
        stacks = {w: np.stack(gs) for w, gs in by_width.items()}
        totals = {w: np.zeros((len(self.near), len(s), w, w)) for w, s in stacks.items()}
        used = np.unique(np.concatenate([which.ravel() for which in stacks.values()]))
        E = self.E.only(used)
        for blocks in self._slices(3 * E.shape[2]):  # of copies of the columns
            F, levers = E.factors(blocks), E.levers(blocks)
            for rows, columns, by_column in _by_rows(F, self._axes.rotated(levers, blocks)):
                weights = self._axes.precision[:, blocks, rows].transpose(0, 2, 1).reshape(len(self.near), -1)
                place = np.full(len(used), len(columns))  # the index past the last column is a column of zeros
                place[columns] = np.arange(len(columns))
                for w, which in stacks.items():
                    there = place[np.searchsorted(used, which)]
                    acts = np.flatnonzero((there < len(columns)).any(axis=1))
                    part = by_column[there[acts]]
                    for total, weight in zip(totals[w], weights, strict=True):
                        scaled = part * np.sqrt(weight)
                        total[acts] += scaled @ scaled.transpose(0, 2, 1)
        for w, which in stacks.items():
            for i, g in enumerate(which):
                self._own[g.tobytes()] = totals[w][:, i]
        return self._own

    def wide_gram_matrix(self, group: Array, k: int) -> Array:
        """Return the Gram matrix of a wide group's combinations at one point, (width, width).

        group : indices of its columns, rising; k : index of the grid point
        """
        key = group.tobytes(), k
        if key not in self._wide:
            E, every = self.E.only(group), combined(group, self.E.directions)
            total = np.zeros((every.width, 1, every.width))
            for blocks in self._slices(E.shape[2]):
                F = E.factors(blocks).combined(every)
                self._add_products(total, F, F, E.levers(blocks), blocks, [k])
            self._wide[key] = total[:, 0]
        return self._wide[key]

    def widest_cached_group(self, columns: Array) -> Array:
        """Return the columns of the widest wide group among some with a cached Gram matrix.

        It is empty if there is none.

        columns : indices of the columns
        """
        groups = [np.frombuffer(key, dtype=np.int64) for key, _ in self._wide]
        return max((g for g in groups if np.isin(g, columns).all()), key=len, default=columns[:0])

    def runs(self, columns: Array) -> list[Array]:
        """Return runs of consecutive indices, split where those with cached products begin or end.

        columns : indices of the columns, rising
        """
        firsts, lasts = ([key[k] for key in self._cross] for k in (0, 1))
        apart = (np.diff(columns) != 1) | np.isin(columns[1:], firsts) | np.isin(columns[:-1], lasts)
        return np.split(columns, np.flatnonzero(apart) + 1)

    def cross_products(self, runs: Sequence[Array], k: int, wanted: Array) -> Array:
        """Return whitened products of columns with combinations of others, shape (wanted, width).

        runs : indices of the others, as they were added by `add_cross_products`
        k : index of the grid point; wanted : indices of the columns, in any order
        """
        return np.concatenate([self._cross[_key(run, k)][wanted] for run in runs], axis=1)

    def add_cross_products(self, runs: Sequence[Array], points: Sequence[int], wanted: Array) -> None:
        """Accumulate and cache the products of wanted columns with runs of columns.

        Runs that lack the same columns are accumulated in one pass over the blocks.

        runs : consecutive indices of the columns of each run, rising; no two runs overlap
        points : indices of the grid points
        wanted : indices of the columns, rising
        """
        lacking: dict[bytes, tuple[Array, list[Array]]] = {}
        for run in runs:
            for k in points:
                if (key := _key(run, k)) not in self._cross:
                    every = combined(run, self.E.directions)
                    self._cross[key] = cached = CachedRows(self.E.shape[2], every.width)
                    if len(run) > MAX_NARROW_GROUP_COLUMNS:
                        cached.add(run, every.values(self.wide_gram_matrix(run, k)))
            unknown = np.max([self._cross[_key(run, k)].place[wanted] < 0 for k in points], axis=0)
            if unknown.any():
                lacking.setdefault(unknown.tobytes(), (wanted[unknown], []))[1].append(run)
        for new, some in lacking.values():
            self._accumulate_cross_products(sorted(some, key=lambda run: int(run[0])), new, points)

    def _accumulate_cross_products(self, runs: Sequence[Array], new: Array, points: Sequence[int]) -> None:
        """Accumulate and cache whitened products of new columns with runs of columns, in one pass.

        runs : indices of the columns of each run; new : indices of the new columns
        points : indices of the grid points
        """
        columns = np.concatenate(runs)
        E, R, every = self.E.only(new), self.E.only(columns), combined(columns, self.E.directions)
        edges = np.cumsum([0, *(combined(run, self.E.directions).width for run in runs)])
        total = np.zeros((E.shape[2], len(points), every.width))
        for blocks in self._slices(max(every.width * len(points), E.shape[2])):
            G = R.factors(blocks).combined(every)
            self._add_products(total, E.factors(blocks), G, E.levers(blocks), blocks, points)
        for run, start, end in zip(runs, edges[:-1], edges[1:], strict=True):
            for i, k in enumerate(points):
                self._cross[_key(run, k)].add(new, total[:, i, start:end])

    def _add_products_with_base(self, made: list[CachedRows], indices: Array, E: Columns) -> None:
        """Add the products of some columns E, of these indices, to `columns`."""
        numbers = self.base.shape[1]
        total = np.zeros((E.shape[2], len(self.near), numbers))
        for blocks in self._slices(E.shape[2]):
            F, levers = E.factors(blocks), E.levers(blocks)
            rotated, U = self._rotated_base(blocks), self._axes.rotated(levers, blocks)
            diagonal = _has_diagonal_levers(U)
            precision = self._axes.precision[:, blocks].transpose(1, 0, 2)
            for s, columns, values in F.blocks:
                # Weighted products of this variable's lever with the base columns, at each point.
                rows = slice(s, s + 1) if diagonal else WHOLE_AXIS
                across = (precision[:, :, rows] * U[:, None, rows, s]) @ rotated[:, rows]
                product = values @ across.reshape(len(U), -1)
                total[as_slice(columns)] += product.reshape(len(values), -1, numbers)
        for cached, own in zip(made, total.transpose(1, 0, 2), strict=True):
            cached.add(indices, own)

    def _add_products(
        self, total: Array, F: Factors, G: Factors, levers: Array, blocks: slice, points: Sequence[int]
    ) -> None:
        """Add whitened products of columns F and G at some blocks to `total`.

        total : shape (columns of F, points, columns of G)
        levers : derivatives of the rows by the intermediate variables, shape (blocks, m, variables)
        points : indices of the grid points
        """
        weight = self._axes.precision[[self.near.index(k) for k in points], blocks]
        _add_weighted(total, F, G, self._axes.rotated(levers, blocks), weight)

    def _slices(self, width: int) -> Iterator[slice]:
        """Return slices of all blocks by `column_bytes` for `width` columns, or `min_blocks`."""
        blocks, m = self.shape
        step = max(self._memory.min_blocks, self._memory.column_bytes // (8 * m * max(width, 1)))
        return (slice(first, min(first + step, blocks)) for first in range(0, blocks, step))


def _key(run: Array, k: int) -> tuple[int, int, int]:
    """Return the cache key of products with a run of columns: first and last index, and point."""
    return int(run[0]), int(run[-1]), k


def _has_diagonal_levers(U: Array) -> bool:
    """Return whether each intermediate variable changes its own row only.

    U : derivatives of the rows by the variables, shape (blocks, m, variables)
    """
    return U.shape[1] == U.shape[2] and not U[:, ~np.eye(U.shape[1], dtype=bool)].any()


def _by_rows(F: Factors, U: Array) -> Iterator[tuple[slice, Array, Array]]:
    """Yield a slice of rows, the indices of the columns that change these rows, and the columns.

    The columns have the shape (columns + 1, rows blocks); the last of them is zero.

    F : factors of the columns; U : derivatives of the rows by the intermediate variables, shape
        (blocks, m, variables)
    """
    if not _has_diagonal_levers(U):
        yield WHOLE_AXIS, np.arange(F.width), F.by_column(U).reshape(F.width + 1, -1)
        return
    for s, columns, values in F.blocks:
        yield slice(s, s + 1), columns, np.concatenate([values * U[:, s, s], np.zeros((1, len(U)))])


def _add_weighted(total: Array, F: Factors, G: Factors, U: Array, weight: Array) -> None:
    """Add weighted products of columns F and G to `total`.

    total : shape (columns of F, points, columns of G)
    U : derivatives of the rows by the intermediate variables, in the eigenbasis, shape (n, m,
        variables)
    weight : precision of each eigenvector, shape (points, n, m)
    """
    W, V = weight.transpose(0, 2, 1), np.ascontiguousarray(U[:, :, [t for t, _, _ in G.blocks]].transpose(2, 1, 0))
    others = [(as_slice(own), factors) for _, own, factors in G.blocks]
    K, n = len(weight), len(U)
    across = np.empty((K, G.width, n))
    for s, columns, values in F.blocks:
        # Weighted products of the levers, multiplied first by the fewer: the factors of F or those
        # of G.
        shares = np.einsum("kin,tin->tkn", W * U[:, :, s].T, V)
        if len(values) * len(others) < G.width:
            product = np.zeros((len(values), K, G.width))
            for share, (own, factors) in zip(shares, others, strict=True):
                own_product = (values[:, None] * share).reshape(-1, n) @ factors.T
                product[:, :, own] += own_product.reshape(len(values), K, -1)
        else:
            across[:] = 0
            for share, (own, factors) in zip(shares, others, strict=True):
                across[:, own] += share[:, None] * factors
            product = (values @ across.reshape(-1, n).T).reshape(len(values), K, G.width)
        total[as_slice(columns)] += product


class CachedRows:
    """Cache of rows of numbers for those columns for which they were computed.

    columns : number of all columns
    place : index of each column's row in the cache, or -1, shape (columns,)
    numbers : length of a row

    The rows stay in the arrays in which they were added, which caches of more columns share.
    """

    def __init__(self, columns: int, numbers: int) -> None:
        self.place, self.numbers = np.full(columns, -1), numbers
        self._parts: list[Array] = []
        # The index of the first row of each part, then the number of rows.
        self._starts = np.zeros(1, dtype=np.int64)

    def __getitem__(self, columns: Array) -> Array:
        """Return the cached rows of columns of these indices, shape (*columns.shape, numbers).

        Raises KeyError for one that is not cached.
        """
        place = self.place[columns]
        if place.size and place.min() < 0:
            raise KeyError(f"columns {columns[place < 0]} were not added up")
        if len(self._parts) == 1:
            return np.asarray(self._parts[0][place])
        rows = np.empty((*place.shape, self.numbers))
        part_of = np.searchsorted(self._starts, place, side="right") - 1
        for k in np.unique(part_of).tolist():
            own = part_of == k
            rows[own] = self._parts[k][place[own] - self._starts[k]]
        return rows

    def add(self, columns: Array, rows: Array) -> None:
        """Add the rows, not copied, (k, numbers), of k columns, none of which is cached yet."""
        if len(rows):
            self._parts.append(rows)
            self._starts = np.append(self._starts, self._starts[-1] + len(rows))
            self.place[columns] = np.arange(*self._starts[-2:])

    def widened(self, columns: int) -> CachedRows:
        """Return a cache for `columns` columns, at least as many, with the same rows."""
        more = CachedRows(columns, self.numbers)
        more.place[: len(self.place)] = self.place
        more._parts, more._starts = list(self._parts), self._starts
        return more

"""Columns of a linear model, computed some blocks at a time, and combinations of their columns.

A column may be given by the chain rule: the derivative of the rows with respect to an intermediate
variable (the lever, common to all columns) times the derivative of that variable with respect to
the column's parameter, one factor a block. Products of thousands of columns are then products of
factors.

The columns of one part of an effect have one prior standard deviation, so that orthonormal
combinations of them are as independent a priori as the columns. Combinations that change no row are
dropped: their posterior is their prior.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.noise import SerialNoise

# Slice of all elements along an array axis.
WHOLE_AXIS = slice(None)

# For each part of an effect the indices of its columns, consecutive, and the orthonormal directions
# among them that change the rows, shape (columns, k).
Directions = Sequence[tuple[Array, Array]]


@dataclass(frozen=True)
class MemoryLimits:
    """Limits on memory; results depend on them by rounding only.

    column_bytes : largest size of the columns that are accumulated at a time [bytes]
    min_blocks : number of blocks that are accumulated at a time even if they take more bytes
    cache_bytes : largest size of the whitened columns of a fit that are cached [bytes]; larger ones
        are computed again when they are needed
    part_bytes : size of the whitened columns of a fit that are computed at a time [bytes], for
        blocks of three rows; at least 64 blocks are
    max_observation_rows : largest number of rows at which residuals of excluded blocks are computed
        in the space of observations instead of parameters
    """

    column_bytes: int = 96_000_000
    min_blocks: int = 256
    cache_bytes: int = 60_000_000
    part_bytes: int = 16_000_000
    max_observation_rows: int = 1500


class Columns:
    """Columns E of n blocks of m rows, computed when they are asked for.

    shape : numbers of blocks, of rows of each block and of columns
    block : returns the factors of some columns (rising indices; None for all) at some blocks
    levers : returns the rows' derivatives by the intermediate variables at some blocks, shape
        (blocks, m, variables)
    directions : of the parts whose columns are combined
    """

    def __init__(
        self,
        shape: tuple[int, int, int],
        block: Callable[[Array | None, Array | slice], Factors],
        levers: Callable[[Array | slice], Array],
        directions: Directions = (),
    ) -> None:
        self._given = shape, block, levers, directions

    @property
    def shape(self) -> tuple[int, int, int]:
        """Return the numbers of blocks, of rows of each block and of columns."""
        return self._given[0]

    @property
    def directions(self) -> Directions:
        """Return the directions of the parts whose columns are combined."""
        return self._given[3]

    def factors(self, blocks: Array | slice = WHOLE_AXIS, columns: Array | None = None) -> Factors:
        """Return columns, all by default, at some blocks as factors of intermediate variables."""
        return self._given[1](columns, blocks)

    def levers(self, blocks: Array | slice = WHOLE_AXIS) -> Array:
        """Return the rows' derivatives by the intermediate variables, (blocks, m, variables)."""
        return self._given[2](blocks)

    def at(self, blocks: Array) -> Columns:
        """Return the same columns at some of the blocks."""
        chosen = np.arange(self.shape[0])[blocks]

        def block(columns: Array | None, some: Array | slice) -> Factors:
            return self.factors(chosen[some], columns)

        return Columns((len(chosen), *self.shape[1:]), block, lambda s: self.levers(chosen[s]), self.directions)

    def only(self, columns: Array) -> Columns:
        """Return columns of these rising indices, all or none of a cause, without directions."""

        def block(some: Array | None, blocks: Array | slice) -> Factors:
            return self.factors(blocks, columns if some is None else columns[some])

        return Columns((*self.shape[:2], len(columns)), block, self.levers)

    def take(self, columns: Array, blocks: Array | slice = WHOLE_AXIS, every: Combined | None = None) -> Array:
        """Return the columns of some indices at some blocks, shape (blocks, m, len(columns)).

        every : combinations of these columns that are returned instead; None: the columns
        """
        factors = self.factors(blocks, columns)
        return (factors.combined(every) if every else factors).columns_at(self.levers(blocks))


def factor_columns(made: Factors, levers: Array, directions: Directions = ()) -> Columns:
    """Return columns with factors `made` of the intermediate variables.

    levers : derivatives of the rows by the variables, shape (n, m, variables)
    """

    def block(columns: Array | None, some: Array | slice) -> Factors:
        """Return the factors of some columns, or of all if `columns` is None, at some blocks."""
        if columns is None:
            return made.at(some)
        # A slice of the blocks is a view; other blocks are copied, so that columns are chosen first.
        return made.at(some).only(columns) if isinstance(some, slice) else made.only(columns).at(some)

    return Columns((*levers.shape[:2], made.width), block, levers.__getitem__, directions)


def array_columns(values: Array, directions: Directions = ()) -> Columns:
    """Return columns that are given as an array, shape (n, m, columns)."""
    n, m, width = values.shape
    made = Factors(tuple((i, np.arange(width), values[:, i].T) for i in range(m)), width)
    return factor_columns(made, np.broadcast_to(np.eye(m), (n, m, m)), directions)


def serial_columns(E: Columns, order: Array, noise: SerialNoise) -> Columns:
    """Return columns whitened for autocorrelated noise.

    order : index of each block of E in time order, shape (n,); noise : of the blocks in that order
    The variables are those of a block and, of autocorrelated noise, those of the block before it.
    """
    variables = E.levers(order[:1]).shape[2]
    weight = noise.weight.reshape(len(order), -1, 1)

    def block(columns: Array | None, some: Array | slice) -> Factors:
        """Return the factors of some columns for the variables of a block and of the one before."""
        here = np.arange(len(order))[some]
        own = E.factors(order[here], columns)
        if not noise.is_autocorrelated:
            return own
        before = E.factors(order[np.maximum(here - 1, 0)], columns)
        return Factors((*own.blocks, *((s + variables, c, values) for s, c, values in before.blocks)), own.width)

    def levers(some: Array | slice) -> Array:
        """Return the derivatives of whitened rows by these variables, (blocks, rows, variables)."""
        here = np.arange(len(order))[some]
        own = weight[here] * E.levers(order[here])
        if not noise.is_autocorrelated:
            return np.asarray(own)
        before = noise.ar_coefficient[here, None, None] * weight[here] * E.levers(order[np.maximum(here - 1, 0)])
        return np.concatenate([own, -before], axis=2)

    return Columns((len(order), *E.shape[1:]), block, levers, E.directions)


@dataclass(frozen=True, eq=False)
class Factors:
    """Columns by the chain rule: derivatives of intermediate variables by the parameters.

    The column of a parameter at a block is the sum over the variables of the rows' derivative by
    the variable (its lever) times the variable's derivative by the parameter (the factor).

    blocks : for each variable its index, the indices of the columns that act through it, at most
        once each, and their factors, shape (columns, n)
    width : number of columns
    """

    blocks: tuple[tuple[int, Array, Array], ...]
    width: int

    def columns_at(self, levers: Array) -> Array:
        """Return the columns, shape (n, m, columns).

        levers : derivatives of the rows by the intermediate variables, shape (n, m, variables)
        """
        return np.ascontiguousarray(self.by_column(levers)[:-1].transpose(2, 1, 0))

    def by_column(self, levers: Array) -> Array:
        """Return the columns and a last one of zeros, shape (columns + 1, m, n).

        levers : derivatives of the rows by the intermediate variables, shape (n, m, variables)
        """
        n, m, _ = levers.shape
        out, by_variable = np.zeros((self.width + 1, m, n)), np.ascontiguousarray(levers.transpose(2, 1, 0))
        for variable, columns, values in self.blocks:
            out[as_slice(columns)] += values[:, None] * by_variable[variable]
        return out

    def at(self, blocks: Array | slice) -> Factors:
        """Return the factors of the same columns at some of the blocks."""
        some = blocks if isinstance(blocks, slice) else as_slice(blocks)
        if isinstance(some, slice):
            return replace(self, blocks=tuple((s, c, values[:, some]) for s, c, values in self.blocks))
        return replace(self, blocks=tuple((s, c, np.take(v, some, axis=1, mode="clip")) for s, c, v in self.blocks))

    def only(self, columns: Array) -> Factors:
        """Return the factors of the columns of these indices alone, renumbered from 0."""
        place = np.full(self.width, -1)
        place[columns] = np.arange(len(columns))
        # The columns of all blocks are looked up at once, for most blocks have none of those wanted.
        every = place[np.concatenate([np.zeros(0, dtype=np.int64), *(own for _, own, _ in self.blocks)])]
        wanted, edges = np.flatnonzero(every >= 0), np.cumsum([0, *(len(own) for _, own, _ in self.blocks)])
        bounds = np.searchsorted(wanted, edges)
        selected = []
        for k in np.flatnonzero(np.diff(bounds)).tolist():
            variable, _, values = self.blocks[k]
            there = wanted[bounds[k] : bounds[k + 1]]
            selected.append((variable, every[there], values[as_slice(there - edges[k])]))
        return Factors(tuple(selected), len(columns))

    def combined(self, every: Combined) -> Factors:
        """Return the factors of the combinations `every` of these columns."""
        if every.plain:
            return self
        starts, made = np.array([a for a, _, _ in every.blocks]), []
        for variable, own, values in self.blocks:
            which = np.searchsorted(starts, own, side="right") - 1
            parts = [(k, own[which == k], values[which == k]) for k in np.unique(which).tolist()]
            more = [every.factors(k, columns, part) for k, columns, part in parts]
            places, factors = (np.concatenate(a) for a in zip(*more, strict=True))
            if len(places):  # a part that changes no row has no combinations
                made.append((variable, places, factors))
        return Factors(tuple(made), every.width)

    def products(self, levers: Array) -> Array:
        """Return the Gram matrix of the columns over all blocks, shape (columns, columns).

        levers : derivatives of the rows by the intermediate variables, shape (n, m, variables)
        """
        total = np.zeros((self.width, self.width))
        for s, own, values in self.blocks:
            for t, others, more in self.blocks:
                total[np.ix_(own, others)] += (values * (levers[:, :, s] * levers[:, :, t]).sum(axis=1)) @ more.T
        return total

    def before(self, others: Factors) -> Factors:
        """Return the factors of both, with the columns of `others` numbered after these."""
        shifted = tuple((s, self.width + c, values) for s, c, values in others.blocks)
        return Factors((*self.blocks, *shifted), self.width + others.width)


def as_slice(columns: Array) -> Array | slice:
    """Return consecutive indices as a slice, which is faster, and other indices unchanged."""
    if not len(columns):
        return slice(0)
    return slice(columns[0], columns[-1] + 1) if (np.diff(columns) == 1).all() else columns


def directions_of(normal: Array, negligible_norm: float) -> Array:
    """Return the orthonormal directions of a part's columns that change the rows, (k, directions).

    normal : Gram matrix of the part's columns in units of typical size, shape (k, k)
    negligible_norm : directions are dropped of which one typical size changes the norm of all rows
        by less than this, in the unit of the residual
    """
    value, vector = np.linalg.eigh(normal)
    return np.asarray(vector[:, value > negligible_norm**2])


@dataclass(frozen=True, eq=False)
class Combined:
    """Orthonormal combinations that replace the columns of complete parts among some columns.

    Columns of incomplete parts are their own combinations.

    blocks : for consecutive columns the place of the first, one past the place of the last, and
        their directions, shape (columns, k), or None for columns that are not combined
    """

    blocks: tuple[tuple[int, int, Array | None], ...]

    @cached_property
    def edges(self) -> list[int]:
        """Return the index of each block's first combination, then the number of combinations."""
        widths = [b - a if V is None else V.shape[1] for a, b, V in self.blocks]
        return [0, *np.cumsum(widths, dtype=np.int64).tolist()]

    @property
    def width(self) -> int:
        """Return the number of combinations."""
        return self.edges[-1]

    @property
    def plain(self) -> bool:
        """Return whether no column is combined."""
        return all(V is None for _, _, V in self.blocks)

    def combine(self, M: Array) -> Array:
        """Return products with the combinations from products with the columns.

        M : products with the columns, along the last axis
        """
        if self.plain:
            return M
        return np.concatenate([M[..., a:b] if V is None else M[..., a:b] @ V for a, b, V in self.blocks], axis=-1)

    def factors(self, k: int, columns: Array, values: Array) -> tuple[Array, Array]:
        """Return indices and factors of the combinations of some columns of the block of index k.

        columns : places of the columns; values : their factors, shape (len(columns), n)
        """
        a, _, V = self.blocks[k]
        if V is None:
            return self.edges[k] + columns - a, values
        return np.arange(*self.edges[k : k + 2]), V[columns - a].T @ values

    def per_combination(self, sizes: Array) -> Array:
        """Return one number per combination from one per column.

        sizes : number of each column, equal within a part, shape (columns,)
        """
        if self.plain:
            return sizes
        runs = zip(self.blocks, np.diff(self.edges), strict=True)
        return np.concatenate([sizes[a:b] if V is None else np.full(k, sizes[a]) for (a, b, V), k in runs])

    def sum_over_dropped(self, numbers: Array) -> float:
        """Return the sum of the numbers of dropped directions, each that of its part's columns.

        numbers : number of each column, equal within a part, shape (columns,)
        """
        runs = zip(self.blocks, np.diff(self.edges), strict=True)
        return float(sum((b - a - k) * numbers[a] for (a, b, V), k in runs if V is not None))

    def places(self, columns: Array) -> Array:
        """Return the indices of the combinations of the columns at these places.

        columns : places, all columns of a part or none
        """
        own = [np.arange(*run) for run in zip(self.edges[:-1], self.edges[1:], strict=True)]
        places = [
            at[np.isin(np.arange(a, b), columns)] if V is None else at[: len(at) * bool(np.isin(a, columns))]
            for at, (a, b, V) in zip(own, self.blocks, strict=True)
        ]
        return np.concatenate([np.zeros(0, dtype=np.int64), *places])

    def values(self, x: Array) -> Array:
        """Return the parameters of the columns from those of the combinations.

        x : parameters of the combinations, along the first axis
        """
        runs = zip(self.blocks, self.edges[:-1], self.edges[1:], strict=True)
        return np.concatenate([x[:0], *(x[i:j] if V is None else V @ x[i:j] for (_, _, V), i, j in runs)])


def combined(columns: Array, directions: Directions) -> Combined:
    """Return how some columns are combined: those of complete parts by their directions.

    columns : indices of the columns, rising
    directions : directions of all parts, each of consecutive columns
    """
    blocks: list[tuple[int, int, Array | None]] = []
    end = 0
    for part, V in directions:
        start = int(np.searchsorted(columns, part[0]))
        behind = start + len(part)
        if behind <= len(columns) and columns[start] == part[0] and columns[behind - 1] == part[-1]:
            blocks += [(end, start, None)] * (start > end) + [(start, behind, V)]
            end = behind
    return Combined((*blocks, *[(end, len(columns), None)] * (len(columns) > end)))

"""Columns of a linear model, made some blocks at a time, and combinations of the columns of one part.

A column may be given by the chain rule: the rows' derivative by a variable in between (a lever, the same for all
columns) times that variable's derivative by the column's parameter, one factor a block. Products of thousands of
columns are then products of their factors.

The columns of one part have one prior size, so that its combinations along orthogonal directions are as independent as
its columns were. Those that move no row are left out: they are their priors, before and after the data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.noise import SerialNoise

# All blocks.
EVERY = slice(None)

# Columns of one part, and orthonormal directions among them that move something, shape (columns, k).
Directions = Sequence[tuple[Array, Array]]


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


class Columns(Protocol):
    """Columns E of n blocks, made when they are asked for."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Blocks, rows of each, columns."""

    @property
    def directions(self) -> Directions:
        """Of the parts of columns that are combined."""

    def at(self, blocks: Array) -> Columns:
        """The same columns at some of the blocks."""

    def only(self, columns: Array) -> Columns:
        """Some of the columns, in rising order, all those of one cause or none."""

    def after(self, column: int) -> Columns:
        """The columns from this one on, with which a cause's columns begin."""

    def take(self, columns: Array, blocks: Array | slice = EVERY, every: Combined | None = None) -> Array:
        """Some of the columns at some blocks, or combinations of them, shape (blocks, m, columns or combinations)."""

    def factors(self, blocks: Array | slice = EVERY) -> Factors:
        """All columns at some blocks as factors."""

    def levers(self, blocks: Array | slice = EVERY) -> Array:
        """Derivative of the rows by the variables in between, shape (blocks, m, variables)."""


@dataclass(frozen=True, eq=False)
class ArrayColumns:
    """Columns that are given as an array, shape (n, m, columns); the rows themselves are the variables in between."""

    values: Array
    directions: Directions = ()

    @property
    def shape(self) -> tuple[int, int, int]:
        n, m, columns = self.values.shape
        return n, m, columns

    def at(self, blocks: Array) -> ArrayColumns:
        return ArrayColumns(self.values[blocks])

    def only(self, columns: Array) -> ArrayColumns:
        return ArrayColumns(self.values[:, :, columns])

    def after(self, column: int) -> ArrayColumns:
        return ArrayColumns(self.values[:, :, column:])

    def take(self, columns: Array, blocks: Array | slice = EVERY, every: Combined | None = None) -> Array:
        taken = self.values[blocks][:, :, columns]
        return np.asarray(every.combine(taken) if every else taken)

    def factors(self, blocks: Array | slice = EVERY) -> Factors:
        every = np.arange(self.values.shape[2])
        return Factors(tuple((i, every, self.values[blocks, i].T) for i in range(self.values.shape[1])), len(every))

    def levers(self, blocks: Array | slice = EVERY) -> Array:
        n, m, _ = self.values[blocks].shape
        return np.broadcast_to(np.eye(m), (n, m, m))


@dataclass(frozen=True, eq=False)
class SerialColumns:
    """Columns of blocks in an order, as they are where noise that follows itself is white."""

    columns: Columns
    order: Array
    noise: SerialNoise

    @property
    def shape(self) -> tuple[int, int, int]:
        return len(self.order), *self.columns.shape[1:]

    @property
    def directions(self) -> Directions:
        return self.columns.directions

    def at(self, blocks: Array) -> ArrayColumns:
        return ArrayColumns(self.take(np.arange(self.shape[2]), blocks), self.directions)

    def only(self, columns: Array) -> SerialColumns:
        return replace(self, columns=self.columns.only(columns))

    def after(self, column: int) -> SerialColumns:
        return replace(self, columns=self.columns.after(column))

    def take(self, columns: Array, blocks: Array | slice = EVERY, every: Combined | None = None) -> Array:
        here, last, own, before = self._blocks(blocks)
        taken = own * self.columns.take(columns, self.order[here], every)
        if self.noise.follows:
            taken = taken - before * self.columns.take(columns, self.order[last], every)
        return np.asarray(taken)

    def factors(self, blocks: Array | slice = EVERY) -> Factors:
        here, last, _, _ = self._blocks(blocks)
        own = self.columns.factors(self.order[here])
        if not self.noise.follows:
            return own
        variables = self.columns.levers(self.order[:1]).shape[2]
        shifted = tuple((s + variables, c, values) for s, c, values in self.columns.factors(self.order[last]).blocks)
        return Factors((*own.blocks, *shifted), own.width)

    def levers(self, blocks: Array | slice = EVERY) -> Array:
        here, last, own, before = self._blocks(blocks)
        levers = own * self.columns.levers(self.order[here])
        if not self.noise.follows:
            return np.asarray(levers)
        return np.concatenate([levers, -before * self.columns.levers(self.order[last])], axis=2)

    def _blocks(self, blocks: Array | slice) -> tuple[Array, Array, Array, Array]:
        """Some blocks and those before them, and the weight of each."""
        here = np.arange(len(self.order))[blocks]
        own = self.noise.weight.reshape(len(self.order), -1, 1)[here]
        return here, np.maximum(here - 1, 0), own, self.noise.stays[here, None, None] * own


@dataclass(frozen=True, eq=False)
class Factors:
    """Columns as sums over variables in between: the rows' derivative by one times a factor at each block.

    blocks : a variable, the columns that act through it, at most once each, and their factors, shape (columns, n)
    width : number of columns
    """

    blocks: tuple[tuple[int, Array, Array], ...]
    width: int

    def columns_at(self, levers: Array) -> Array:
        """The columns, shape (n, m, columns); levers : shape (n, m, variables)."""
        return np.ascontiguousarray(self.by_column(levers)[:-1].transpose(2, 1, 0))

    def by_column(self, levers: Array) -> Array:
        """The same one by one, with a last one of zeros, shape (columns + 1, m, n)."""
        n, m, _ = levers.shape
        out, by_variable = np.zeros((self.width + 1, m, n)), np.ascontiguousarray(levers.transpose(2, 1, 0))
        for variable, columns, values in self.blocks:
            out[as_slice(columns)] += values[:, None] * by_variable[variable]
        return out

    def at(self, blocks: Array | slice) -> Factors:
        some = blocks if isinstance(blocks, slice) else as_slice(blocks)
        if isinstance(some, slice):
            return replace(self, blocks=tuple((s, c, values[:, some]) for s, c, values in self.blocks))
        return replace(self, blocks=tuple((s, c, np.take(v, some, axis=1, mode="clip")) for s, c, v in self.blocks))

    def only(self, columns: Array) -> Factors:
        place = np.full(self.width, -1)
        place[columns] = np.arange(len(columns))
        kept = []
        for variable, own, values in self.blocks:
            there = np.flatnonzero(place[own] >= 0)
            if len(there):
                kept.append((variable, place[own[there]], values[as_slice(there)]))
        return Factors(tuple(kept), len(columns))

    def combined(self, every: Combined) -> Factors:
        """Of combinations of the columns, of which those of a part act through the same variables."""
        if every.plain:
            return self
        starts, made = np.array([a for a, _, _ in every.blocks]), []
        for variable, own, values in self.blocks:
            which = np.searchsorted(starts, own, side="right") - 1
            parts = [(k, own[which == k], values[which == k]) for k in np.unique(which).tolist()]
            more = [every.factors(k, columns, part) for k, columns, part in parts]
            places, factors = (np.concatenate(a) for a in zip(*more, strict=True))
            if len(places):  # what moves no row has no combinations
                made.append((variable, places, factors))
        return Factors(tuple(made), every.width)

    def products(self, levers: Array) -> Array:
        """Products of the columns, added up over the blocks, shape (columns, columns)."""
        total = np.zeros((self.width, self.width))
        for s, own, values in self.blocks:
            for t, others, more in self.blocks:
                total[np.ix_(own, others)] += (values * (levers[:, :, s] * levers[:, :, t]).sum(axis=1)) @ more.T
        return total

    def before(self, others: Factors) -> Factors:
        """With the columns of others behind."""
        shifted = tuple((s, self.width + c, values) for s, c, values in others.blocks)
        return Factors((*self.blocks, *shifted), self.width + others.width)


def as_slice(columns: Array) -> Array | slice:
    """Columns one after the other as a slice, which is faster."""
    if not len(columns):
        return slice(0)
    return slice(columns[0], columns[-1] + 1) if (np.diff(columns) == 1).all() else columns


def directions_of(normal: Array, nothing: float) -> Array:
    """Directions that move something.

    normal : products of a part's columns in units of size, shape (k, k); nothing : of one size of a direction, that
        moves all rows together by less than this in units of the residual
    """
    value, vector = np.linalg.eigh(normal)
    return np.asarray(vector[:, value > nothing**2])


@dataclass(frozen=True, eq=False)
class Combined:
    """Columns, those of whole parts replaced by their combinations.

    blocks : in order, the first column and the one behind the last, and the directions; None for columns as they are
    """

    blocks: tuple[tuple[int, int, Array | None], ...]

    @cached_property
    def edges(self) -> list[int]:
        """Of the blocks among the combinations."""
        widths = [b - a if V is None else V.shape[1] for a, b, V in self.blocks]
        return [0, *np.cumsum(widths, dtype=np.int64).tolist()]

    @property
    def width(self) -> int:
        return self.edges[-1]

    @property
    def plain(self) -> bool:
        """Whether all columns are as they are."""
        return all(V is None for _, _, V in self.blocks)

    def combine(self, M: Array) -> Array:
        """Numbers by column as numbers by combination, along the last axis."""
        if self.plain:
            return M
        return np.concatenate([M[..., a:b] if V is None else M[..., a:b] @ V for a, b, V in self.blocks], axis=-1)

    def factors(self, k: int, columns: Array, values: Array) -> tuple[Array, Array]:
        """Factors of columns of a block as those of its combinations, and the places of these; shapes (columns, n)."""
        a, _, V = self.blocks[k]
        if V is None:
            return self.edges[k] + columns - a, values
        return np.arange(*self.edges[k : k + 2]), V[columns - a].T @ values

    def one_of_each(self, sizes: Array) -> Array:
        """Numbers that are alike throughout a part, by combination."""
        if self.plain:
            return sizes
        runs = zip(self.blocks, np.diff(self.edges), strict=True)
        return np.concatenate([sizes[a:b] if V is None else np.full(k, sizes[a]) for (a, b, V), k in runs])

    def left_out(self, numbers: Array) -> float:
        """Sum over the directions that are left out of numbers that are alike throughout a part."""
        runs = zip(self.blocks, np.diff(self.edges), strict=True)
        return float(sum((b - a - k) * numbers[a] for (a, b, V), k in runs if V is not None))

    def places(self, columns: Array) -> Array:
        """Of the combinations of some columns, all those of a part or none; columns : their places among all."""
        own = [np.arange(*run) for run in zip(self.edges[:-1], self.edges[1:], strict=True)]
        places = [
            at[np.isin(np.arange(a, b), columns)] if V is None else at[: len(at) * bool(np.isin(a, columns))]
            for at, (a, b, V) in zip(own, self.blocks, strict=True)
        ]
        return np.concatenate([np.zeros(0, dtype=np.int64), *places])

    def values(self, x: Array) -> Array:
        """Numbers by combination as numbers by column, along the first axis."""
        runs = zip(self.blocks, self.edges[:-1], self.edges[1:], strict=True)
        return np.concatenate([x[:0], *(x[i:j] if V is None else V @ x[i:j] for (_, _, V), i, j in runs)])


def combined(columns: Array, directions: Directions) -> Combined:
    """Some columns, in rising order; directions : of all parts, whose columns follow each other."""
    blocks: list[tuple[int, int, Array | None]] = []
    end = 0
    for part, V in directions:
        start = int(np.searchsorted(columns, part[0]))
        behind = start + len(part)
        if behind <= len(columns) and columns[start] == part[0] and columns[behind - 1] == part[-1]:
            blocks += [(end, start, None)] * (start > end) + [(start, behind, V)]
            end = behind
    return Combined((*blocks, *[(end, len(columns), None)] * (len(columns) > end)))

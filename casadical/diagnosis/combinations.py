"""Combinations of the columns of a wide effect: the few that move the measured point in these poses.

A curve of many harmonics over a part of a turn has far fewer freedoms than parameters. The parameters of one part of an
effect have one prior size, so that its combinations along orthogonal directions are as independent as its parameters
were; those that move no pose are their priors, before and after the data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from casadical.core.arrays import Array

# A direction is left out if one size of it moves all poses together by less than this [m].
NOTHING = 3e-9

# Columns of one part of an effect, and orthonormal directions among them that move something, shape (columns, k).
Directions = Sequence[tuple[Array, Array]]


def directions_of(normal: Array) -> Array:
    """Directions that move something; normal : products of a part's columns in units of size, shape (k, k) [m^2]."""
    value, vector = np.linalg.eigh(normal)
    return np.asarray(vector[:, value > NOTHING**2])


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
        """Number of combinations."""
        return self.edges[-1]

    @property
    def plain(self) -> bool:
        """Whether all columns are as they are."""
        return all(V is None for _, _, V in self.blocks)

    def of(self, M: Array) -> Array:
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
        found = [
            at[np.isin(np.arange(a, b), columns)] if V is None else at[: len(at) * bool(np.isin(a, columns))]
            for at, (a, b, V) in zip(own, self.blocks, strict=True)
        ]
        return np.concatenate([np.zeros(0, dtype=np.int64), *found])

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

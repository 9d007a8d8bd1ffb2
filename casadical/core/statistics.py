"""Ranking with ties, and robust figures of samples; distributions are those of scipy.special."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import numpy as np

from casadical.core.basics import Array

Item = TypeVar("Item")


# Values that differ by less, as a share of the greatest, are equal to what the arithmetic can tell: the first one is
# taken, in the order in which they stand, on every processor. Of logarithms it is the difference itself. Information
# whose least eigenvalue is 1e-9 of a unit diagonal lets rounding move a gain by 2.2e-7 of itself (docs/reference.md).
TIE = 1e-6


def first_of_best(values: Sequence[float] | Array, *, logs: bool = False) -> int:
    """Number of the greatest value, the first of those that are equal to it within TIE; logs : of probabilities"""
    given = np.asarray(values, dtype=float)
    best = float(given.max())
    least = best - TIE * (1.0 if logs else abs(best)) if np.isfinite(best) else best
    return int(np.argmax(given >= least))


def best_of(items: Iterable[Item], value: Callable[[Item], float], *, logs: bool = False) -> Item:
    """The item of the greatest value, the first of those that are equal within TIE; logs : of probabilities"""
    listed = list(items)
    return listed[first_of_best([value(item) for item in listed], logs=logs)]


def ranked(values: Sequence[float] | Array, *, logs: bool = False) -> list[int]:
    """Numbers of the values, from the greatest; runs of such as are equal within TIE in their order."""
    given = np.asarray(values, dtype=float)
    order = np.argsort(-given, kind="stable")
    falling = given[order]
    finite = np.isfinite(falling)
    with np.errstate(invalid="ignore"):
        fall = -np.diff(falling, prepend=np.inf)
    step = np.cumsum(~finite | (fall > TIE * np.where(finite & (not logs), np.abs(falling), 1.0)))
    return [int(k) for k in order[np.lexsort((order, step))]]


def thirds(values: Array) -> tuple[Array, Array]:
    """The third in which each value lies, 0 to 2, and the four edges; one at an edge, within rounding, is below."""
    edges = np.quantile(values, [0, 1 / 3, 2 / 3, 1])
    return np.searchsorted(edges[1:-1] + TIE * np.ptp(edges), values), edges


def known_digits(value: float, size: float, digits: int) -> float:
    """A value without the digits that rounding decides: so many are left behind the first one of `size`."""
    if not (size and math.isfinite(size)):
        return float(value)
    return round(float(value), digits - math.floor(math.log10(abs(size)))) + 0.0


def robust_std(r: Array) -> float:
    """Standard deviation of residuals from their median absolute value, robust to outliers; zeros have weight zero."""
    counted = np.abs(r[r != 0])
    return float(1.4826 * np.median(counted)) if counted.size else 0.0

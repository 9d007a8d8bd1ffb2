"""Ranking with ties, and robust statistics of samples."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import numpy as np

from casadical.core.basics import Array

Item = TypeVar("Item")


# Largest difference from the greatest value at which a value is tied with it, relative or, for
# logarithms, absolute. The first of tied values is taken, so that every processor gives the same
# answer. Rounding changes a gain by up to 2.2e-7 of itself if the smallest eigenvalue of the
# information is 1e-9 of a unit diagonal.
TIE_TOLERANCE = 1e-6


def first_of_best(values: Sequence[float] | Array, *, logs: bool = False) -> int:
    """Return the index of the greatest value, the first of those tied with it.

    logs : whether the values are log probabilities (see `TIE_TOLERANCE`)
    Raises ValueError for no values.
    """
    given = np.asarray(values, dtype=float)
    best = float(given.max())
    threshold = best - TIE_TOLERANCE * (1.0 if logs else abs(best)) if np.isfinite(best) else best
    return int(np.argmax(given >= threshold))


def best_of(items: Iterable[Item], value: Callable[[Item], float], *, logs: bool = False) -> Item:
    """Return the item of the greatest value, the first of those tied with it.

    value : function of an item; logs : whether it is a log probability (see `TIE_TOLERANCE`)
    """
    listed = list(items)
    return listed[first_of_best([value(item) for item in listed], logs=logs)]


def ranked(values: Sequence[float] | Array, *, logs: bool = False) -> list[int]:
    """Return the indices of the values from the greatest to the least.

    Neighbours in this order that are tied keep the order in which they were given.

    logs : whether the values are log probabilities (see `TIE_TOLERANCE`)
    """
    given = np.asarray(values, dtype=float)
    order = np.argsort(-given, kind="stable")
    falling = given[order]
    finite = np.isfinite(falling)
    with np.errstate(invalid="ignore"):
        fall = -np.diff(falling, prepend=np.inf)
    step = np.cumsum(~finite | (fall > TIE_TOLERANCE * np.where(finite & (not logs), np.abs(falling), 1.0)))
    return [int(k) for k in order[np.lexsort((order, step))]]


def thirds(values: Array) -> tuple[Array, Array]:
    """Return the third of each value, 0 to 2, shape (n,), and the four quantiles that bound them.

    The thirds have equal numbers of values, but for ties. A value at a bound, within 1e-6 of the
    range, belongs to the third below.

    values : shape (n,)
    """
    edges = np.quantile(values, [0, 1 / 3, 2 / 3, 1])
    return np.searchsorted(edges[1:-1] + TIE_TOLERANCE * np.ptp(edges), values), edges


def rounded_at(value: float, size: float, digits: int) -> float:
    """Return a value rounded to the decimal place `digits` after the leading digit of `size`.

    Digits that rounding errors decide are dropped. It is unchanged if `size` is zero or not finite.
    """
    if not (size and math.isfinite(size)):
        return float(value)
    return round(float(value), digits - math.floor(math.log10(abs(size)))) + 0.0


def robust_std(r: Array) -> float:
    """Return the robust standard deviation of residuals about zero, in their unit; 0 for none.

    It is 1.4826 times the median absolute value. Zeros are ignored, since they have weight zero.

    r : any shape
    """
    counted = np.abs(r[r != 0])
    return float(1.4826 * np.median(counted)) if counted.size else 0.0

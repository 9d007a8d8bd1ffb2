"""Distributions that the standard library does not have."""

import math
from collections.abc import Callable, Iterable, Sequence
from statistics import NormalDist
from typing import TypeVar

import numpy as np

from casadical.core.basics import Array

Item = TypeVar("Item")


def student_t(probability: float, degrees_of_freedom: int) -> float:
    """Quantile of Student's t distribution, by the Cornish-Fisher series (Abramowitz and Stegun 26.7.5).

    Accurate to 0.5 % from 3 degrees of freedom at 97.5 %, to 1e-5 from 15.
    """
    z, n = NormalDist().inv_cdf(probability), max(1, degrees_of_freedom)
    g1 = (z**3 + z) / 4
    g2 = (5 * z**5 + 16 * z**3 + 3 * z) / 96
    g3 = (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384
    g4 = (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160
    return z + g1 / n + g2 / n**2 + g3 / n**3 + g4 / n**4


def exceeded_by_chance(ratio: float, above: float, below: float) -> float:
    """How likely two variances of the same noise have a greater ratio, by their degrees of freedom (F distribution).

    Paulson, Annals of Mathematical Statistics 13 (1942). Where both are few it is too large for small chances: of 10
    and 10 by half at 1e-4, of 75 and 75 by 3 %.
    """
    a, b = 2 / (9 * above), 2 / (9 * below)
    root = ratio ** (1 / 3)
    return NormalDist().cdf((1 - a - (1 - b) * root) / (b * root**2 + a) ** 0.5)


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


# Directions of less than this share of the strongest are round-off.
RANK = 1e-9


def column_space(A: Array) -> Array:
    """Orthonormal columns, shape (rows, rank), that span those of a matrix, shape (rows, columns), of any scale.

    The base model has columns that depend on others; without a cut by rank these would add arbitrary directions.
    """
    U, s, _ = np.linalg.svd(A / np.maximum(np.linalg.norm(A, axis=0), 1e-300), full_matrices=False)
    return np.asarray(U[:, s > RANK * s[0]])

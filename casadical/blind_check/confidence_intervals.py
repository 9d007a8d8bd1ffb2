"""Estimates with 95 % intervals: shares by Wilson's score (1927), means and quantiles by the bootstrap (Efron 1979).

The score has statistics of its own: the bootstrap of the diagnosis is part of what it judges.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from casadical.core.arrays import Array

_Z = NormalDist().inv_cdf(0.975)
DRAWS = 2000


@dataclass(frozen=True)
class Estimate:
    """An estimate and its interval; None where there is no data.

    n : campaigns (or claims) that it rests on; hits : of a share
    """

    value: float | None
    low: float | None
    high: float | None
    n: int
    hits: int | None = None

    def __str__(self) -> str:
        if self.value is None:
            return "-"
        count = f"n = {self.n}" if self.hits is None else f"{self.hits} of {self.n}"
        return f"{self.value:.3f}  ({self.low:.3f} .. {self.high:.3f}; {count})"


def share(hits: Sequence[bool]) -> Estimate:
    """The share of hits."""
    n, count = len(hits), sum(map(bool, hits))
    if n == 0:
        return Estimate(None, None, None, 0, 0)
    p = count / n
    centre, half = p + _Z**2 / (2 * n), _Z * float(np.sqrt(p * (1 - p) / n + _Z**2 / (4 * n**2)))
    low, high = ((centre + sign * half) / (1 + _Z**2 / n) for sign in (-1, 1))
    return Estimate(p, max(0.0, low), min(1.0, high), n, count)


def bootstrap(values: Sequence[float], statistic: Callable[[Array], Array], seed: int = 0) -> Estimate:
    """A statistic of values; it takes them along the last axis."""
    if not len(values):
        return Estimate(None, None, None, 0)
    data = np.asarray(values, dtype=float)
    draws = statistic(data[np.random.default_rng(seed).integers(0, len(data), (DRAWS, len(data)))])
    low, high = np.quantile(draws, [0.025, 0.975])
    return Estimate(float(statistic(data)), float(low), float(high), len(data))


def mean(values: Sequence[float]) -> Estimate:
    return bootstrap(values, lambda x: np.asarray(x.mean(axis=-1)))


def quantile(values: Sequence[float], q: float) -> Estimate:
    return bootstrap(values, lambda x: np.asarray(np.quantile(x, q, axis=-1)))

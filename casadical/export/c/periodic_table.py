"""A function that repeats every turn as a table: a cubic spline through equally spaced points, with its proven error.

A table costs the same few operations for any number of harmonics. It is made from a function that a CasADi function
calls (option `never_inline`), so that CasADi's own numbers stay those of the exact function. The error of a cubic
spline through samples of one harmonic is known in closed form; the sum over the function's harmonics, as if all were
greatest at one place, is a bound for every angle.
"""

from __future__ import annotations

from functools import lru_cache

import casadi
import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError

# Largest error of a table, in the unit of the function's outputs: of a joint angle 0.05 urad, a twentieth of a
# micrometre at 1 m, and less than the last bit of an angle of 1 rad in float.
LARGEST_ERROR = 5e-8
# Points of a turn; a power of two, so that a bit mask finds the place. More would not be exact in float.
POINTS = (64, 128, 256, 512, 1024, 2048)
# Largest angle [rad] that is reduced exactly, by multiples of a turn's fraction in two parts.
TABLE_LIMIT = 128.0
# Whole turns that are added to make every place positive: a conversion to integers then rounds down.
TURNS = 32
_SAMPLES = 8192


def spline_table(samples: Array) -> tuple[float, ...]:
    """Coefficients over six of the periodic cubic spline through samples of a turn, shape (N,); N + 3 numbers.

    Between sample i and the next one, by t from 0 to 1, the spline is the sum of entries i to i + 3 times the cubic
    B-splines of t times six.
    """
    angles = 2 * np.pi * np.fft.rfftfreq(len(samples))
    c = np.fft.irfft(np.fft.rfft(samples) / (2 / 3 + np.cos(angles) / 3), len(samples)) / 6
    return tuple(map(float, np.concatenate([c[-1:], c, c[:2]])))


@lru_cache
def spline_errors(points: int) -> Array:
    """Largest error of a spline through so many samples of a unit harmonic of order 1, 2, .., shape (4096,)."""
    angle = 2 * np.pi * np.arange(1, _SAMPLES // 2 + 1) / points
    t = np.linspace(-0.01, 1.01, 52)[:, None]  # a rounded place may be a hundredth outside its cell
    weights = ((1 - t) ** 3, 4 - 6 * t**2 + 3 * t**3, 1 + 3 * t + 3 * t**2 - 3 * t**3, t**3)
    spline = sum(w * np.exp(1j * angle * (k - 1)) for k, w in enumerate(weights)) / (4 + 2 * np.cos(angle))
    return np.asarray(abs(spline - np.exp(1j * angle * t)).max(axis=0))


def periodic_tables(function: casadi.Function) -> list[tuple[tuple[float, ...], float]]:
    """For each output of a function q[n] -> y[n] a table and the bound of its error; a constant has one number.

    Raises InputError: an output is no periodic function of its own angle alone, has no finite value, or changes too
    fast for the largest table.
    """
    n = function.numel_in(0)
    if (function.n_in(), function.n_out(), function.numel_out(0)) != (1, 1, n):
        raise InputError(f"{_what(function)} takes {function.n_in()} vectors; allowed is q[n] -> y[n], each y by its q")
    rows, columns = function.jac_sparsity(0, 0).get_triplet()
    if rows != columns:
        raise InputError(f"{_what(function)} has an output that follows another angle than its own")
    x = 2 * np.pi * np.arange(_SAMPLES) / _SAMPLES
    values = np.array(function.map(_SAMPLES)(np.tile(x, (n, 1))))
    if not np.isfinite(values).all():
        raise InputError(
            f"{_what(function)} has no finite value for joint {np.flatnonzero(~np.isfinite(values).all(1))[0] + 1}; "
            "its coefficients must be finite numbers"
        )
    some = x[1 :: _SAMPLES // 64]
    again = np.array(function.map(len(some))(np.tile(some - 2 * np.pi, (n, 1))))
    if abs(again - values[:, 1 :: _SAMPLES // 64]).max() > LARGEST_ERROR / 100:
        raise InputError(f"{_what(function)} does not repeat after 2 pi")
    return [_table(function, i, row) if i in rows else ((float(row[0]),), 0.0) for i, row in enumerate(values)]


def _table(function: casadi.Function, output: int, samples: Array) -> tuple[tuple[float, ...], float]:
    """The smallest table of one output that is exact enough, and its bound."""
    amplitude = abs(np.fft.rfft(samples))[1:] * 2 / _SAMPLES
    bound = np.inf
    for points in POINTS:
        bound = float(amplitude @ spline_errors(points))
        if bound <= LARGEST_ERROR:
            return spline_table(samples[:: _SAMPLES // points]), bound
    high = 1 + int(np.flatnonzero(amplitude > 0.01 * amplitude.max())[-1])
    raise InputError(
        f"{_what(function)} is {1e6 * bound:.2g} urad off in joint {output + 1} with {POINTS[-1]} points a turn; "
        f"allowed are {1e6 * LARGEST_ERROR:g} urad. It holds harmonics up to {high}: are its coefficients right?"
    )


def _what(function: casadi.Function) -> str:
    return f"the called function {function.name()!r}, which becomes a table,"

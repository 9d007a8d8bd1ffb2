"""Numerical constants of the exported C: elementary functions' polynomials, and spline tables.

The polynomials are near-minimax and come from docs/studies/c_coefficients.py; pi/2 and ln 2 are
split so that small multiples of the first part are exact. The C templates and the NumPy reference
read the same numbers.

A function with period 2 pi is evaluated as a cubic spline through equally spaced samples, with the
same few operations for any number of harmonics. Such a table is made of a function that a CasADi
function calls (option `never_inline`), so that CasADi's own numbers stay those of the exact
function. The error of a cubic spline through samples of one harmonic has a closed form; the
sum over the function's harmonics, as if all had their maximum at one angle, bounds the error at
every angle.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import casadi
import numpy as np

from casadical.core.basics import Array, InputError

# Type of the name of the real type of an export's numbers.
Real = Literal["float", "double"]


@dataclass(frozen=True)
class Coefficients:
    """Constants of one real type; the C templates hold the formula to which each belongs."""

    coth: tuple[float, ...]  # r coth(r/2) = 2 + z P(z), z = r^2, |r| <= ln(2)/2
    sin: tuple[float, ...]  # sin r = r + r z P(z), |r| <= pi/4
    cos: tuple[float, ...]  # cos r = 1 - z/2 + z^2 P(z)
    atan: tuple[float, ...]  # atan t = t + t z P(z), |t| <= tan(pi/8)
    half_pi: tuple[float, float]  # pi/2 in two parts; small multiples of the first are exact
    ln2: tuple[float, float]  # ln 2 in two parts, likewise
    two_over_pi: float
    one_over_ln2: float
    pi: float
    pi_2: float
    pi_4: float
    tansig_limit: float  # arguments are clipped to it; tanh rounds to 1 there
    sqrt_steps: tuple[int, ...]  # exponents of 2 that scale a square root's argument into [1, 4)
    heron_steps: int  # number of Heron (Newton) steps of the square root
    smallest: float  # smallest normal number
    largest: float  # largest finite number


# Largest absolute angle that sincos reduces exactly [rad]; a larger one violates a guard.
ANGLE_LIMIT = 1024.0
# Largest argument of exp: a larger one violates a guard, and one below its negative is clipped.
EXP_LIMIT = 43.0
# Smallest ratio of the smaller to the larger coordinate at which atan2 subtracts pi/4; any value
# near tan(pi/8) is right.
TAN_PI_8 = 0.41421356
# Coefficients, lowest first, of a quadratic polynomial for sqrt(m) on [1, 4), which is accurate to
# 1.7 per cent; Heron's steps refine it.
SQRT_GUESS = (0.5375, 0.4905, -0.0305)

_FLOAT_COEFFICIENTS = Coefficients(  # constants of the elementary functions in float (binary32)
    coth=(0.16666653752326965, -0.0027696965262293816),
    sin=(-0.166666641831398, 0.008332724682986736, -0.00019582855748012662),
    cos=(0.0416666641831398, -0.0013888279208913445, 2.4542896426282823e-05),
    atan=(-0.3333333134651184, 0.1999952346086502, -0.14263366162776947, 0.10737396776676178, -0.06431038677692413),
    half_pi=(1.5703125, 0.0004838267923332751),
    ln2=(0.693145751953125, 1.428606765330187e-06),
    two_over_pi=0.6366197466850281,
    one_over_ln2=1.4426950216293335,
    pi=3.1415927410125732,
    pi_2=1.5707963705062866,
    pi_4=0.7853981852531433,
    tansig_limit=9.25,
    sqrt_steps=(64, 32, 16, 8, 4, 2),
    heron_steps=2,
    smallest=float(np.finfo(np.float32).tiny),
    largest=float(np.finfo(np.float32).max),
)
_DOUBLE_COEFFICIENTS = Coefficients(  # constants of the elementary functions in double (binary64)
    coth=(
        0.1666666666666666,
        -0.002777777777754703,
        6.613756463035081e-05,
        -1.6534046823512925e-06,
        4.14314416256248e-08,
    ),
    sin=(
        -0.16666666666666666,
        0.0083333333333307,
        -0.00019841269836387345,
        2.755731591191116e-06,
        -2.5051092507061385e-08,
        1.59153232122714e-10,
    ),
    cos=(
        0.041666666666666664,
        -0.0013888888888887241,
        2.4801587298533456e-05,
        -2.755731715246704e-07,
        2.087612165887116e-09,
        -1.1380876948169717e-11,
    ),
    atan=(
        -0.3333333333333333,
        0.1999999999999509,
        -0.14285714284577217,
        0.11111111008107874,
        -0.09090904289128517,
        0.07692176510795928,
        -0.06664417824186955,
        0.058573396761385246,
        -0.05081236164642543,
        0.03911053674347613,
        -0.019029290809743138,
    ),
    half_pi=(1.5707963267341256, 6.077100506506192e-11),
    ln2=(0.6931471804855391, 7.440617110012397e-11),
    two_over_pi=0.6366197723675814,
    one_over_ln2=1.4426950408889634,
    pi=3.141592653589793,
    pi_2=1.5707963267948966,
    pi_4=0.7853981633974483,
    tansig_limit=19.5,
    sqrt_steps=(512, 256, 128, 64, 32, 16, 8, 4, 2),
    heron_steps=3,
    smallest=float(np.finfo(np.float64).tiny),
    largest=float(np.finfo(np.float64).max),
)
# Constants of the elementary functions, by the name of the real type.
COEFFICIENTS: dict[str, Coefficients] = {"float": _FLOAT_COEFFICIENTS, "double": _DOUBLE_COEFFICIENTS}
# NumPy type of numbers, by the name of the real type.
NUMPY_TYPE: dict[str, Any] = {"float": np.float32, "double": np.float64}


def turn_parts(c: Coefficients, points: int) -> tuple[float, float, float]:
    """Return a table's samples per radian, and the sample spacing [rad] split in two parts.

    The two parts add up to the spacing, as in `Coefficients.half_pi`.

    c : constants of the real type; points : samples per turn, a power of two
    """
    high, low = (4 / points * part for part in c.half_pi)
    return points / 4 * c.two_over_pi, high, low


def literal(value: float, real: Real) -> str:
    """Return the C99 constant whose value is exactly `value` rounded to the real type."""
    rounded = float(NUMPY_TYPE[real](value))
    small_whole = rounded == int(rounded) and abs(rounded) < 1e6 if abs(rounded) < 1e9 else False
    mantissa, exponent = rounded.hex().split("p")
    text = repr(rounded) if small_whole else f"{mantissa.rstrip('0').rstrip('.')}p{exponent}"
    return text + ("F" if real == "float" else "")


# Largest interpolation error of a table, in the unit of the function's outputs. For a joint angle
# it is 0.05 urad: 0.05 um at 1 m, and less than the last bit of an angle of 1 rad in float.
MAX_TABLE_ERROR = 5e-8
# Largest absolute angle of a table lookup [rad]: up to it the angle is reduced exactly, by
# multiples of the sample spacing in two parts.
MAX_TABLE_ANGLE_RAD = 128.0
# Number of turns that are added to an angle so that its index is positive: the conversion to an
# integer, which truncates, then rounds down.
ADDED_TURNS = 32
# Number of samples per turn from which the harmonics of a function are computed.
_HARMONIC_SAMPLES = 8192


def spline_table(samples: Array) -> tuple[float, ...]:
    """Return coefficients / 6 of the periodic cubic spline through N samples, N + 3 numbers.

    Between sample i and the next one, at t from 0 to 1, the spline is the sum of entries i to i + 3
    times six times the cubic B-spline basis functions of t.

    samples : values at equally spaced angles of one turn, shape (N,)
    """
    angles = 2 * np.pi * np.fft.rfftfreq(len(samples))
    c = np.fft.irfft(np.fft.rfft(samples) / (2 / 3 + np.cos(angles) / 3), len(samples)) / 6
    return tuple(map(float, np.concatenate([c[-1:], c, c[:2]])))


@lru_cache
def spline_errors(points: int) -> Array:
    """Return the largest error of a spline through a unit harmonic of each order, shape (4096,).

    The orders are 1, 2, .. 4096.

    points : samples of the spline per turn
    """
    angle = 2 * np.pi * np.arange(1, _HARMONIC_SAMPLES // 2 + 1) / points
    t = np.linspace(-0.01, 1.01, 52)[:, None]  # rounding may place t a hundredth outside its cell
    weights = ((1 - t) ** 3, 4 - 6 * t**2 + 3 * t**3, 1 + 3 * t + 3 * t**2 - 3 * t**3, t**3)
    spline = sum(w * np.exp(1j * angle * (k - 1)) for k, w in enumerate(weights)) / (4 + 2 * np.cos(angle))
    return np.asarray(abs(spline - np.exp(1j * angle * t)).max(axis=0))


def periodic_tables(function: casadi.Function) -> list[tuple[tuple[float, ...], float]]:
    """Return (spline table, bound of its error) for each output of a function q[n] -> y[n].

    The bound is in the unit of y. A constant output has a table of one number.

    Raises InputError: an output is not a function of its own angle alone with period 2 pi, has no
    finite value, or changes too fast for the largest table.
    """
    n = function.numel_in(0)
    if (function.n_in(), function.n_out(), function.numel_out(0)) != (1, 1, n):
        raise InputError(f"{_what(function)} takes {function.n_in()} vectors; allowed is q[n] -> y[n], each y by its q")
    rows, columns = function.jac_sparsity(0, 0).get_triplet()
    if rows != columns:
        raise InputError(f"{_what(function)} has an output that follows another angle than its own")
    x = 2 * np.pi * np.arange(_HARMONIC_SAMPLES) / _HARMONIC_SAMPLES
    values = np.array(function.map(_HARMONIC_SAMPLES)(np.tile(x, (n, 1))))
    if not np.isfinite(values).all():
        raise InputError(
            f"{_what(function)} has no finite value for joint "
            f"{np.flatnonzero(~np.isfinite(values).all(1))[0] + 1}; its coefficients must be "
            "finite numbers"
        )
    some = x[1 :: _HARMONIC_SAMPLES // 64]
    again = np.array(function.map(len(some))(np.tile(some - 2 * np.pi, (n, 1))))
    if abs(again - values[:, 1 :: _HARMONIC_SAMPLES // 64]).max() > MAX_TABLE_ERROR / 100:
        raise InputError(f"{_what(function)} does not repeat after 2 pi")
    return [_table(function, i, row) if i in rows else ((float(row[0]),), 0.0) for i, row in enumerate(values)]


def _table(function: casadi.Function, output: int, samples: Array) -> tuple[tuple[float, ...], float]:
    """Return the smallest spline table of one output that is accurate enough, and its error bound.

    Returns the entries of the table, and the bound in the unit of the output
    """
    amplitude = abs(np.fft.rfft(samples))[1:] * 2 / _HARMONIC_SAMPLES
    bound = np.inf
    # Numbers of samples per turn that are tried, in this order. Powers of two let a bit mask reduce
    # the index; with more samples the index would not be exact in float.
    table_sizes = (64, 128, 256, 512, 1024, 2048)
    for points in table_sizes:
        bound = float(amplitude @ spline_errors(points))
        if bound <= MAX_TABLE_ERROR:
            return spline_table(samples[:: _HARMONIC_SAMPLES // points]), bound
    high = 1 + int(np.flatnonzero(amplitude > 0.01 * amplitude.max())[-1])
    raise InputError(
        f"{_what(function)} is {1e6 * bound:.2g} urad off in joint {output + 1} with "
        f"{table_sizes[-1]} points a turn; allowed are {1e6 * MAX_TABLE_ERROR:g} urad. It holds "
        f"harmonics up to {high}: are its coefficients right?"
    )


def _what(function: casadi.Function) -> str:
    """Return the subject of an error message about a called function."""
    return f"the called function {function.name()!r}, which becomes a table,"

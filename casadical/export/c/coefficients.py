"""Constants of the exported C's elementary functions, one set for each real type.

Made by docs/studies/c_coefficients.py: near-minimax polynomials, and pi/2 and ln 2 split so that small multiples of the
first part are exact. The C templates and the NumPy evaluation read the same numbers.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Real = Literal["float", "double"]


@dataclass(frozen=True)
class Coefficients:
    """Numbers of one real type; see the C templates for the formula each belongs to."""

    coth: tuple[float, ...]  # r coth(r/2) = 2 + z P(z), z = r^2, |r| <= ln(2)/2
    sin: tuple[float, ...]  # sin r = r + r z P(z), |r| <= pi/4
    cos: tuple[float, ...]  # cos r = 1 - z/2 + z^2 P(z)
    atan: tuple[float, ...]  # atan t = t + t z P(z), |t| <= tan(pi/8)
    half_pi: tuple[float, float]
    ln2: tuple[float, float]
    two_over_pi: float
    one_over_ln2: float
    pi: float
    pi_2: float
    pi_4: float
    tansig_limit: float  # tanh rounds to 1 from here on
    sqrt_steps: tuple[int, ...]  # exponents by which a square root's argument is brought into [1, 4)
    heron_steps: int
    smallest: float  # smallest normal number
    largest: float


ANGLE_LIMIT = 1024.0  # rad: largest angle that sincos reduces exactly
EXP_LIMIT = 43.0  # largest exponent that exp takes
TAN_PI_8 = 0.41421356  # where atan2 turns to the second octant; any value near tan(pi/8) is right
SQRT_GUESS = (0.5375, 0.4905, -0.0305)  # sqrt(m) on [1, 4) to 0.7 per cent, refined by Heron's steps

_FLOAT = Coefficients(
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
_DOUBLE = Coefficients(
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
COEFFICIENTS: dict[str, Coefficients] = {"float": _FLOAT, "double": _DOUBLE}
DTYPE: dict[str, Any] = {"float": np.float32, "double": np.float64}


def turn_parts(c: Coefficients, points: int) -> tuple[float, float, float]:
    """Points per radian of a turn in so many points (a power of two), and their spacing [rad] in two parts."""
    high, low = (4 / points * part for part in c.half_pi)
    return points / 4 * c.two_over_pi, high, low


def literal(value: float, real: Real) -> str:
    """A C99 constant with exactly the value that ``value`` has when rounded to the real type."""
    rounded = float(DTYPE[real](value))
    small_whole = rounded == int(rounded) and abs(rounded) < 1e6 if abs(rounded) < 1e9 else False
    text = repr(rounded) if small_whole else _short_hex(rounded)
    return text + ("F" if real == "float" else "")


def _short_hex(value: float) -> str:
    mantissa, exponent = value.hex().split("p")
    mantissa = mantissa.rstrip("0") if "." in mantissa else mantissa
    return f"{mantissa.rstrip('.')}p{exponent}"

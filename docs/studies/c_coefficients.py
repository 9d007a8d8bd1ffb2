"""Run `python docs/studies/c_coefficients.py` (needs mpmath): the polynomials of the exported C's elementary functions.

Near-minimax fits through Chebyshev nodes in 120 digits, rounded to the format; prints the table that
casadical/export/c/coefficients.py holds, with the largest error of each polynomial (relative to the function's scale).
"""

import mpmath as mp
import numpy as np

mp.mp.dps = 120
_TINY = mp.mpf(10) ** -30


def _coth(z):
    return (mp.sqrt(z) * mp.coth(mp.sqrt(z) / 2) - 2) / z


def _sin(z):
    return (mp.sin(mp.sqrt(z)) / mp.sqrt(z) - 1) / z


def _cos(z):
    return (mp.cos(mp.sqrt(z)) - 1 + z / 2) / z**2


def _atan(z):
    return (mp.atan(mp.sqrt(z)) / mp.sqrt(z) - 1) / z


# name: (function of z, largest z, power of z in front, terms in float, terms in double)
FITS = {
    "coth": (_coth, (mp.log(2) / 2) ** 2 * mp.mpf("1.02"), 1, 2, 5),
    "sin": (_sin, (mp.pi / 4) ** 2 * mp.mpf("1.02"), 1, 3, 6),
    "cos": (_cos, (mp.pi / 4) ** 2 * mp.mpf("1.02"), 2, 3, 6),
    "atan": (_atan, (mp.sqrt(2) - 1) ** 2 * mp.mpf("1.01"), 1, 5, 11),
}


def fit(function, hi, n):
    """Coefficients of the polynomial of n terms through the Chebyshev nodes of [0, hi]."""
    nodes = [hi / 2 * (1 + mp.cos(mp.pi * (2 * k + 1) / (2 * n))) for k in range(n)]
    matrix = mp.matrix(n, n)
    for i, z in enumerate(nodes):
        for j in range(n):
            matrix[i, j] = z**j
    solution = mp.lu_solve(matrix, mp.matrix([function(z) for z in nodes]))
    return [solution[j] for j in range(n)]


def rounded(value, dtype):
    if dtype is np.float64:
        return float(value)
    return float(np.float32(mp.nstr(value, 40)))


def worst(function, hi, power, coefficients):
    grid = [max(_TINY, hi * k / 400) for k in range(401)]
    return max(abs(sum(mp.mpf(c) * z**j for j, c in enumerate(coefficients)) - function(z)) * z**power for z in grid)


def split(value, bits, dtype):
    """value as a sum of a part of few bits, whose small multiples are exact, and the rest."""
    exponent = int(mp.floor(mp.log(value, 2)))
    head = mp.floor(value * mp.mpf(2) ** (bits - 1 - exponent)) / mp.mpf(2) ** (bits - 1 - exponent)
    return rounded(head, dtype), rounded(value - head, dtype)


def main():
    for dtype, column, pi_bits, ln_bits in ((np.float32, 3, 12, 17), (np.float64, 4, 33, 33)):
        print(dtype.__name__)
        for name, entry in FITS.items():
            terms = [rounded(c, dtype) for c in fit(entry[0], entry[1], entry[column])]
            error = worst(entry[0], entry[1], entry[2], terms)
            print(f"  {name} = {tuple(terms)!r}  # worst {mp.nstr(error, 2)}")
        print(f"  half_pi = {split(mp.pi / 2, pi_bits, dtype)!r}")
        print(f"  ln2 = {split(mp.log(2), ln_bits, dtype)!r}")
        print(f"  two_over_pi = {rounded(2 / mp.pi, dtype)!r}, one_over_ln2 = {rounded(1 / mp.log(2), dtype)!r}")
        print(f"  pi, pi/2, pi/4 = {[rounded(mp.pi / k, dtype) for k in (1, 2, 4)]}")


if __name__ == "__main__":
    main()

"""The exported C's arithmetic in NumPy, operation for operation: the bits that the compiled C must give.

Nothing here calls NumPy's own sin, exp or sqrt; every line has its counterpart in the templates and rounds where the C
rounds.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from casadical.core.basics import Array
from casadical.export.c import coefficients
from casadical.export.c.tape import Tape


class NumpyFunctions:
    """Elementary functions of one real type on arrays."""

    def __init__(self, real: coefficients.Real) -> None:
        self.T = coefficients.DTYPE[real]
        self.c: coefficients.Coefficients = coefficients.COEFFICIENTS[real]

    def _poly(self, terms: tuple[float, ...], z: Array) -> Array:
        value = np.full_like(z, self.T(terms[-1]))
        for term in reversed(terms[:-1]):
            value = self.T(term) + z * value
        return value

    def sincos(self, x: Array) -> tuple[Array, Array]:
        T, c = self.T, self.c
        whole = np.trunc(x * T(c.two_over_pi) + T(1024.5))
        k = whole - T(1024)
        r = (x - k * T(c.half_pi[0])) - k * T(c.half_pi[1])
        z = r * r
        s = r + (r * z) * self._poly(c.sin, z)
        co = (T(1) - T(0.5) * z) + (z * z) * self._poly(c.cos, z)
        q = whole.astype(np.int64) & 3
        sin, cos = np.where(q & 1, co, s), np.where(q & 1, s, co)
        return np.where(q & 2, -sin, sin), np.where((q + 1) & 2, -cos, cos)

    def periodic(self, x: Array, table: tuple[float, ...]) -> Array:
        T, points = self.T, len(table) - 3
        c, offset = np.array(table).astype(T), T(coefficients.TURNS * points)
        per_radian, high, low = (T(v) for v in coefficients.turn_parts(self.c, points))
        k = np.trunc(x * per_radian + offset).astype(np.int64)
        n = k.astype(T) - offset
        t = ((x - n * high) - n * low) * per_radian
        i = k & (points - 1)
        ends, middle = c[i] + c[i + 2], c[i + 1] + c[i + 1]
        cubic = (c[i + 3] - c[i]) - T(3) * (c[i + 2] - c[i + 1])
        square, slope = T(3) * (ends - middle), T(3) * (c[i + 2] - c[i])
        value: Array = (ends + (middle + middle)) + t * (slope + t * (square + t * cubic))
        return value

    def _reduced(self, y: Array) -> tuple[Array, Array, Array]:
        """y >= 0 as n ln 2 + r: returns 2^n, r and r coth(r/2)."""
        T, c = self.T, self.c
        n = np.trunc(y * T(c.one_over_ln2) + T(0.5))
        r = (y - n * T(c.ln2[0])) - n * T(c.ln2[1])
        z = r * r
        return np.ldexp(T(1), n.astype(np.int64)).astype(T), r, T(2) + z * self._poly(c.coth, z)

    def tansig(self, a: Array) -> Array:
        T = self.T
        x = np.where(a < 0, -a, a)
        x = np.where(x < T(self.c.tansig_limit), x, T(self.c.tansig_limit))
        t, r, R = self._reduced(x + x)
        up, down = t + T(1), t - T(1)
        value = (down * R + up * r) / (up * R + down * r)
        value = np.where(value < T(1), value, T(1))
        signed: Array = np.where(a < 0, -value, value)
        return signed

    def exp(self, a: Array) -> Array:
        x = np.where(a < 0, -a, a)
        t, r, R = self._reduced(np.where(x < self.T(coefficients.EXP_LIMIT), x, self.T(coefficients.EXP_LIMIT)))
        up, down = t * (R + r), R - r
        negative = a < 0
        quotient: Array = np.where(negative, down, up) / np.where(negative, up, down)
        return quotient

    def sqrt(self, x: Array) -> Array:
        T = self.T
        m, s = x.copy(), np.ones_like(x)
        for k in self.c.sqrt_steps:
            high, low = m >= T(2.0**k), m < T(2.0 ** (2 - k))
            m = np.where(high, m * T(2.0**-k), np.where(low, m * T(2.0**k), m))
            s = np.where(high, s * T(2.0 ** (k // 2)), np.where(low, s * T(2.0 ** -(k // 2)), s))
        y = T(coefficients.SQRT_GUESS[0]) + m * (T(coefficients.SQRT_GUESS[1]) + m * T(coefficients.SQRT_GUESS[2]))
        for _ in range(self.c.heron_steps):
            y = T(0.5) * (y + m / y)
        root: Array = np.where(x < T(self.c.smallest), T(0), s * y)
        return root

    def atan2(self, y: Array, x: Array) -> Array:
        T, c = self.T, self.c
        ax, ay = np.where(x < 0, -x, x), np.where(y < 0, -y, y)
        steep = ay > ax
        hi, lo = np.where(steep, ay, ax), np.where(steep, ax, ay)
        second = lo > T(coefficients.TAN_PI_8) * hi
        den = np.where(second, hi + lo, hi)
        t = np.where(second, lo - hi, lo) / np.where(den < T(c.smallest), T(1), den)
        z = t * t
        angle = t + (t * z) * self._poly(c.atan, z)
        angle = np.where(second, T(c.pi_4) + angle, angle)
        angle = np.where(steep, T(c.pi_2) - angle, angle)
        angle = np.where(x < 0, T(c.pi) - angle, angle)
        return np.where(y < 0, -angle, angle)


def _simple(T: Any) -> dict[str, Callable[..., Any]]:
    one, zero = T(1), T(0)
    return {
        "add": lambda a, b: a + b,
        "sub": lambda a, b: a - b,
        "mul": lambda a, b: a * b,
        "div": lambda a, b: a / b,
        "neg": lambda a: -a,
        "fabs": lambda a: np.where(a < 0, -a, a),
        "fmin": lambda a, b: np.where(a < b, a, b),
        "fmax": lambda a, b: np.where(a > b, a, b),
        "lt": lambda a, b: np.where(a < b, one, zero),
        "le": lambda a, b: np.where(a <= b, one, zero),
        "select": lambda a, b: np.where(a > zero, b, zero),
        "not": lambda a: np.where(a > zero, zero, one),
        "sign": lambda a: np.where(a < 0, -one, np.where(a > 0, one, zero)),
    }


_ROWS_AT_ONCE = 4096  # keeps the values of a long tape in the cache


def run(tape: Tape, inputs: Array, real: coefficients.Real) -> tuple[Array, Array]:
    """Evaluate a tape on many inputs.

    inputs : array, shape (k, n_in), already of the real type

    Returns the outputs, shape (k, n_out), and a boolean array, shape (k,), false where a guard of the tape was touched
    (no real root, argument out of range).
    """
    starts = range(0, max(len(inputs), 1), _ROWS_AT_ONCE)
    parts = [_run(tape, inputs[start : start + _ROWS_AT_ONCE], real) for start in starts]
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


def _run(tape: Tape, inputs: Array, real: coefficients.Real) -> tuple[Array, Array]:
    mirror = NumpyFunctions(real)
    T, simple = mirror.T, _simple(mirror.T)
    k = len(inputs)
    fine = np.ones(k, bool)
    values: list[Any] = []
    with np.errstate(all="ignore"):
        for node in tape.nodes:
            args = [values[a] for a in node.args]
            if node.op == "input":
                values.append(np.ascontiguousarray(inputs[:, int(node.value)], T))
            elif node.op == "const":
                values.append(np.full(k, T(node.value)))
            elif node.op == "periodic":
                values.append(mirror.periodic(args[0], node.table))
            elif node.op == "weighted_sum":
                total = T(node.weights[0]) * args[0]
                for weight, value in zip(node.weights[1:], args[1:], strict=True):
                    total = total + T(weight) * value
                values.append(total)
            elif node.op in ("sin", "cos"):
                values.append(args[0][0 if node.op == "sin" else 1])
            elif node.op in ("guard_min", "guard_max"):
                limit = T(node.value)
                inside = args[0] >= limit if node.op == "guard_min" else args[0] <= limit
                fine &= inside
                values.append(np.where(inside, args[0], limit))
            else:
                values.append((simple.get(node.op) or getattr(mirror, node.op))(*args))
    return np.stack([values[o] for o in tape.outputs], 1).astype(T, copy=False), fine

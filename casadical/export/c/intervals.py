"""Interval analysis of a tape: bounds of every value over a box of inputs, and which guards can never be touched.

Bounds are outward: each operation's result is widened by more than the rounding of the real type it will run in.
"""

import math
from collections.abc import Callable
from dataclasses import replace

from casadical.core.basics import Array
from casadical.export.c.coefficients import COEFFICIENTS, DTYPE, Real
from casadical.export.c.tape import Node, Tape

Interval = tuple[float, float]
_EVERYTHING: Interval = (-math.inf, math.inf)
_WIDEN = {"float": 2.0**-21, "double": 2.0**-50}  # at least four roundings


def _products(a: Interval, b: Interval) -> Interval:
    if math.inf in (-a[0], a[1], -b[0], b[1]):
        return _EVERYTHING
    values = [x * y for x in a for y in b]
    return min(values), max(values)


def _magnitude(a: Interval) -> Interval:
    return (0.0 if a[0] <= 0.0 <= a[1] else min(abs(a[0]), abs(a[1]))), max(abs(a[0]), abs(a[1]))


_RULES: dict[str, Callable[..., Interval]] = {
    "add": lambda a, b: (a[0] + b[0], a[1] + b[1]),
    "sub": lambda a, b: (a[0] - b[1], a[1] - b[0]),
    "div": lambda a, b: _EVERYTHING if b[0] <= 0.0 <= b[1] else _products(a, (1.0 / b[1], 1.0 / b[0])),
    "neg": lambda a: (-a[1], -a[0]),
    "sqrt": lambda a: (math.sqrt(max(a[0], 0.0)), math.sqrt(max(a[1], 0.0))),
    "exp": lambda a: (math.exp(min(max(a[0], -44.0), 44.0)), math.exp(max(min(a[1], 44.0), -44.0))),
    "tansig": lambda _a: (-1.0, 1.0),  # the C clamps it
    "atan2": lambda _y, _x: (-math.pi, math.pi),
    "fabs": _magnitude,
    "fmin": lambda a, b: (min(a[0], b[0]), min(a[1], b[1])),
    "fmax": lambda a, b: (max(a[0], b[0]), max(a[1], b[1])),
    "lt": lambda _a, _b: (0.0, 1.0),
    "le": lambda _a, _b: (0.0, 1.0),
    "not": lambda _a: (0.0, 1.0),
    "sign": lambda _a: (-1.0, 1.0),
    "select": lambda _a, b: (min(b[0], 0.0), max(b[1], 0.0)),
    "sincos": lambda a: a,
    "sin": lambda _a: (-1.0, 1.0),
    "cos": lambda _a: (-1.0, 1.0),
}
_EXACT = {"input", "const", "neg", "fabs", "fmin", "fmax", "tansig", "lt", "le", "not", "sign", "select", "sincos"}


def _weighted_sum(weights: tuple[float, ...], args: list[Interval], real: Real) -> Interval:
    """Each of n products is rounded once and takes part in at most n rounded sums."""
    terms = [_products((w, w), a) for w, a in zip(map(DTYPE[real], weights), args, strict=True)]
    if _EVERYTHING in terms:
        return _EVERYTHING
    room = _WIDEN[real] * len(terms) * sum(max(abs(low), abs(high)) for low, high in terms)
    return sum(low for low, _ in terms) - room, sum(high for _, high in terms) + room


def _bound(node: Node, args: list[Interval], box: list[Interval], real: Real) -> Interval:
    if node.op == "input":
        return box[int(node.value)]
    if node.op == "const":
        rounded = float(DTYPE[real](node.value))
        return rounded, rounded
    if node.op == "guard_min":
        return max(args[0][0], node.value), max(args[0][1], node.value)
    if node.op == "guard_max":
        return min(args[0][0], node.value), min(args[0][1], node.value)
    if node.op == "periodic":
        # A spline lies between its least and greatest coefficient; a rounded place may be a hundredth outside its cell.
        low, high = 6 * min(node.table), 6 * max(node.table)
        return low - 1e-3 * (high - low), high + 1e-3 * (high - low)
    if node.op == "weighted_sum":
        return _weighted_sum(node.weights, args, real)
    if node.op == "mul" and node.args[0] != node.args[1]:
        return _products(*args)
    if node.op == "mul":
        low, high = _magnitude(args[0])
        return low * low, high * high
    return _RULES[node.op](*args)


def _widened(interval: Interval, real: Real) -> Interval:
    """The interval with room for rounding; everything (and NaN) where it could overflow."""
    c, share = COEFFICIENTS[real], _WIDEN[real]
    low, high = (v - abs(v) * share * s - c.smallest * s for v, s in zip(interval, (1.0, -1.0), strict=True))
    return (low, high) if low >= -c.largest and high <= c.largest else _EVERYTHING


def bounds(tape: Tape, lower: Array, upper: Array, real: Real) -> list[Interval]:
    """An interval for every node of the tape, for inputs in [lower, upper] (arrays of shape (n_in,)).

    The bounds hold for the arithmetic of the real type as well, not only for real numbers.
    """
    intervals: list[Interval] = []
    box = [(float(a), float(b)) for a, b in zip(lower, upper, strict=True)]
    for node in tape.nodes:
        exact = _bound(node, [intervals[a] for a in node.args], box, real)
        keep = node.op in _EXACT or (node.op == "mul" and exact == (0.0, 0.0))
        intervals.append(exact if keep else _widened(exact, real))
    return intervals


def without_needless_guards(tape: Tape, lower: Array, upper: Array, real: Real) -> Tape:
    """The tape without the guards that no input of the box can touch."""
    intervals = bounds(tape, lower, upper, real)
    place: list[int] = []
    kept: list[Node] = []
    for node in tape.nodes:
        args = tuple(place[a] for a in node.args)
        low, high = intervals[node.args[0]] if node.args else _EVERYTHING
        proven = math.isfinite(low) and math.isfinite(high)
        if proven and (
            (node.op == "guard_min" and low >= node.value) or (node.op == "guard_max" and high <= node.value)
        ):
            place.append(args[0])
        else:
            place.append(len(kept))
            kept.append(replace(node, args=args))
    return Tape(tuple(kept), tape.n_in, tuple(place[o] for o in tape.outputs))

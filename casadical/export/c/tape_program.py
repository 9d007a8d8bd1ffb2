"""The tapes of a product, optimized by interval analysis: what every target language writes.

The interval analysis bounds every value of a tape over a box of inputs and finds guards that can
never be violated. Bounds are outward: each operation's result is widened by more than the rounding
of the real type in which it will run (Moore, Interval Analysis, 1966).
"""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array
from casadical.export.c.chord import advance, prepare
from casadical.export.c.coefficients import COEFFICIENTS, NUMPY_TYPE, Real
from casadical.export.c.products import Command, NetworkFunction, Product
from casadical.export.c.tape import Node, Tape, tape_of

# Type of lower and upper bound of a value.
Interval = tuple[float, float]
# Interval of a value without bounds.
_REAL_LINE: Interval = (-math.inf, math.inf)


def _products(a: Interval, b: Interval) -> Interval:
    """Return the interval of x y for x in a and y in b."""
    if math.inf in (-a[0], a[1], -b[0], b[1]):
        return _REAL_LINE
    values = [x * y for x in a for y in b]
    return min(values), max(values)


def _magnitude(a: Interval) -> Interval:
    """Return the interval of |x| for x in a."""
    return (0.0 if a[0] <= 0.0 <= a[1] else min(abs(a[0]), abs(a[1]))), max(abs(a[0]), abs(a[1]))


# Function from the intervals of an operation's arguments to that of its result, by its name.
_INTERVAL_RULES: dict[str, Callable[..., Interval]] = {
    "add": lambda a, b: (a[0] + b[0], a[1] + b[1]),
    "sub": lambda a, b: (a[0] - b[1], a[1] - b[0]),
    "div": lambda a, b: _REAL_LINE if b[0] <= 0.0 <= b[1] else _products(a, (1.0 / b[1], 1.0 / b[0])),
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


def _bound(node: Node, args: list[Interval], box: list[Interval], real: Real) -> Interval:
    """Return the interval of a node's result, before it is widened for rounding."""
    if node.op == "input":
        return box[int(node.value)]
    if node.op == "const":
        rounded = float(NUMPY_TYPE[real](node.value))
        return rounded, rounded
    if node.op == "guard_min":
        return max(args[0][0], node.value), max(args[0][1], node.value)
    if node.op == "guard_max":
        return min(args[0][0], node.value), min(args[0][1], node.value)
    if node.op == "periodic":
        # A spline lies between its least and greatest coefficient; a rounded place may be a
        # hundredth outside its cell.
        low, high = 6 * min(node.table), 6 * max(node.table)
        return low - 1e-3 * (high - low), high + 1e-3 * (high - low)
    if node.op == "mul" and node.args[0] != node.args[1]:
        return _products(*args)
    if node.op == "mul":
        low, high = _magnitude(args[0])
        return low * low, high * high
    return _INTERVAL_RULES[node.op](*args)


def bounds(tape: Tape, lower: Array, upper: Array, real: Real) -> list[Interval]:
    """Return bounds of the result of every node of a tape, for inputs within a box.

    They hold in the arithmetic of the real type as well, not only for real numbers.

    lower, upper : ends of the box of inputs, shape (n_in,)
    """
    intervals: list[Interval] = []
    largest, smallest = COEFFICIENTS[real].largest, COEFFICIENTS[real].smallest
    share = 2.0**-21 if real == "float" else 2.0**-50  # at least four roundings
    box = [(float(a), float(b)) for a, b in zip(lower, upper, strict=True)]
    # Results of these operations are not rounded, or clamped: their intervals need no widening.
    unrounded = {
        *("input", "const", "neg", "fabs", "fmin", "fmax", "tansig"),
        *("lt", "le", "not", "sign", "select", "sincos"),
    }
    for node in tape.nodes:
        exact = _bound(node, [intervals[a] for a in node.args], box, real)
        if not (node.op in unrounded or (node.op == "mul" and exact == (0.0, 0.0))):
            low, high = (v - abs(v) * share * s - smallest * s for v, s in zip(exact, (1.0, -1.0), strict=True))
            # Where the operation could overflow, its result may be anything.
            exact = (low, high) if low >= -largest and high <= largest else _REAL_LINE
        intervals.append(exact)
    return intervals


def without_needless_guards(tape: Tape, lower: Array, upper: Array, real: Real) -> Tape:
    """Return the tape without the guards of bounded values that no input within a box can violate.

    lower, upper : ends of the box of inputs, shape (n_in,)
    """
    intervals = bounds(tape, lower, upper, real)
    place: list[int] = []
    nodes: list[Node] = []
    for node in tape.nodes:
        args = tuple(place[a] for a in node.args)
        low, high = intervals[node.args[0]] if node.args else _REAL_LINE
        needless = (node.op == "guard_min" and low >= node.value) or (node.op == "guard_max" and high <= node.value)
        if needless and math.isfinite(low) and math.isfinite(high):
            place.append(args[0])
        else:
            place.append(len(nodes))
            nodes.append(replace(node, args=args))
    return Tape(tuple(nodes), tape.n_in, tuple(place[o] for o in tape.outputs))


@dataclass(frozen=True)
class TapeProgram:
    """A product with its tapes, ready to be written in any target language.

    product : network, curves or command
    real : type of numbers, "float" or "double"
    tapes : tapes by name: "network" or "curves"; of a command also "forward", "prepare", "advance"
    network_bounds : lower and upper bound of each output of network or curves over its box, in its
        unit; empty without them
    name : prefix of functions and files, a C identifier
    model_sha256, data_sha256 : hashes of the model and the data that it was made from
    """

    product: Product
    real: Real
    tapes: dict[str, Tape]
    network_bounds: tuple[Interval, ...]
    name: str
    model_sha256: str
    data_sha256: str

    @property
    def n(self) -> int:
        """Return the number of joints."""
        return len(self.product.lower)

    @property
    def command(self) -> Command | None:
        """Return the product if it is a joint-command correction, else None."""
        return self.product if isinstance(self.product, Command) else None

    @property
    def sum_scale(self) -> float:
        """Return the power of two that scales n finite numbers so that their sum is finite."""
        return 2.0 ** -(self.n - 1).bit_length()

    @property
    def boxes(self) -> dict[str, tuple[Array, Array]]:
        """Return the boxes to which joints are clipped, lower and upper end by purpose, (n,) each.

        They are `command` for the correction, `reach` for the forward kinematics (the same box
        enlarged by the largest correction), and `network` for network or curves [rad or m].
        """
        boxes: dict[str, tuple[Array, Array]] = {}
        if self.command is not None:
            lower, upper, reach = self.command.lower, self.command.upper, self.command.limits.delta_rad
            boxes |= {"command": (lower, upper), "reach": (lower - reach, upper + reach)}
        if self.network is not None:
            boxes["network"] = (self.network.lower, self.network.upper)
        return boxes

    @property
    def network(self) -> NetworkFunction | None:
        """Return the network or the curves, alone or those of a command; None if it has none."""
        return self.product.network if isinstance(self.product, Command) else self.product


@dataclass(frozen=True)
class Operations:
    """Numbers of operations in one call of an exported function; they are the same in every call.

    of : name of the function; count : number of operations by kind
    """

    of: str
    count: dict[str, int]

    def text(self) -> str:
        """Return the numbers of operations as a sentence, the most frequent kind first."""
        words = [f"{self.count[kind]} {kind}" for kind in sorted(self.count, key=lambda k: -self.count[k])]
        return f"Operations of {self.of}, the same in every call: {', '.join(words)}."


# Kind under which `operations` counts each operation of a tape; others count as "choices".
_OPERATION_KINDS = {"add": "additions", "sub": "additions", "mul": "multiplications", "div": "divisions"}
_OPERATION_KINDS |= {op: op for op in ("sincos", "sqrt", "exp", "tansig", "atan2", "periodic")}


def operations(program: TapeProgram) -> Operations:
    """Return the numbers of operations of one call of the correction, if the program has one.

    Otherwise they are those of one call of the network or of the error curves.
    """
    key = program.network.key if program.network is not None else ""
    calls = {key: 1}
    if program.command is not None:
        key, steps = "correct", program.command.steps
        calls = {"prepare": 1, "forward": steps, "advance": steps + 1}
    count: Counter[str] = Counter()
    for tape, times in calls.items():
        for node in program.tapes[tape].nodes:
            if node.op not in ("input", "const", "sin", "cos"):
                count[_OPERATION_KINDS.get(node.op, "choices")] += times
    return Operations(key, dict(count))


def tape_program(
    product: Product,
    real: Real,
    name: str = "arm",
    model_sha256: str = "not given",
    data_sha256: str = "not given",
) -> TapeProgram:
    """Return a product's tapes for a real type, without the guards that its box makes needless."""
    tapes: dict[str, Tape] = {}
    network = product if isinstance(product, NetworkFunction) else product.network
    network_bounds: list[Interval] = []

    def rounded(bound: Array) -> Array:
        """Return numbers rounded to the real type, as doubles."""
        return bound.astype(NUMPY_TYPE[real]).astype(np.float64)

    if network is not None:
        lower, upper = rounded(network.lower), rounded(network.upper)
        tape = without_needless_guards(tape_of(network.function), lower, upper, real)
        intervals = bounds(tape, lower, upper, real)
        tapes[network.key], network_bounds = tape, [intervals[o] for o in tape.outputs]
    if isinstance(product, Command):
        # Joints and corrections are added, and rounded, in the real type.
        reach = 1.001 * product.limits.delta_rad
        lower, upper = rounded(product.lower), rounded(product.upper)
        forward, step = tape_of(product.calibrated), tape_of(advance(product))
        anything = np.full(step.n_in, np.inf)
        tapes["forward"] = without_needless_guards(forward, lower - reach, upper + reach, real)
        tapes["prepare"] = without_needless_guards(tape_of(prepare(product)), lower, upper, real)
        tapes["advance"] = without_needless_guards(step, -anything, anything, real)
    return TapeProgram(product, real, tapes, tuple(network_bounds), name, model_sha256, data_sha256)

"""NumPy reference of the exported C, bit for bit what the compiled C must return.

Each function follows the C template of the same name, statuses included, and rounds where the C
rounds; nothing here calls NumPy's own sin, exp or sqrt.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import Any

import numpy as np

from casadical.core.basics import Array
from casadical.export.c import coefficients
from casadical.export.c.chord import prepared_size
from casadical.export.c.coefficients import NUMPY_TYPE
from casadical.export.c.products import Command
from casadical.export.c.tape import Tape
from casadical.export.c.tape_program import TapeProgram


class NumpyFunctions:
    """Elementary functions of one real type on arrays, with each rounding as in the C.

    T : NumPy type of numbers; c : constants of the real type
    """

    def __init__(self, real: coefficients.Real) -> None:
        self.T = coefficients.NUMPY_TYPE[real]
        self.c: coefficients.Coefficients = coefficients.COEFFICIENTS[real]

    def _poly(self, terms: tuple[float, ...], z: Array) -> Array:
        """Return the polynomial in z with coefficients `terms`, lowest first (Horner's rule)."""
        value = np.full_like(z, self.T(terms[-1]))
        for term in reversed(terms[:-1]):
            value = self.T(term) + z * value
        return value

    def sincos(self, x: Array) -> tuple[Array, Array]:
        """Return sine and cosine of angles x [rad], |x| up to `ANGLE_LIMIT`."""
        T, c = self.T, self.c
        count = np.trunc(x * T(c.two_over_pi) + T(1024.5))
        k = count - T(1024)
        r = (x - k * T(c.half_pi[0])) - k * T(c.half_pi[1])
        z = r * r
        s = r + (r * z) * self._poly(c.sin, z)
        co = (T(1) - T(0.5) * z) + (z * z) * self._poly(c.cos, z)
        q = count.astype(np.int64) & 3
        sin, cos = np.where(q & 1, co, s), np.where(q & 1, s, co)
        return np.where(q & 2, -sin, sin), np.where((q + 1) & 2, -cos, cos)

    def periodic(self, x: Array, table: tuple[float, ...]) -> Array:
        """Return the value of a spline table, see `spline_table`, at angles x [rad].

        |x| is up to `MAX_TABLE_ANGLE_RAD`.
        """
        T, points = self.T, len(table) - 3
        c, offset = np.array(table).astype(T), T(coefficients.ADDED_TURNS * points)
        per_radian, high, low = (T(v) for v in coefficients.turn_parts(self.c, points))
        k = np.trunc(x * per_radian + offset).astype(np.int64)
        n = k.astype(T) - offset
        t = ((x - n * high) - n * low) * per_radian
        i = k & (points - 1)
        ends, middle = c[i] + c[i + 2], c[i + 1] + c[i + 1]
        cubic = (c[i + 3] - c[i]) - T(3) * (c[i + 2] - c[i + 1])
        square, slope = T(3) * (ends - middle), T(3) * (c[i + 2] - c[i])
        return np.asarray((ends + (middle + middle)) + t * (slope + t * (square + t * cubic)))

    def _reduced(self, y: Array) -> tuple[Array, Array, Array]:
        """Return 2^n, r and r coth(r/2) for y = n ln 2 + r >= 0, with an integer n, to compute exp.

        The magnitude of r is at most half of ln 2.
        """
        T, c = self.T, self.c
        n = np.trunc(y * T(c.one_over_ln2) + T(0.5))
        r = (y - n * T(c.ln2[0])) - n * T(c.ln2[1])
        z = r * r
        return np.ldexp(T(1), n.astype(np.int64)).astype(T), r, T(2) + z * self._poly(c.coth, z)

    def tansig(self, a: Array) -> Array:
        """Return tanh(a), computed without cancellation near zero."""
        T = self.T
        x = np.where(a < 0, -a, a)
        x = np.where(x < T(self.c.tansig_limit), x, T(self.c.tansig_limit))
        t, r, R = self._reduced(x + x)
        up, down = t + T(1), t - T(1)
        value = (down * R + up * r) / (up * R + down * r)
        value = np.where(value < T(1), value, T(1))
        return np.asarray(np.where(a < 0, -value, value))

    def exp(self, a: Array) -> Array:
        """Return exp(a), with a clipped to +-`EXP_LIMIT`."""
        x = np.where(a < 0, -a, a)
        t, r, R = self._reduced(np.where(x < self.T(coefficients.EXP_LIMIT), x, self.T(coefficients.EXP_LIMIT)))
        up, down = t * (R + r), R - r
        negative = a < 0
        return np.asarray(np.where(negative, down, up) / np.where(negative, up, down))

    def sqrt(self, x: Array) -> Array:
        """Return the square root of x >= 0, by scaling into [1, 4) and Heron's steps.

        Arguments below the smallest normal number give 0.
        """
        T = self.T
        m, s = x.copy(), np.ones_like(x)
        for k in self.c.sqrt_steps:
            high, low = m >= T(2.0**k), m < T(2.0 ** (2 - k))
            m = np.where(high, m * T(2.0**-k), np.where(low, m * T(2.0**k), m))
            s = np.where(high, s * T(2.0 ** (k // 2)), np.where(low, s * T(2.0 ** -(k // 2)), s))
        y = T(coefficients.SQRT_GUESS[0]) + m * (T(coefficients.SQRT_GUESS[1]) + m * T(coefficients.SQRT_GUESS[2]))
        for _ in range(self.c.heron_steps):
            y = T(0.5) * (y + m / y)
        return np.asarray(np.where(x < T(self.c.smallest), T(0), s * y))

    def atan2(self, y: Array, x: Array) -> Array:
        """Return the angle [rad] of the points (x, y) from the x axis, from -pi to pi."""
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
    """Return the function of each operation that is one NumPy expression, by the operation's name."""
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


def run(tape: Tape, inputs: Array, real: coefficients.Real) -> tuple[Array, Array]:
    """Return the outputs of a tape, (k, n_out), at k inputs, and a mask of valid ones, (k,).

    The arithmetic is that of the exported C. The mask is false where a guard of the tape was
    violated (no real root, argument out of range).

    inputs : shape (k, n_in), of the real type already
    """
    size = 4096  # rows at once, which keeps the values of a long tape in the cache
    starts = range(0, max(len(inputs), 1), size)
    parts = [_run(tape, inputs[start : start + size], real) for start in starts]
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


def _run(tape: Tape, inputs: Array, real: coefficients.Real) -> tuple[Array, Array]:
    """Return outputs and mask as of `run`, for k rows of inputs that are evaluated at once."""
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


class Status(IntEnum):
    """Status that every exported function returns; where several apply, the highest number wins.

    Examples
    --------
    >>> casadical.export.Status(0).name
    'OK'
    """

    OK = 0
    CLAMPED = 1
    RATE_LIMITED = 2
    NOT_CONVERGED = 3
    LIMITED = 4
    SINGULAR = 5
    NOT_FINITE = 6
    NULL_ARG = 7
    SELF_TEST_FAILED = 8


def boxed(q: Array, box: tuple[Array, Array], scale: float) -> tuple[Array, Array]:
    """Return joints clipped to a box, (k, n), and status OK, CLAMPED or NOT_FINITE of each, (k,).

    q : joints, shape (k, n) [rad or m]; box : lower and upper ends, each of shape (n,)
    """
    T = q.dtype.type
    lower, upper = box[0].astype(T), box[1].astype(T)
    moved = np.zeros(len(q), T)
    with np.errstate(all="ignore"):
        a = np.where(q > lower, q, lower)
        x = np.where(a < upper, a, upper)
        distance = np.where(x < q, q - x, x - q)
        for i in range(q.shape[1]):
            moved = moved + T(scale) * distance[:, i]
    status = np.where(moved > 0, Status.CLAMPED, Status.OK)
    return x, np.where(moved <= np.finfo(T).max, status, Status.NOT_FINITE)


def network(program: TapeProgram, q: Array) -> tuple[Array, Array]:
    """Return the outputs of network or curves, shape (k, m), and status, shape (k,), at joints q.

    Outputs are position corrections of a network [mm], true angles less readings of curves [rad],
    and zero where the status is NOT_FINITE.

    q : shape (k, n) [rad or m], clipped to the box of network or curves
    """
    assert program.network is not None
    return _values(program, q, program.network.key, "network")


def forward(program: TapeProgram, q: Array) -> tuple[Array, Array]:
    """Return the calibrated tool pose, shape (k, 3 or 12), and status, shape (k,), at readings q.

    The pose is the position [m] and, where the program has it, the columns of the rotation, in the
    robot's own base frame. It is zero where the status is NOT_FINITE.

    q : shape (k, n) [rad or m], clipped to the box `reach` of `TapeProgram.boxes`
    """
    return _values(program, q, "forward", "reach")


def _values(program: TapeProgram, q: Array, tape: str, box: str) -> tuple[Array, Array]:
    """Return outputs of a tape, (k, outputs), and statuses, (k,), at joints clipped to a box.

    The outputs are zero where the status is NOT_FINITE.

    q : joints, shape (k, n) [rad or m]; tape, box : names of the tape and of the box
    """
    q = np.ascontiguousarray(q, NUMPY_TYPE[program.real])
    x, status = boxed(q, program.boxes[box], program.sum_scale)
    values, fine = run(program.tapes[tape], x, program.real)
    status = np.where(fine & np.isfinite(values).all(1), status, Status.NOT_FINITE)
    values[status == Status.NOT_FINITE] = 0
    return values, status


def correct(program: TapeProgram, q: Array) -> tuple[Array, Array]:
    """Return corrections to add to commanded joints, (k, n) [rad or m], and status, shape (k,).

    With them the calibrated robot's tool is where the nominal robot has it at the command; they are
    zero where the status is NOT_FINITE.

    q : commanded joints, shape (k, n) [rad or m], which are clipped to the command's box
    """
    assert program.command is not None
    q = np.ascontiguousarray(q, NUMPY_TYPE[program.real])
    x, status = boxed(q, program.boxes["command"], program.sum_scale)
    dq, chord_status = _chord(program, program.command, x)
    bad = status == Status.NOT_FINITE
    dq[bad] = 0
    status = np.where(bad, status, np.maximum(status, chord_status))
    return dq, status


def _limited(v: Array, limit: Any) -> tuple[Array, Array]:
    """Return v, (k, n), with rows scaled so that no |entry| exceeds `limit`, and a mask, (k,).

    The mask is true for rows that were scaled.
    """
    largest = np.zeros(len(v), v.dtype)
    for i in range(v.shape[1]):
        magnitude = np.where(v[:, i] < 0, -v[:, i], v[:, i])
        largest = np.where(magnitude > largest, magnitude, largest)
    beyond = largest > limit
    scaled = v * (limit / np.where(beyond, largest, limit))[:, None]
    low = np.where(scaled > -limit, scaled, -limit)
    return np.where(low < limit, low, limit), beyond


def _chord(program: TapeProgram, command: Command, x: Array) -> tuple[Array, Array]:
    """Return joint corrections by the chord method, (k, n) [rad or m], and statuses, (k,).

    They start from zero and take the command's number of least-squares steps with the Jacobian at
    the command, and one more where the last one reduced the error to a third or less. They are zero
    where the status is NOT_FINITE.

    x : commanded joints within the box, shape (k, n) [rad or m]
    """
    T, real, numbers = NUMPY_TYPE[program.real], program.real, command.limits.numbers
    n, end = program.n, prepared_size(command)
    work, fine = run(program.tapes["prepare"], x, real)
    dq = np.zeros_like(x)
    moved = np.zeros((len(x), n + 1), T)
    before = np.full(len(x), np.finfo(T).max, T)
    wrong = work[:, end - 1] - work[:, end - 1]
    with np.errstate(all="ignore"):
        for step in range(command.steps + 1):
            if step > 0:
                before = moved[:, n].copy()
                work[:, end:], fine_now = run(program.tapes["forward"], x + dq, real)
                fine &= fine_now
            moved, fine_now = run(program.tapes["advance"], work, real)
            fine &= fine_now
            wrong = wrong + (moved[:, n] - moved[:, n])
            moved[:, :n], step_clamped = _limited(moved[:, :n], T(numbers["step"]))
            there, limited = _limited(dq + moved[:, :n], T(numbers["delta"]))
            taken = (step < command.steps) | (T(9) * moved[:, n] <= before)
            dq = np.where(taken[:, None], there, dq)
        fine &= wrong >= 0
        status = np.where(step_clamped | (moved[:, n] > T(numbers["tolerance2"])), Status.NOT_CONVERGED, Status.OK)
        status = np.where(limited, Status.LIMITED, status)
        status = np.where(work[:, end - 1] > T(numbers["weakness"]), Status.SINGULAR, status)
    dq[~fine] = 0
    return dq, np.where(fine, status, Status.NOT_FINITE)


def step(program: TapeProgram, last: Array, gain: Any, q: Array, enable: bool) -> tuple[Array, Any, Status]:
    """Return the correction of one controller cycle, shape (n,) [rad or m], its gain and status.

    It ramps in or out and follows `correct` within the limits per cycle (RATE_LIMITED). Values of
    the last cycle that are out of bounds are reset first (NOT_FINITE).

    last, gain : correction of the last cycle, shape (n,) [rad or m], and its gain, a factor from 0
        (off) to 1 (on); both zero before the first cycle
    q : commanded joints, shape (n,) [rad or m]; enable : whether the correction is on
    """
    assert program.command is not None
    T, numbers = NUMPY_TYPE[program.real], program.command.limits.numbers
    delta, change_limit, ramp = T(numbers["delta"]), T(numbers["change"]), T(numbers["ramp"])
    want, statuses = correct(program, q[None, :])
    status = Status(int(statuses[0]))
    last, gain = np.asarray(last, T), T(gain)
    if not (np.isfinite(last).all() and (abs(last) <= delta).all() and T(0) <= gain <= T(1)):
        last, gain, status = np.zeros(program.n, T), T(0), Status.NOT_FINITE
    gain = min(max(gain + (ramp if enable else -ramp), T(0)), T(1))
    change = gain * want[0] - last
    if (abs(change) > change_limit).any():
        status = max(status, Status.RATE_LIMITED)
    moved = last + np.clip(change, -change_limit, change_limit)
    return np.clip(moved, -delta, delta), gain, status

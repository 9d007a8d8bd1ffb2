"""The tapes of a product. The least-squares algebra of a command is written here once, in SX, for all languages.

The chord step: with J the Jacobian at the commanded joints, factored once as L D L^T = J J^T + lambda^2 I, each step
solves for y in L D L^T y = r and moves the joints by J^T y. After the last step the model is evaluated again, so that
the status is the error that is left and no estimate; the step that follows from it costs next to nothing and is taken.
"""

from dataclasses import dataclass

import casadi
import numpy as np
from casadi import SX

from casadical.core.arrays import Array
from casadical.export.c.coefficients import DTYPE, Real
from casadical.export.c.intervals import bounds, without_needless_guards
from casadical.export.c.products import Command, NetworkFunction, Product
from casadical.export.c.tape import Tape, tape_of


@dataclass(frozen=True)
class TapeProgram:
    """A product ready to be written.

    Parameters
    ----------
    product : Product
        what is exported
    real : Real
        type of its numbers
    tapes : dict[str, Tape]
        by name
    network_bounds : tuple[tuple[float, float], ...]
        least and greatest value of each of the network's outputs

    Examples
    --------
    >>> class Names(casadical.export.Language):
    ...     name = "names"
    ...
    ...     def files(self, program, label):
    ...         return {"names.txt": " ".join(program.tapes)}
    >>> Names().name
    'names'
    """

    product: Product
    real: Real
    tapes: dict[str, Tape]
    network_bounds: tuple[tuple[float, float], ...]  # of its unit, hold for every input

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.product.lower)

    @property
    def command(self) -> Command | None:
        """The product where it is a command."""
        return self.product if isinstance(self.product, Command) else None

    @property
    def network(self) -> NetworkFunction | None:
        """The network or the curves alone, or the network beside a command."""
        return self.product.network if isinstance(self.product, Command) else self.product


@dataclass(frozen=True)
class Operations:
    """How often each kind of operation occurs in a call: the same ones in every call."""

    of: str  # what is called
    count: dict[str, int]

    def text(self) -> str:
        """One sentence."""
        words = [f"{self.count[kind]} {kind}" for kind in sorted(self.count, key=lambda k: -self.count[k])]
        return f"Operations of {self.of}, the same in every call: {', '.join(words)}."


_KINDS = {"add": "additions", "sub": "additions", "mul": "multiplications", "div": "divisions"}
_KINDS |= {op: op for op in ("sincos", "sqrt", "exp", "tansig", "atan2", "periodic")}
_FREE = ("input", "const", "sin", "cos")


def operations(program: TapeProgram) -> Operations:
    """Operations of one correction, or of the network or the curves alone."""
    key = program.network.key if program.network is not None else ""
    calls = {key: 1}
    if program.command is not None:
        key, steps = "correct", program.command.steps
        calls = {"prepare": 1, "forward": steps, "advance": steps + 1}
        calls |= {"bound": 1} if program.command.limit_mm is not None else {}
    count: dict[str, int] = {}
    for tape, times in calls.items():
        for node in program.tapes[tape].nodes:
            if times and node.op not in _FREE:
                kind = _KINDS.get(
                    node.op, node.op if node.op in ("sqrt", "exp", "tansig", "atan2", "periodic") else "choices"
                )
                count[kind] = count.get(kind, 0) + times
    return Operations(key, count)


def tape_program(product: Product, real: Real) -> TapeProgram:
    """Tapes of a product.

    ``network`` or ``curves`` of these, ``forward``, ``prepare``, ``advance`` and perhaps ``network`` and ``bound`` of a
    command.
    """
    tapes: dict[str, Tape] = {}
    network = product if isinstance(product, NetworkFunction) else product.network
    network_bounds: list[tuple[float, float]] = []
    if network is not None:
        lower, upper = _rounded(network.lower, real), _rounded(network.upper, real)
        tape = without_needless_guards(tape_of(network.function), lower, upper, real)
        found = bounds(tape, lower, upper, real)
        tapes[network.key], network_bounds = tape, [found[o] for o in tape.outputs]
    if isinstance(product, Command):
        tapes |= _command_tapes(product, real)
    return TapeProgram(product, real, tapes, tuple(network_bounds))


def _rounded(bound: Array, real: Real) -> Array:
    return bound.astype(DTYPE[real]).astype(np.float64)


def _command_tapes(command: Command, real: Real) -> dict[str, Tape]:
    reach = 1.001 * command.limits.delta_rad  # joints and corrections are added in the real type, and rounded
    boxes: dict[str, tuple[Array, Array]] = {
        "forward": (_rounded(command.lower, real) - reach, _rounded(command.upper, real) + reach),
        "prepare": (_rounded(command.lower, real), _rounded(command.upper, real)),
    }
    tapes = {"forward": tape_of(command.calibrated), "prepare": tape_of(_prepare(command))}
    if command.bound is not None:
        boxes["bound"], tapes["bound"] = boxes["prepare"], tape_of(command.bound)
    tapes = {key: without_needless_guards(tape, *boxes[key], real) for key, tape in tapes.items()}
    anything = np.full(tape_of(_advance(command)).n_in, np.inf)
    return tapes | {"advance": without_needless_guards(tape_of(_advance(command)), -anything, anything, real)}


def _flat(function: casadi.Function, q: SX) -> SX:
    out = function.call([q])
    return casadi.vertcat(*[casadi.vec(o) for o in out])


def _residual(target: SX, now: SX, length: float) -> SX:
    """Position error [m], and for poses the rotation from now to target times a length."""
    if target.numel() == 3:
        return target - now
    turn = SX.zeros(3)
    for k in range(3):
        i = slice(3 + 3 * k, 6 + 3 * k)
        turn += casadi.cross(now[i], target[i])
    return casadi.vertcat(target[:3] - now[:3], 0.5 * length * turn)


def residual_size(command: Command) -> int:
    """3 for positions, 6 for poses."""
    return 3 if command.calibrated.numel_out(0) == 3 and command.calibrated.n_out() == 1 else 6


def _jacobian(command: Command, q: SX) -> SX:
    """The mean of the calibrated and the nominal robot's Jacobian at the commanded joints.

    The corrected robot will have its tool where the nominal one has it now: the mean of the two slopes is, nearly, the
    trapezoidal rule along the step, and leaves about half of the calibrated Jacobian's error.
    """
    function = command.jacobian_of if command.jacobian_of is not None else command.calibrated
    at = q if command.jacobian_at is None else _flat(command.jacobian_at, q)
    return 0.5 * (_slope(command, function, at) + _slope(command, command.nominal, q))


def _slope(command: Command, function: casadi.Function, at: SX) -> SX:
    """Jacobian of minus the residual with respect to the function's joints."""
    x, fixed = SX.sym("x", len(command.lower)), SX.sym("fixed", 3 if residual_size(command) == 3 else 12)
    now = _flat(function, x)
    slope = casadi.jacobian(-_residual(fixed, now, command.length_m), x)
    return casadi.Function("slope", [x, fixed], [slope])(at, _flat(function, at))


def _factored(A: SX, floor: float) -> tuple[SX, SX]:
    """Unit lower L and the inverted pivots of A = L D L^T, no pivot below the floor."""
    m = A.shape[0]
    L, d, inverse = SX.eye(m), SX.zeros(m), SX.zeros(m)
    for j in range(m):
        scaled = [L[j, k] * d[k] for k in range(j)]
        d[j] = casadi.fmax(A[j, j] - sum((L[j, k] * scaled[k] for k in range(j)), SX(0)), floor)
        inverse[j] = 1 / d[j]
        for i in range(j + 1, m):
            L[i, j] = (A[i, j] - sum((L[i, k] * scaled[k] for k in range(j)), SX(0))) * inverse[j]
    return L, inverse


def _weakness(L: SX, inverse: SX) -> SX:
    """Trace of A^-1, at least one over its smallest eigenvalue."""
    m = L.shape[0]
    columns = [_forward_solve(L, SX.eye(m)[:, j]) for j in range(m)]
    return sum((c[i] * c[i] * inverse[i] for j, c in enumerate(columns) for i in range(j, m)), SX(0))


def _forward_solve(L: SX, b: SX) -> SX:
    y = SX(b)
    for i in range(b.numel()):
        for k in range(i):
            y[i] -= L[i, k] * y[k]
    return y


def _lower(m: int) -> list[tuple[int, int]]:
    return [(i, j) for j in range(m) for i in range(j + 1, m)]


def _prepare(command: Command) -> casadi.Function:
    """q -> nominal position or pose, J, L below its diagonal, inverted pivots, weakness, calibrated one."""
    n, m = len(command.lower), residual_size(command)
    damping = command.limits.damping**2
    q = SX.sym("q", n)
    J = _jacobian(command, q)
    L, inverse = _factored(casadi.mtimes(J, J.T) + damping * SX.eye(m), damping / 2)
    below = casadi.vertcat(*[L[i, j] for i, j in _lower(m)])
    out = [
        _flat(command.nominal, q),
        casadi.vec(J),
        below,
        inverse,
        _weakness(L, inverse),
        _flat(command.calibrated, q),
    ]
    return casadi.Function("prepare", [q], [casadi.densify(casadi.vertcat(*out))], ["q"], ["prepared"])


def prepared_size(command: Command) -> int:
    """How many numbers ``prepare`` gives before the calibrated position or pose."""
    m = residual_size(command)
    return (3 if m == 3 else 12) + m * len(command.lower) + m * (m - 1) // 2 + m + 1


def _advance(command: Command) -> casadi.Function:
    """(prepared, where the calibrated robot is) -> joint step, squared error before it."""
    n, m = len(command.lower), residual_size(command)
    size = 3 if m == 3 else 12
    prepared, now = SX.sym("prepared", prepared_size(command)), SX.sym("now", size)
    parts = casadi.vertsplit(prepared, list(np.cumsum([0, size, m * n, m * (m - 1) // 2, m, 1])))
    target, J, inverse = parts[0], casadi.reshape(parts[1], m, n), parts[3]
    L = SX.eye(m)
    for value, (i, j) in zip(casadi.vertsplit(parts[2]), _lower(m), strict=True):
        L[i, j] = value
    r = _residual(target, now, command.length_m)
    y = _forward_solve(L, r) * inverse
    for i in reversed(range(m)):
        for k in range(i + 1, m):
            y[i] -= L[k, i] * y[k]
    outputs = casadi.vertcat(casadi.mtimes(J.T, y), casadi.sumsqr(r))
    return casadi.Function("advance", [prepared, now], [outputs], ["prepared", "now"], ["moved"])

"""A CasADi SX function as a tape: a list of plain real operations in single-assignment form.

Equal operations on equal arguments are stored once, sines and cosines of one angle share an operation, and a tansig is
recognised however it is written. Where an operation takes only some numbers (square root, exp, sine of a huge angle) a
guard stands before it; what an interval analysis proves to be needless is removed (see intervals.py). A function that
is called (CasADi's option `never_inline`) becomes a weighted sum for each of its outputs where it is a constant matrix
times its input, else a table for each of them (see periodic_table.py). The C emitter and the NumPy evaluation both read
this list only.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import reduce

import casadi
import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.export.c.coefficients import ANGLE_LIMIT, EXP_LIMIT
from casadical.export.c.periodic_table import TABLE_LIMIT, periodic_tables

# Operations that take the same name in the tape as in CasADi: {instruction id: (name, number of arguments)}.
_PLAIN: dict[int, tuple[str, int]] = {
    casadi.OP_ADD: ("add", 2),
    casadi.OP_SUB: ("sub", 2),
    casadi.OP_MUL: ("mul", 2),
    casadi.OP_DIV: ("div", 2),
    casadi.OP_NEG: ("neg", 1),
    casadi.OP_EXP: ("exp", 1),
    casadi.OP_SQRT: ("sqrt", 1),
    casadi.OP_TANH: ("tansig", 1),
    casadi.OP_ATAN2: ("atan2", 2),
    casadi.OP_FABS: ("fabs", 1),
    casadi.OP_FMIN: ("fmin", 2),
    casadi.OP_FMAX: ("fmax", 2),
    casadi.OP_LT: ("lt", 2),
    casadi.OP_LE: ("le", 2),
    casadi.OP_IF_ELSE_ZERO: ("select", 2),
    casadi.OP_NOT: ("not", 1),
    casadi.OP_SIGN: ("sign", 1),
}
_OTHER = {
    casadi.OP_SQ: "sq",
    casadi.OP_TWICE: "twice",
    casadi.OP_INV: "inv",
    casadi.OP_SIN: "sin",
    casadi.OP_COS: "cos",
    casadi.OP_TAN: "tan",
    casadi.OP_ATAN: "atan",
    casadi.OP_ASIN: "asin",
    casadi.OP_ACOS: "acos",
    casadi.OP_ASSIGN: "assign",
    casadi.OP_HYPOT: "hypot",
}
_COMMUTATIVE = {"add", "mul"}


@dataclass(frozen=True, slots=True)
class Node:
    """One operation: its name, the positions of its arguments on the tape, and a constant or an input position.

    table : of the operation `periodic`, whose value is the bound of the table's error (see `spline_table`)
    weights : of `weighted_sum`, one of each argument; products are added one by one, from the first
    """

    op: str
    args: tuple[int, ...] = ()
    value: float = 0.0
    table: tuple[float, ...] = ()
    weights: tuple[float, ...] = ()


@dataclass(frozen=True)
class Tape:
    """A function as a list of plain real operations.

    Parameters
    ----------
    nodes : tuple[Node, ...]
        operations in order of evaluation
    n_in : int
        number of inputs
    outputs : tuple[int, ...]
        which nodes are the results

    Examples
    --------
    >>> from casadical.export.c.tape import tape_of
    >>> x = ca.SX.sym("x", 2)
    >>> tape = tape_of(ca.Function("f", [x], [ca.sin(x[0]) + x[1]]))
    >>> tape.n_in, len(tape.outputs)
    (2, 1)
    """

    nodes: tuple[Node, ...]
    n_in: int
    outputs: tuple[int, ...]


class _Builder:
    """Adds operations, stores equal ones once, and rewrites a few patterns."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._known: dict[Node, int] = {}

    def add(self, op: str, *args: int, value: float = 0.0, table: tuple[float, ...] = ()) -> int:
        if op in _COMMUTATIVE:
            args = tuple(sorted(args))
        return self.stored(Node(op, args, value, table))

    def stored(self, node: Node) -> int:
        if node not in self._known:
            self._known[node] = len(self.nodes)
            self.nodes.append(node)
        return self._known[node]

    def constant(self, value: float) -> int:
        return self.add("const", value=float(value))

    def root(self, x: int) -> int:
        return self.add("sqrt", self.add("guard_min", x, value=0.0))

    def within(self, x: int, limit: float) -> int:
        return self.add("guard_max", self.add("guard_min", x, value=-limit), value=limit)

    def sincos(self, angle: int, which: str) -> int:
        return self.add(which, self.add("sincos", self.within(angle, ANGLE_LIMIT)))

    def periodic(self, angle: int, table: tuple[float, ...], bound: float) -> int:
        if len(table) == 1:
            return self.constant(table[0])
        return self.add("periodic", self.within(angle, TABLE_LIMIT), value=bound, table=table)

    def weighted_sum(self, args: list[int], weights: Array) -> int:
        some = [k for k, a in enumerate(args) if self._const(a) != 0.0]
        if not some:
            return self.constant(0.0)
        node = Node("weighted_sum", tuple(args[k] for k in some), weights=tuple(float(weights[k]) for k in some))
        return self.stored(node)

    def arc(self, op: str, x: int) -> int:
        """asin, acos and atan are angles of a right-angled triangle: one atan2 serves all."""
        one = self.constant(1.0)
        if op == "atan":
            return self.add("atan2", x, one)
        opposite = self.root(self.add("mul", self.add("sub", one, x), self.add("add", one, x)))
        return self.add("atan2", x, opposite) if op == "asin" else self.add("atan2", opposite, x)

    def other(self, op: str, args: list[int]) -> int:
        x = args[0]
        if op == "sq":
            return self.add("mul", x, x)
        if op == "twice":
            return self.add("add", x, x)
        if op == "inv":
            return self.add("div", self.constant(1.0), x)
        if op in ("sin", "cos"):
            return self.sincos(x, op)
        if op == "tan":
            return self.add("div", self.sincos(x, "sin"), self.sincos(x, "cos"))
        if op == "hypot":
            return self.root(self.add("add", self.add("mul", x, x), self.add("mul", args[1], args[1])))
        return x if op == "assign" else self.arc(op, x)

    def tansig(self, op: str, args: list[int]) -> int | None:
        """Recognise 2/(1+exp(-2a))-1 and 1-2/(exp(2a)+1) when the last operation is about to be added."""
        if op not in ("sub", "add"):
            return None
        for a, b, first in ((args[0], args[1], True), (args[1], args[0], False)):
            exponent = self._two_over_one_plus_exp(a)
            unit = self._const(b)
            minus = op == "sub"
            if exponent is None or unit is None or unit != (1.0 if minus else -1.0):
                continue
            return self.add("tansig", self._half(exponent, negate=first or not minus))
        return None

    def _const(self, k: int) -> float | None:
        return self.nodes[k].value if self.nodes[k].op == "const" else None

    def _two_over_one_plus_exp(self, k: int) -> int | None:
        node = self.nodes[k]
        if node.op != "div" or self._const(node.args[0]) != 2.0 or self.nodes[node.args[1]].op != "add":
            return None
        for i, j in (self.nodes[node.args[1]].args, self.nodes[node.args[1]].args[::-1]):
            if self._const(i) == 1.0 and self.nodes[j].op == "exp":
                return self.nodes[self.nodes[j].args[0]].args[0]
        return None

    def _half(self, k: int, negate: bool) -> int:
        """The argument a of exp(-2a) (or of exp(2a) negated), without a multiplication where the 2 is still visible."""
        node = self.nodes[k]
        if node.op == "neg":
            return self._half(node.args[0], not negate)
        if node.op == "add" and node.args[0] == node.args[1]:
            return self.add("neg", node.args[0]) if negate else node.args[0]
        if node.op == "mul":
            for i, j in (node.args, node.args[::-1]):
                if self._const(i) in (2.0, -2.0):
                    flip = negate != (self._const(i) == -2.0)
                    return self.add("neg", j) if flip else j
        return self.add("mul", self.constant(-0.5 if negate else 0.5), k)


def tape_of(function: casadi.Function) -> Tape:
    """The tape of a CasADi function of SX type (an MX function is expanded first).

    All inputs are taken as one vector in the order of the function's arguments, and so are the outputs.

    Raises InputError: the function cannot be expanded, has sparse arguments, uses an operation that the generated C
    does not have, or calls a function that cannot be a table.
    """
    function = _expanded(function)
    starts_in = _starts(function, [function.sparsity_in(i) for i in range(function.n_in())])
    starts_out = _starts(function, [function.sparsity_out(i) for i in range(function.n_out())])
    builder = _Builder()
    inputs = [builder.add("input", value=float(k)) for k in range(starts_in[-1])]
    called = _called(function)
    matrix = None if called is None else _matrix(called)
    tables = periodic_tables(called) if called is not None and matrix is None else []
    work: dict[int, int] = {}
    outputs = [builder.constant(0.0)] * starts_out[-1]
    for k in range(function.n_instructions()):
        op, source, target = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == casadi.OP_INPUT:
            work[target[0]] = inputs[starts_in[source[0]] + source[1]]
        elif op == casadi.OP_OUTPUT:
            outputs[starts_out[target[0]] + target[1]] = work[source[0]]
        elif op == casadi.OP_CONST:
            work[target[0]] = builder.constant(function.instruction_constant(k))
        elif op == casadi.OP_CALL:
            args = [work[s] for s in source]
            if matrix is None:
                made = [builder.periodic(a, *table) for a, table in zip(args, tables, strict=True)]
            else:
                made = [builder.weighted_sum(args, row) for row in matrix]
            work |= dict(zip(target, made, strict=True))
        else:
            work[target[0]] = _operation(builder, function, op, [work[s] for s in source])
    return _live(builder.nodes, starts_in[-1], outputs)


def in_single_operations(tape: Tape) -> Tape:
    """The tape with every weighted sum as products and sums, which give the same bits."""
    builder = _Builder()
    place: list[int] = []
    for node in tape.nodes:
        args = [place[a] for a in node.args]
        if node.op != "weighted_sum":
            place.append(builder.stored(replace(node, args=tuple(args))))
            continue
        terms = [builder.add("mul", builder.constant(w), a) for w, a in zip(node.weights, args, strict=True)]
        place.append(reduce(lambda total, term: builder.add("add", total, term), terms))
    return _live(builder.nodes, tape.n_in, [place[o] for o in tape.outputs])


def _operation(builder: _Builder, function: casadi.Function, op: int, args: list[int]) -> int:
    if op in _PLAIN:
        name = _PLAIN[op][0]
        known = builder.tansig(name, args)
        if known is not None:
            return known
        if name == "sqrt":
            return builder.root(args[0])
        if name == "exp":
            args = [builder.add("guard_max", args[0], value=EXP_LIMIT)]
        return builder.add(name, *args)
    if op in _OTHER:
        return builder.other(_OTHER[op], args)
    names = {getattr(casadi, n): n for n in dir(casadi) if n.startswith("OP_")}
    allowed = sorted({name for name, _ in _PLAIN.values()} | set(_OTHER.values()) - {"assign"})
    raise InputError(
        f"function {function.name()!r} uses the operation {names.get(op, op)}, which the generated C does not have; "
        f"allowed are {', '.join(allowed)}; write the function with these"
    )


def _called(function: casadi.Function) -> casadi.Function | None:
    """The function that it calls, if any."""
    called = function.find_functions()
    if len(called) > 1:
        raise InputError(
            f"function {function.name()!r} calls {', '.join(f.name() for f in called)}; only one can become a table "
            "or a weighted sum, "
            "and no derivative of it: give jacobian_of a function without it"
        )
    return called[0] if called else None


def _matrix(function: casadi.Function) -> Array | None:
    """A of a function x -> A x, shape (m, n); None of any other function."""
    if (function.n_in(), function.n_out()) != (1, 1):
        return None
    jacobian = function.jacobian()
    if jacobian.jac_sparsity(0, 0).nnz():
        return None
    zero = casadi.DM.zeros(function.sparsity_in(0))
    some = np.random.default_rng(0).normal(size=(function.numel_in(0), 4))
    matrix = np.asarray(jacobian(zero, function(zero)).full())
    # The derivative of |x| is constant to CasADi wherever it has one.
    return matrix if np.allclose(function.map(4)(some).full(), matrix @ some, rtol=1e-12, atol=0) else None


def _expanded(function: casadi.Function) -> casadi.Function:
    if function.is_a("SXFunction"):
        return function
    try:
        return function.expand()
    except RuntimeError as error:
        raise InputError(
            f"function {function.name()!r} cannot be written as scalar operations (SX): {error}; "
            "build it without solvers, interpolants or callbacks"
        ) from error


def _starts(function: casadi.Function, sparsities: list[casadi.Sparsity]) -> list[int]:
    starts = [0]
    for sparsity in sparsities:
        if not sparsity.is_dense():
            raise InputError(
                f"function {function.name()!r} has an argument of sparsity {sparsity.dim(True)}; "
                "only dense ones can be exported; use casadi.densify"
            )
        starts.append(starts[-1] + sparsity.nnz())
    return starts


def _live(nodes: Iterable[Node], n_in: int, outputs: list[int]) -> Tape:
    """Drop what no output needs."""
    nodes = list(nodes)
    needed = set(outputs)
    for k in reversed(range(len(nodes))):
        if k in needed:
            needed.update(nodes[k].args)
    place = {old: new for new, old in enumerate(sorted(needed))}
    kept = tuple(replace(nodes[k], args=tuple(place[a] for a in nodes[k].args)) for k in sorted(needed))
    return Tape(kept, n_in, tuple(place[k] for k in outputs))

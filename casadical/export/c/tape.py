"""A CasADi SX function as a tape: a list of scalar real operations in single-assignment form.

Equal operations on equal arguments are stored once, sine and cosine of one angle share an
operation, and a tansig is recognised however it is written. Where an operation is defined for some
numbers only (square root, exp, sine of a huge angle) a guard precedes it; guards that an interval
analysis proves needless are removed (see tape_program.py). A function that is called (CasADi's
option `never_inline`) becomes a spline table for each of its outputs (see coefficients.py). The C
emitter and the NumPy reference read nothing but this list.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import casadi

from casadical.core.basics import InputError
from casadical.core.sx_instructions import SxInstructions
from casadical.export.c.coefficients import ANGLE_LIMIT, EXP_LIMIT, MAX_TABLE_ANGLE_RAD, periodic_tables

# Name on the tape of each CasADi operation that the tape has as well.
_EQUAL_OPERATIONS = {
    name: name for name in ("add", "sub", "mul", "div", "neg", "atan2", "fabs", "fmin", "fmax", "lt", "le")
}
_EQUAL_OPERATIONS |= {name: name for name in ("not", "sign")} | {"tanh": "tansig", "if_else_zero": "select"}
# Operations whose arguments may be swapped without changing the result's bits.
COMMUTATIVE_OPERATIONS = {"add", "mul"}


@dataclass(frozen=True, slots=True)
class Node:
    """One operation of a tape.

    op : name of the operation
    args : node indices of its arguments
    value : of a constant its value, of an input its index, of a guard its limit, of `periodic`
        the bound of its table's error; else 0
    table : spline coefficients of `periodic` (see `spline_table`)
    """

    op: str
    args: tuple[int, ...] = ()
    value: float = 0.0
    table: tuple[float, ...] = ()


@dataclass(frozen=True)
class Tape:
    """A function as scalar real operations in single-assignment form.

    nodes : operations in order of evaluation
    n_in : number of inputs
    outputs : node indices of the results
    """

    nodes: tuple[Node, ...]
    n_in: int
    outputs: tuple[int, ...]


class _Builder:
    """Builder of a tape: stores equal operations once and rewrites a few patterns."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._indices: dict[Node, int] = {}

    def add(self, op: str, *args: int, value: float = 0.0, table: tuple[float, ...] = ()) -> int:
        """Add an operation unless an equal one is there, and return its node index."""
        node = Node(op, tuple(sorted(args)) if op in COMMUTATIVE_OPERATIONS else args, value, table)
        if node not in self._indices:
            self._indices[node] = len(self.nodes)
            self.nodes.append(node)
        return self._indices[node]

    def constant(self, value: float) -> int:
        """Return the node index of a constant."""
        return self.add("const", value=float(value))

    def root(self, x: int) -> int:
        """Return the node index of the guarded square root of x."""
        return self.add("sqrt", self.add("guard_min", x, value=0.0))

    def within(self, x: int, limit: float) -> int:
        """Return the node index of x, guarded to lie within -limit and limit."""
        return self.add("guard_max", self.add("guard_min", x, value=-limit), value=limit)

    def sincos(self, angle: int, which: str) -> int:
        """Return the node index of the guarded sine or cosine (`which`) of an angle."""
        return self.add(which, self.add("sincos", self.within(angle, ANGLE_LIMIT)))

    def periodic(self, angle: int, table: tuple[float, ...], bound: float) -> int:
        """Return the node index of a spline table's value at an angle [rad]."""
        if len(table) == 1:
            return self.constant(table[0])
        return self.add("periodic", self.within(angle, MAX_TABLE_ANGLE_RAD), value=bound, table=table)

    def other_side(self, x: int) -> int:
        """Return the node index of sqrt(1 - x^2), from which atan2 gives asin and acos."""
        one = self.constant(1.0)
        return self.root(self.add("mul", self.add("sub", one, x), self.add("add", one, x)))

    def operation(self, name: str, *args: int) -> int | None:
        """Return the node index of an operation's result; None if the exported C has none for it.

        name : CasADi's name of the operation; args : node indices of its arguments
        """
        if name == "assign":
            return args[0]
        if name in _COMPOSED_OPERATIONS:
            return _COMPOSED_OPERATIONS[name](self, *args)
        if name not in _EQUAL_OPERATIONS:
            return None
        recognised = self.tansig(_EQUAL_OPERATIONS[name], args)
        return self.add(_EQUAL_OPERATIONS[name], *args) if recognised is None else recognised

    def tansig(self, op: str, args: tuple[int, ...]) -> int | None:
        """Return the node index of tansig(a) if operation `op` on `args` completes one, else None.

        The forms 2/(1+exp(-2a))-1 and 1-2/(exp(2a)+1) are recognised.
        """
        if op not in ("sub", "add"):
            return None
        unit = 1.0 if op == "sub" else -1.0
        for a, b, first in ((args[0], args[1], True), (args[1], args[0], False)):
            exponent = self._two_over_one_plus_exp(a)
            if exponent is not None and self._const(b) == unit:
                return self.add("tansig", self._half(exponent, negate=first or op == "add"))
        return None

    def _const(self, k: int) -> float | None:
        """Return the value of a constant node, else None."""
        return self.nodes[k].value if self.nodes[k].op == "const" else None

    def _two_over_one_plus_exp(self, k: int) -> int | None:
        """Return the node index of x if the node of index k is 2/(1+exp(x)), else None."""
        node = self.nodes[k]
        if node.op != "div" or self._const(node.args[0]) != 2.0 or self.nodes[node.args[1]].op != "add":
            return None
        for i, j in (self.nodes[node.args[1]].args, self.nodes[node.args[1]].args[::-1]):
            if self._const(i) == 1.0 and self.nodes[j].op == "exp":
                return self.nodes[self.nodes[j].args[0]].args[0]
        return None

    def _half(self, k: int, negate: bool) -> int:
        """Return the index of half of node k, or minus half (`negate`); its factor 2 is dropped."""
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


# CasADi's name of an operation: function that adds it as operations of the tape, with its guards.
_COMPOSED_OPERATIONS: dict[str, Callable[..., int]] = {
    "sq": lambda b, x: b.add("mul", x, x),
    "twice": lambda b, x: b.add("add", x, x),
    "inv": lambda b, x: b.add("div", b.constant(1.0), x),
    "sqrt": lambda b, x: b.root(x),
    "hypot": lambda b, x, y: b.root(b.add("add", b.add("mul", x, x), b.add("mul", y, y))),
    "exp": lambda b, x: b.add("exp", b.add("guard_max", x, value=EXP_LIMIT)),
    "sin": lambda b, x: b.sincos(x, "sin"),
    "cos": lambda b, x: b.sincos(x, "cos"),
    "tan": lambda b, x: b.add("div", b.sincos(x, "sin"), b.sincos(x, "cos")),
    "asin": lambda b, x: b.add("atan2", x, b.other_side(x)),
    "acos": lambda b, x: b.add("atan2", b.other_side(x), x),
    "atan": lambda b, x: b.add("atan2", x, b.constant(1.0)),
}


def tape_of(function: casadi.Function) -> Tape:
    """Return the tape of a CasADi function of SX type (an MX function is expanded first).

    All inputs are taken as one vector in the order of the function's arguments, and so are the
    outputs.

    Raises InputError: the function cannot be expanded, has sparse inputs or outputs, uses an
    operation that the generated C does not have, or calls a function that cannot be a table.
    """
    if not function.is_a("SXFunction"):
        try:
            function = function.expand()
        except RuntimeError as error:
            raise InputError(
                f"function {function.name()!r} cannot be written as scalar operations (SX): "
                f"{error}; build it without solvers, interpolants or callbacks"
            ) from error
    arguments = [function.sparsity_in(i) for i in range(function.n_in())]
    for sparsity in (*arguments, *(function.sparsity_out(i) for i in range(function.n_out()))):
        if not sparsity.is_dense():
            raise InputError(
                f"function {function.name()!r} has an argument of sparsity {sparsity.dim(True)}; "
                "only dense ones can be exported; use casadi.densify"
            )
    sizes = [function.numel_in(i) for i in range(function.n_in())]
    builder = _Builder()
    inputs = iter([builder.add("input", value=float(k)) for k in range(sum(sizes))])

    def operation(name: str, *args: int) -> int:
        """Return the node index of a result. Raises InputError if the C lacks the operation."""
        node = builder.operation(name, *args)
        if node is None:
            allowed = ", ".join(sorted({*_EQUAL_OPERATIONS.values(), *_COMPOSED_OPERATIONS}))
            raise InputError(
                f"function {function.name()!r} uses the operation OP_{name.upper()}, which the "
                f"generated C does not have; allowed are {allowed}; write the function with these"
            )
        return node

    outputs = SxInstructions.read(function).evaluate(
        [[next(inputs) for _ in range(size)] for size in sizes],
        lambda name: partial(operation, name),
        builder.constant,
        zero=builder.constant(0.0),
        call=_call(builder, function),
    )
    results = [node for output in outputs for node in output]
    needed = set(results)
    for k in reversed(range(len(builder.nodes))):
        if k in needed:
            needed.update(builder.nodes[k].args)
    place = {old: new for new, old in enumerate(sorted(needed))}
    nodes = []
    for k in place:
        node = builder.nodes[k]
        nodes.append(replace(node, args=tuple(place[a] for a in node.args)))
    return Tape(tuple(nodes), sum(sizes), tuple(place[k] for k in results))


def _call(builder: _Builder, function: casadi.Function) -> Callable[[list[int]], list[int]]:
    """Return the function that replaces the call of a function: a table for each of its outputs.

    It takes node indices of the arguments and returns those of the results.
    """
    called = function.find_functions()
    if len(called) > 1:
        raise InputError(
            f"function {function.name()!r} calls {', '.join(f.name() for f in called)}; only one "
            "can become a table, and no derivative of it: give jacobian_of a function without it"
        )
    tables = periodic_tables(called[0]) if called else []
    return lambda args: [builder.periodic(a, *table) for a, table in zip(args, tables, strict=True)]

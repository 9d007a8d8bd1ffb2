"""How far the results of a function change, computed so that nothing cancels: for float, which has seven digits.

Each operation gives its value and how much that changes, from the values and changes of its arguments, by exact
formulas: (a + da)(b + db) - ab = da (b + db) + a db, and so on. A change of 10 mm then has seven digits of its own,
where the difference of two positions of 2 m is rounded by some tenths of a micrometre.
"""

from collections.abc import Callable, Sequence

import casadi
from casadi import SX

from casadical.core.errors import InputError

_ONE: dict[int, Callable[[SX], SX]] = {
    casadi.OP_FABS: casadi.fabs,
    casadi.OP_EXP: casadi.exp,
    casadi.OP_TANH: casadi.tanh,
    casadi.OP_SIGN: casadi.sign,
    casadi.OP_TAN: casadi.tan,
    casadi.OP_ATAN: casadi.atan,
    casadi.OP_ASIN: casadi.asin,
    casadi.OP_ACOS: casadi.acos,
    casadi.OP_NOT: casadi.logic_not,
}
_TWO: dict[int, Callable[[SX, SX], SX]] = {
    casadi.OP_FMIN: casadi.fmin,
    casadi.OP_FMAX: casadi.fmax,
    casadi.OP_LT: casadi.lt,
    casadi.OP_LE: casadi.le,
    casadi.OP_HYPOT: casadi.hypot,
    casadi.OP_IF_ELSE_ZERO: lambda a, b: casadi.if_else(a, b, SX(0)),
}


def changed(function: casadi.Function, values: Sequence[SX], changes: Sequence[SX]) -> list[SX]:
    """How much each output of a function changes when its inputs do; inputs and their changes as column vectors.

    Operations without a formula here are evaluated twice, and their difference may cancel. Raises InputError for an
    operation that the generated C does not have.
    """
    f = function if function.is_a("SXFunction") else function.expand()
    work: dict[int, tuple[SX, SX]] = {}
    found = [SX.zeros(f.size_out(k)) for k in range(f.n_out())]
    for k in range(f.n_instructions()):
        op, source, target = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if op == casadi.OP_INPUT:
            work[target[0]] = values[source[0]][source[1]], changes[source[0]][source[1]]
        elif op == casadi.OP_CONST:
            work[target[0]] = SX(f.instruction_constant(k)), SX(0)
        elif op == casadi.OP_OUTPUT:
            found[target[0]].nz[target[1]] = work[source[0]][1]
        else:
            work[target[0]] = _changed(op, *[work[s] for s in source])
    return found


def _changed(op: int, first: tuple[SX, SX], second: tuple[SX, SX] = (SX(0), SX(0))) -> tuple[SX, SX]:
    """Value and change of one operation."""
    (a, da), (b, db) = first, second
    if op in (casadi.OP_SIN, casadi.OP_COS):
        return _turned(op == casadi.OP_SIN, a, da)
    if op == casadi.OP_SQRT:
        root = casadi.sqrt(a)
        return root, da if da.is_zero() else da / (root + casadi.sqrt(a + da))
    if op == casadi.OP_ATAN2:
        if da.is_zero() and db.is_zero():
            return casadi.atan2(a, b), SX(0)
        return casadi.atan2(a, b), casadi.atan2(b * da - a * db, b * (b + db) + a * (a + da))
    if op in (casadi.OP_DIV, casadi.OP_INV):
        (a, da), (b, db) = (first, second) if op == casadi.OP_DIV else ((SX(1), SX(0)), first)
        return a / b, (da - a / b * db) / (b + db)
    if op in _ONE:
        value = _ONE[op](a)
        return value, SX(0) if da.is_zero() else _ONE[op](a + da) - value
    if op in _TWO:
        value = _TWO[op](a, b)
        return value, SX(0) if da.is_zero() and db.is_zero() else _TWO[op](a + da, b + db) - value
    linear = {
        casadi.OP_ADD: (a + b, da + db),
        casadi.OP_SUB: (a - b, da - db),
        casadi.OP_NEG: (-a, -da),
        casadi.OP_TWICE: (2 * a, 2 * da),
        casadi.OP_ASSIGN: (a, da),
        casadi.OP_MUL: (a * b, da * (b + db) + a * db),
        casadi.OP_SQ: (a * a, da * (2 * a + da)),
    }
    if op not in linear:
        raise InputError(f"operation {op} of CasADi has no formula for its change; the generated C does not have it")
    return linear[op]


def _turned(sine: bool, a: SX, da: SX) -> tuple[SX, SX]:
    """Of sine or cosine: with half of the change, which is small, nothing cancels."""
    s, c = casadi.sin(a), casadi.cos(a)
    half, other = casadi.sin(da / 2), casadi.cos(da / 2)
    less, turn = -2 * half * half, 2 * half * other
    return (s, s * less + c * turn) if sine else (c, c * less - s * turn)

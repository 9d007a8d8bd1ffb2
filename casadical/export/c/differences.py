"""How far the results of a function change, computed so that nothing cancels: for float, which has seven digits.

Each operation gives its value and how much that changes, from the values and changes of its arguments, by exact
formulas: (a + da)(b + db) - ab = da (b + db) + a db, and so on. A change of 10 mm then has seven digits of its own,
where the difference of two positions of 2 m is rounded by some tenths of a micrometre.
"""

from collections.abc import Callable, Sequence
from functools import partial

import casadi
from casadi import SX

from casadical.core.errors import InputError
from casadical.core.sx_instructions import SxInstructions

# Evaluated at both ends and subtracted.
_ONE: dict[str, Callable[[SX], SX]] = {
    name: getattr(casadi, name) for name in ("fabs", "exp", "tanh", "sign", "tan", "atan", "asin", "acos")
} | {"not": casadi.logic_not}
_TWO: dict[str, Callable[[SX, SX], SX]] = {
    name: getattr(casadi, name) for name in ("fmin", "fmax", "lt", "le", "hypot")
} | {"if_else_zero": lambda a, b: casadi.if_else(a, b, SX(0))}
_NOTHING = SX(0), SX(0)


def changed(function: casadi.Function, values: Sequence[SX], changes: Sequence[SX]) -> list[SX]:
    """How much each output of a function changes when its inputs do; inputs and their changes as column vectors.

    Operations without a formula here are evaluated twice, and their difference may cancel. Raises InputError for an
    operation that the generated C does not have.
    """
    f = function if function.is_a("SXFunction") else function.expand()
    given = zip(values, changes, strict=True)
    pairs = [list(zip(*map(casadi.vertsplit, ends), strict=True)) for ends in given]
    ends = SxInstructions.read(f).evaluate(
        pairs, lambda name: partial(_changed, name), lambda number: (SX(number), SX(0)), zero=_NOTHING
    )
    outputs = [SX.zeros(f.size_out(k)) for k in range(f.n_out())]
    for output, results in zip(outputs, ends, strict=True):
        for k, (_, change) in enumerate(results):
            output.nz[k] = change
    return outputs


def _changed(op: str, first: tuple[SX, SX], second: tuple[SX, SX] = _NOTHING) -> tuple[SX, SX]:
    (a, da), (b, db) = first, second
    if op in ("sin", "cos"):
        return _turned(op == "sin", a, da)
    if op == "sqrt":
        root = casadi.sqrt(a)
        return root, da if da.is_zero() else da / (root + casadi.sqrt(a + da))
    if op == "atan2":
        if da.is_zero() and db.is_zero():
            return casadi.atan2(a, b), SX(0)
        return casadi.atan2(a, b), casadi.atan2(b * da - a * db, b * (b + db) + a * (a + da))
    if op in ("div", "inv"):
        (a, da), (b, db) = (first, second) if op == "div" else ((SX(1), SX(0)), first)
        return a / b, (da - a / b * db) / (b + db)
    if op in _ONE:
        value = _ONE[op](a)
        return value, SX(0) if da.is_zero() else _ONE[op](a + da) - value
    if op in _TWO:
        value = _TWO[op](a, b)
        return value, SX(0) if da.is_zero() and db.is_zero() else _TWO[op](a + da, b + db) - value
    linear = {
        "add": (a + b, da + db),
        "sub": (a - b, da - db),
        "neg": (-a, -da),
        "twice": (2 * a, 2 * da),
        "assign": (a, da),
        "mul": (a * b, da * (b + db) + a * db),
        "sq": (a * a, da * (2 * a + da)),
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

"""CasADi SX functions evaluated on numpy arrays: one operation for all poses and settings at once.

CasADi's own evaluation goes through a function's instructions pose by pose. Where a short function is wanted at many
poses and for many settings, going through the instructions once, each on a whole array, is many times faster.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from casadical.core.arrays import Array

_UNARY: dict[int, Callable[[Any], Any]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_NEG: np.negative,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_SQRT: np.sqrt,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: lambda a: 2.0 * a,
    ca.OP_INV: lambda a: 1.0 / a,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_SINH: np.sinh,
    ca.OP_COSH: np.cosh,
    ca.OP_TANH: np.tanh,
    ca.OP_FABS: np.abs,
    ca.OP_SIGN: np.sign,
    ca.OP_FLOOR: np.floor,
    ca.OP_CEIL: np.ceil,
    ca.OP_NOT: lambda a: np.equal(a, 0.0) * 1.0,
    ca.OP_LOG1P: np.log1p,
    ca.OP_EXPM1: np.expm1,
}
_BINARY: dict[int, Callable[[Any, Any], Any]] = {
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_FMIN: np.fmin,
    ca.OP_FMAX: np.fmax,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_HYPOT: np.hypot,
    ca.OP_FMOD: np.fmod,
    ca.OP_COPYSIGN: np.copysign,
    ca.OP_LT: lambda a, b: np.less(a, b) * 1.0,
    ca.OP_LE: lambda a, b: np.less_equal(a, b) * 1.0,
    ca.OP_EQ: lambda a, b: np.equal(a, b) * 1.0,
    ca.OP_NE: lambda a, b: np.not_equal(a, b) * 1.0,
    ca.OP_AND: lambda a, b: (np.not_equal(a, 0) & np.not_equal(b, 0)) * 1.0,
    ca.OP_OR: lambda a, b: (np.not_equal(a, 0) | np.not_equal(b, 0)) * 1.0,
    ca.OP_IF_ELSE_ZERO: lambda a, b: np.where(np.not_equal(a, 0), b, 0.0),
}


class ArrayFunction:
    """A CasADi SX function of which every input element may be an array; all of them broadcast together."""

    def __init__(self, function: ca.Function) -> None:
        self.function = function

    @cached_property
    def _program(self) -> list[tuple[int, Any, int, int, int]]:
        """(operation, constant or numpy function, place of the result, places of the arguments)."""
        f = self.function
        found: list[tuple[int, Any, int, int, int]] = []
        for k in range(f.n_instructions()):
            op = f.instruction_id(k)
            if op == ca.OP_CONST:
                found.append((op, float(f.instruction_constant(k)), f.instruction_output(k)[0], 0, 0))
                continue
            inputs, outputs = f.instruction_input(k), f.instruction_output(k)
            if op == ca.OP_INPUT:
                found.append((op, None, outputs[0], inputs[0], inputs[1]))
            elif op == ca.OP_OUTPUT:
                found.append((op, None, inputs[0], outputs[0], outputs[1]))
            elif op in _UNARY:
                found.append((1, _UNARY[op], outputs[0], inputs[0], 0))
            elif op in _BINARY:
                found.append((2, _BINARY[op], outputs[0], inputs[0], inputs[1]))
            else:
                raise NotImplementedError(f"{f.name()}: CasADi operation {op} has no numpy counterpart here")
        return found

    def __call__(self, *inputs: Sequence[Any]) -> list[list[Array | float]]:
        """The structural nonzeros of every output, in CasADi's order.

        inputs : for each input of the function its nonzeros, numbers or arrays that broadcast together
        """
        f = self.function
        work: list[Any] = [0.0] * max(1, f.sz_w())
        results: list[list[Any]] = [[0.0] * f.nnz_out(k) for k in range(f.n_out())]
        with np.errstate(all="ignore"):  # as CasADi: what is not a number shows in the results
            for kind, what, a, b, c in self._program:
                if kind == 2:
                    work[a] = what(work[b], work[c])
                elif kind == 1:
                    work[a] = what(work[b])
                elif kind == ca.OP_CONST:
                    work[a] = what
                elif kind == ca.OP_INPUT:
                    work[a] = inputs[b][c]
                else:
                    results[b][c] = work[a]
        return results

"""CasADi SX functions evaluated on numpy arrays: one operation for all poses and settings at once.

CasADi's own evaluation goes through a function's instructions pose by pose. Where a short function is wanted at many
poses and for many settings, going through the instructions once, each on a whole array, is many times faster.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True, eq=False)
class ArrayFunction:
    """A function of which every input element may be an array; all of them broadcast together.

    steps : (operation, constant, place of the result, places of its arguments) each, as CasADi numbers them
    places : how many results are kept at a time; nonzeros : of every output
    """

    steps: tuple[tuple[int, float, int, int, int], ...]
    places: int
    nonzeros: tuple[int, ...]

    @classmethod
    def of(cls, f: ca.Function) -> ArrayFunction:
        """A CasADi SX function."""
        steps: list[tuple[int, float, int, int, int]] = []
        for k in range(f.n_instructions()):
            op = f.instruction_id(k)
            if op == ca.OP_CONST:
                steps.append((op, float(f.instruction_constant(k)), f.instruction_output(k)[0], 0, 0))
                continue
            inputs, outputs = f.instruction_input(k), f.instruction_output(k)
            if op == ca.OP_INPUT:
                steps.append((op, 0.0, outputs[0], inputs[0], inputs[1]))
            elif op == ca.OP_OUTPUT:
                steps.append((op, 0.0, inputs[0], outputs[0], outputs[1]))
            elif op in _UNARY:
                steps.append((op, 0.0, outputs[0], inputs[0], 0))
            elif op in _BINARY:
                steps.append((op, 0.0, outputs[0], inputs[0], inputs[1]))
            else:
                raise NotImplementedError(f"{f.name()}: CasADi operation {op} has no numpy counterpart here")
        return cls(tuple(steps), max(1, f.sz_w()), tuple(f.nnz_out(k) for k in range(f.n_out())))

    def __call__(self, *inputs: Sequence[Any]) -> list[list[Array | float]]:
        """The structural nonzeros of every output, in CasADi's order.

        inputs : for each input of the function its nonzeros, numbers or arrays that broadcast together
        """
        work: list[Any] = [0.0] * self.places
        results: list[list[Any]] = [[0.0] * count for count in self.nonzeros]
        with np.errstate(all="ignore"):  # as CasADi: what is not a number shows in the results
            for op, constant, a, b, c in self.steps:
                if op in _BINARY:
                    work[a] = _BINARY[op](work[b], work[c])
                elif op in _UNARY:
                    work[a] = _UNARY[op](work[b])
                elif op == ca.OP_CONST:
                    work[a] = constant
                elif op == ca.OP_INPUT:
                    work[a] = inputs[b][c]
                else:
                    results[b][c] = work[a]
        return results

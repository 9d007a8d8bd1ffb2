"""The instructions of a CasADi SX function, read in this module only, and their evaluation.

All other ways to evaluate a function use this list: on numpy arrays here, as vectorised C in
`mapped_function`, differences without cancellation in `export.controller.correction`, and the tape of
the exported controllers in `export.c.tape`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casadical.core.basics import Array

# Name in lower case of each operation, by CasADi's integer code.
_OPERATION_NAMES = {getattr(ca, name): name.removeprefix("OP_").lower() for name in dir(ca) if name.startswith("OP_")}


# One operation of a CasADi function:
# - its name in lower case, such as "add", "if_else_zero", "input", "const", "output" or "call";
# - its operands and its results as indices in the work vector; the operands of an "input", and the
#   results of an "output", are instead the index of the argument and that of its structural nonzero;
# - the value of a "const", else 0.
Instruction = tuple[str, Sequence[int], Sequence[int], float]


@dataclass(frozen=True, eq=False)
class SxInstructions:
    """A CasADi function of SX type as a list of instructions.

    name : name of the function
    instructions : instructions in the order of evaluation
    places : length of the work vector
    nonzeros : number of structural nonzeros of every output
    """

    name: str
    instructions: tuple[Instruction, ...]
    places: int
    nonzeros: tuple[int, ...]

    @classmethod
    def read(cls, f: ca.Function) -> SxInstructions:
        """Return the instructions of a CasADi function of SX type."""
        steps = []
        for k in range(f.n_instructions()):
            name = _OPERATION_NAMES[f.instruction_id(k)]
            constant = float(f.instruction_constant(k)) if name == "const" else 0.0
            steps.append((name, f.instruction_input(k), f.instruction_output(k), constant))
        return cls(f.name(), tuple(steps), max(1, f.sz_w()), tuple(f.nnz_out(k) for k in range(f.n_out())))

    def evaluate(
        self,
        inputs: Sequence[Any],
        operation: Callable[[str], Callable[..., Any]],
        constant: Callable[[float], Any],
        *,
        zero: Any = 0.0,
        call: Callable[[list[Any]], Sequence[Any]] | None = None,
    ) -> list[list[Any]]:
        """Return the structural nonzeros of every output, evaluated with values of any type.

        They are in CasADi's order (column by column).

        inputs : for each input of the function the values of its nonzeros
        operation : function from the name of an operation to a function of its operands' values
        constant : function from a number to a value
        zero : value of an output that no instruction writes
        call : function from the operands' values of a called function to its results; None: calls
            are operations of that name
        """
        work: list[Any] = [zero] * self.places
        outputs = [[zero] * count for count in self.nonzeros]
        # Names of instructions that are no operations on values.
        special = frozenset(("input", "const", "output", "call"))
        for name, operands, results, number in self.instructions:
            if name not in special or (name == "call" and call is None):
                work[results[0]] = operation(name)(*[work[k] for k in operands])
            elif name == "input":
                work[results[0]] = inputs[operands[0]][operands[1]]
            elif name == "const":
                work[results[0]] = constant(number)
            elif name == "output":
                outputs[results[0]][results[1]] = work[operands[0]]
            elif call is not None:
                for place, value in zip(results, call([work[k] for k in operands]), strict=True):
                    work[place] = value
        return outputs

    def on_arrays(self, *inputs: Sequence[Any]) -> list[list[Array | float]]:
        """Return the structural nonzeros of every output, evaluated with numpy on whole arrays.

        For short functions at many points this is many times faster than CasADi.

        inputs : for each input of the function its nonzeros, numbers or arrays that broadcast
            together
        """
        with np.errstate(all="ignore"):  # as in CasADi, NaN appears in the results
            return self.evaluate(inputs, self._numpy, float)

    def _numpy(self, name: str) -> Callable[..., Any]:
        """Return the numpy function of an operation, by its name."""
        if name not in OPERATIONS:
            raise NotImplementedError(f"{self.name}: CasADi operation {name} has no numpy counterpart here")
        return OPERATIONS[name][0]


# An operation as a numpy function of arrays, and as a template of the C expression of two points at
# a time for `mapped_function`, in which {0} and {1} are its operands.
Operation = tuple[Callable[..., Any], str]


def _unary(numpy: Callable[[Any], Any], c: str) -> Operation:
    """Return the operation of a function of one number; c : name of the C function."""
    return numpy, f"ONE({c}, {{0}})"


def _binary(numpy: Callable[[Any, Any], Any], c: str) -> Operation:
    """Return the operation of a function of two numbers; c : name of the C function."""
    return numpy, f"TWO({c}, {{0}}, {{1}})"


# CasADi operations with their counterparts in numpy and C, by name in lower case.
OPERATIONS: dict[str, Operation] = {
    "assign": (lambda a: a, "{0}"),
    "add": (np.add, "{0} + {1}"),
    "sub": (np.subtract, "{0} - {1}"),
    "mul": (np.multiply, "{0} * {1}"),
    "div": (np.divide, "{0} / {1}"),
    "neg": (np.negative, "-{0}"),
    "sq": (np.square, "{0} * {0}"),
    "twice": (lambda a: 2.0 * a, "2.0 * {0}"),
    "inv": (lambda a: 1.0 / a, "1.0 / {0}"),
    **{
        name: _unary(getattr(np, name), name)
        for name in (
            *("exp", "log", "log1p", "expm1", "sqrt", "sin", "cos", "tan", "sinh", "cosh", "tanh"),
            *("fabs", "sign", "floor", "ceil"),
        )
    },
    **{name: _binary(getattr(np, name), name) for name in ("fmin", "fmax", "hypot", "fmod", "copysign")},
    "asin": _unary(np.arcsin, "asin"),
    "acos": _unary(np.arccos, "acos"),
    "atan": _unary(np.arctan, "atan"),
    "not": _unary(lambda a: np.equal(a, 0.0) * 1.0, "not_"),
    "pow": _binary(np.power, "pow"),
    "constpow": _binary(np.power, "pow"),
    "atan2": _binary(np.arctan2, "atan2"),
    "lt": _binary(lambda a, b: np.less(a, b) * 1.0, "lt"),
    "le": _binary(lambda a, b: np.less_equal(a, b) * 1.0, "le"),
    "eq": _binary(lambda a, b: np.equal(a, b) * 1.0, "eq"),
    "ne": _binary(lambda a, b: np.not_equal(a, b) * 1.0, "ne"),
    "and": _binary(lambda a, b: (np.not_equal(a, 0) & np.not_equal(b, 0)) * 1.0, "and_"),
    "or": _binary(lambda a, b: (np.not_equal(a, 0) | np.not_equal(b, 0)) * 1.0, "or_"),
    "if_else_zero": _binary(lambda a, b: np.where(np.not_equal(a, 0), b, 0.0), "if_else_zero"),
}

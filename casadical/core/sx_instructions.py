"""The instructions of a CasADi SX function: the one place where they are read.

All other ways to evaluate a function stand on this list: on numpy arrays here, as vectorised C in `compile_cache`,
changes without cancellation in `export.controller.functions`, and the tape of the exported controllers in
`export.c.tape`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from casadical.core.basics import Array

_NAMES = {getattr(ca, name): name.removeprefix("OP_").lower() for name in dir(ca) if name.startswith("OP_")}
_SPECIAL = frozenset(("input", "const", "output", "call"))


class Instruction(NamedTuple):
    """One operation by CasADi's name in lower case: "add", "if_else_zero", "input", "const", "output", "call", ..

    operands, results : places in the list of values; of an input the operands, and of an output the results, are the
    number of the argument and the position of its nonzero
    """

    operation: str
    operands: Sequence[int]
    results: Sequence[int]
    constant: float


@dataclass(frozen=True, eq=False)
class SxInstructions:
    """A CasADi function of SX type as a list of instructions.

    places : how many values are kept at a time; nonzeros : of every output
    """

    name: str
    instructions: tuple[Instruction, ...]
    places: int
    nonzeros: tuple[int, ...]

    @classmethod
    def read(cls, f: ca.Function) -> SxInstructions:
        """Those of a function."""
        steps = []
        for k in range(f.n_instructions()):
            name = _NAMES[f.instruction_id(k)]
            constant = float(f.instruction_constant(k)) if name == "const" else 0.0
            steps.append(Instruction(name, f.instruction_input(k), f.instruction_output(k), constant))
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
        """The structural nonzeros of every output, in CasADi's order, with values of any kind.

        inputs : for each input of the function the values of its nonzeros
        operation : name of an operation -> function of the values of its operands; constant : number -> value
        zero : value of an output that no instruction writes; call : operands of a function that is called -> its values
        """
        work: list[Any] = [zero] * self.places
        outputs = [[zero] * count for count in self.nonzeros]
        for name, operands, results, number in self.instructions:
            if name not in _SPECIAL or (name == "call" and call is None):
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
        """The structural nonzeros of every output: each operation is done once, on whole arrays.

        For short functions at many points this is many times faster than CasADi, which goes point by point.

        inputs : for each input of the function its nonzeros, numbers or arrays that broadcast together
        """
        with np.errstate(all="ignore"):  # as CasADi: what is not a number shows in the results
            return self.evaluate(inputs, self._numpy, float)

    def _numpy(self, name: str) -> Callable[..., Any]:
        if name not in OPERATIONS:
            raise NotImplementedError(f"{self.name}: CasADi operation {name} has no numpy counterpart here")
        return OPERATIONS[name].numpy


class Operation(NamedTuple):
    """An operation on numpy arrays, and in the C of `compile_cache`, where {0} and {1} are its operands."""

    numpy: Callable[..., Any]
    c: str


def _one(numpy: Callable[[Any], Any], c: str) -> Operation:
    """A function of one number, which the C computes for each of the two numbers of a vector."""
    return Operation(numpy, f"ONE({c}, {{0}})")


def _two(numpy: Callable[[Any, Any], Any], c: str) -> Operation:
    return Operation(numpy, f"TWO({c}, {{0}}, {{1}})")


# Functions of one number, and of two, that CasADi, numpy and C call alike.
_ONE = ("exp", "log", "log1p", "expm1", "sqrt", "sin", "cos", "tan", "sinh", "cosh", "tanh")
_TWO = ("fmin", "fmax", "hypot", "fmod", "copysign")
OPERATIONS = {
    "assign": Operation(lambda a: a, "{0}"),
    "add": Operation(np.add, "{0} + {1}"),
    "sub": Operation(np.subtract, "{0} - {1}"),
    "mul": Operation(np.multiply, "{0} * {1}"),
    "div": Operation(np.divide, "{0} / {1}"),
    "neg": Operation(np.negative, "-{0}"),
    "sq": Operation(np.square, "{0} * {0}"),
    "twice": Operation(lambda a: 2.0 * a, "2.0 * {0}"),
    "inv": Operation(lambda a: 1.0 / a, "1.0 / {0}"),
    **{name: _one(getattr(np, name), name) for name in (*_ONE, "fabs", "sign", "floor", "ceil")},
    **{name: _two(getattr(np, name), name) for name in _TWO},
    "asin": _one(np.arcsin, "asin"),
    "acos": _one(np.arccos, "acos"),
    "atan": _one(np.arctan, "atan"),
    "not": _one(lambda a: np.equal(a, 0.0) * 1.0, "not_"),
    "pow": _two(np.power, "pow"),
    "constpow": _two(np.power, "pow"),
    "atan2": _two(np.arctan2, "atan2"),
    "lt": _two(lambda a, b: np.less(a, b) * 1.0, "lt"),
    "le": _two(lambda a, b: np.less_equal(a, b) * 1.0, "le"),
    "eq": _two(lambda a, b: np.equal(a, b) * 1.0, "eq"),
    "ne": _two(lambda a, b: np.not_equal(a, b) * 1.0, "ne"),
    "and": _two(lambda a, b: (np.not_equal(a, 0) & np.not_equal(b, 0)) * 1.0, "and_"),
    "or": _two(lambda a, b: (np.not_equal(a, 0) | np.not_equal(b, 0)) * 1.0, "or_"),
    "if_else_zero": _two(lambda a, b: np.where(np.not_equal(a, 0), b, 0.0), "if_else_zero"),
}

"""Formulas given as text: validated against lists of names and functions, then evaluated.

Text is never executed: Python's own parser splits it into a syntax tree without running it. Every
node of the tree must be of an allowed type; numbers, length and depth are limited, and so is, by
interval arithmetic (`bounds`), every intermediate value. A formula has one component, or three in
brackets, `[a, b, 0] * max(0, t - 0.5)`.
"""

import ast
import math
import operator
import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from casadical.core.basics import InputError
from casadical.core.reading import LARGEST_NUMBER

# Functions allowed in formulas: number of arguments, CasADi and numpy implementation, by name.
_FUNCTION_TABLE: Mapping[str, tuple[int, Callable[..., Any], Callable[..., Any]]] = {
    "sin": (1, ca.sin, np.sin),
    "cos": (1, ca.cos, np.cos),
    "tanh": (1, ca.tanh, np.tanh),
    "exp": (1, ca.exp, np.exp),
    "sqrt": (1, ca.sqrt, np.sqrt),
    "abs": (1, ca.fabs, np.abs),
    "sign": (1, ca.sign, np.sign),
    "step": (1, lambda x: ca.if_else(x > 0, 1.0, 0.0), lambda x: np.greater(x, 0.0) * 1.0),
    "min": (2, ca.fmin, np.minimum),
    "max": (2, ca.fmax, np.maximum),
}
# Number of arguments of each function allowed in formulas, by name.
ARGUMENT_COUNTS = {name: count for name, (count, _, _) in _FUNCTION_TABLE.items()}
# CasADi implementations of the functions allowed in formulas, by name.
SYMBOLIC_FUNCTIONS = {name: symbolic for name, (_, symbolic, _) in _FUNCTION_TABLE.items()}
# numpy implementations of the functions allowed in formulas, by name.
NUMERIC_FUNCTIONS = {name: numeric for name, (_, _, numeric) in _FUNCTION_TABLE.items()}
# Sign of each binary operator that is allowed in formulas.
_OPERATOR_SIGNS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
# Function of each binary operator that acts component by component on three components.
_OPERATOR_FUNCTIONS = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv}


@dataclass(frozen=True)
class Formula:
    """A validated formula.

    text : as given; names : variables, parameters and settings in it, each once, in order
    components : 1, or 3 for a vector in brackets
    """

    text: str
    names: tuple[str, ...]
    components: int

    def values(
        self, names: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]] = SYMBOLIC_FUNCTIONS
    ) -> list[Any]:
        """Return a list of the values of the formula's components, one or three.

        names : value of each name in the formula: an expression, a number or an array
        functions : implementations by name, SYMBOLIC_FUNCTIONS or NUMERIC_FUNCTIONS
        """
        value = _value(_tree(self.text), names, functions)
        return value if isinstance(value, list) else [value]


@lru_cache(maxsize=8192)
def parse(text: str, own: frozenset[str] = frozenset()) -> Formula:
    """Return the validated formula of a text; its names are not checked (see `refuse_unknown`).

    own : names of parameters and settings, which may equal those of functions
    Raises InputError that states what is wrong, in which column, and what is allowed.
    """
    tree = _tree(text)
    count, level, row = 0, 0, [tree]
    while row:
        count, level = count + len(row), level + 1
        if level > 20:
            raise _error_at(text, row[0], "nested more than 20 levels deep")
        row = [child for node in row for child in ast.iter_child_nodes(node) if isinstance(child, ast.expr)]
    if count > 120:
        raise _error_at(text, tree, f"{count} names, numbers and operations; at most 120 are allowed")
    names: dict[str, None] = {}
    components = _check(text, tree, names)
    for node in _names_of(tree):
        if node.id in ARGUMENT_COUNTS and node.id not in own:
            raise _error_at(text, node, f"{node.id} is a function; write {node.id}(...)")
    return Formula(text, tuple(names), components)


def refuse_unknown(formula: Formula, allows: Callable[[str], bool], allowed: str) -> None:
    """Check that all names in a formula are allowed. Raises InputError for the first that is not.

    allows : function that returns whether a name is allowed; allowed : names for the message
    """
    for node in _names_of(_tree(formula.text)):
        if not allows(node.id):
            raise _error_at(formula.text, node, f"unknown name {node.id!r}; allowed are {allowed}")


# Lower and upper bound of a value.
Interval = tuple[float, float]


def bounds(formula: Formula, ranges: Callable[[str], Interval]) -> Interval:
    """Return common (lower, upper) bounds of all components of a formula by interval arithmetic.

    ranges : function that returns the (lower, upper) bounds of the value of a name
    Raises InputError for an intermediate value beyond `LARGEST_NUMBER`, or that cannot be computed.
    """
    return _bounds(formula.text, _tree(formula.text), ranges)


def _bounds(text: str, node: ast.expr, ranges: Callable[[str], Interval]) -> Interval:
    """Return (lower, upper) bounds of a node of a formula's tree; the arguments are of `bounds`."""
    parts = [_bounds(text, each, ranges) for each in ast.iter_child_nodes(node) if isinstance(each, ast.expr)]
    if isinstance(node, ast.Constant):
        low = high = float(node.value)  # type: ignore[arg-type]
    elif isinstance(node, ast.Name):
        low, high = ranges(node.id) if node.id not in ARGUMENT_COUNTS else (0.0, 0.0)
    elif isinstance(node, ast.UnaryOp):
        low, high = parts[0] if isinstance(node.op, ast.UAdd) else (-parts[0][1], -parts[0][0])
    elif isinstance(node, ast.Call):
        low, high = _bounds_of_call(text, node, parts[1:])
    elif isinstance(node, ast.BinOp):
        low, high = _bounds_of_operation(text, node, *parts)
    else:
        low, high = min(part[0] for part in parts), max(part[1] for part in parts)
    if not -LARGEST_NUMBER <= low <= high <= LARGEST_NUMBER:
        raise _error_at(text, node, f"may become greater than {LARGEST_NUMBER:g}; keep its arguments small")
    return low, high


def _bounds_of_call(text: str, node: ast.Call, parts: list[Interval]) -> Interval:
    """Return (lower, upper) bounds of the value of a called function."""
    assert isinstance(node.func, ast.Name)
    name, (low, high) = node.func.id, parts[0]
    if name in ("sin", "cos", "tanh", "sign", "step"):
        return (0.0 if name == "step" else -1.0), 1.0
    if name == "abs":
        return (0.0 if low <= 0 <= high else min(abs(low), abs(high))), max(abs(low), abs(high))
    if name == "exp":
        return math.exp(max(min(low, 700.0), -700.0)), math.exp(max(min(high, 700.0), -700.0))
    if name == "sqrt":
        if high < 0:
            raise _error_at(text, node, "is the root of a negative number")
        return math.sqrt(max(low, 0.0)), math.sqrt(high)
    choose = min if name == "min" else max
    return choose(low, parts[1][0]), choose(high, parts[1][1])


def _bounds_of_operation(text: str, node: ast.BinOp, left: Interval, right: Interval) -> Interval:
    """Return (lower, upper) bounds of the value of a binary operation on two intervals."""
    if isinstance(node.op, ast.Add):
        return left[0] + right[0], left[1] + right[1]
    if isinstance(node.op, ast.Sub):
        return left[0] - right[1], left[1] - right[0]
    if isinstance(node.op, ast.Div):
        if right[0] <= 0 <= right[1]:
            raise _error_at(text, node.right, "may be zero; divide by what never is: 0.1 + abs(q1)")
        right = 1 / right[1], 1 / right[0]
    square = isinstance(node.op, ast.Mult) and ast.dump(node.left) == ast.dump(node.right)
    if square or isinstance(node.op, ast.Pow):
        power = 2 if square else int(right[0])
        ends = [math.prod([end] * power) for end in left]
        return (0.0 if power % 2 == 0 and left[0] <= 0 <= left[1] else min(ends)), max(ends)
    products = [a * b for a in left for b in right]
    return min(products), max(products)


def _error_at(text: str, node: ast.expr | int, why: str) -> InputError:
    """Return an error with the formula, the column in it and the reason."""
    column = node if isinstance(node, int) else node.col_offset + 1
    return InputError(f"formula {text!r}, column {column}: {why}")


@lru_cache(maxsize=8192)
def _tree(text: str) -> ast.expr:
    """Return the syntax tree of a formula's text; its nodes are not checked yet."""
    if not text.strip():
        raise InputError("formula: it is empty; a formula such as 'a * max(0, abs(tau3) - 0.3)' is needed")
    if len(text) > 400:
        raise InputError(f"formula: it has {len(text)} characters; at most 400 are allowed")
    for k, c in enumerate(text, 1):
        if not (c.isascii() and (c.isalnum() or c in "_ .,+-*/()[]")):
            raise _error_at(text, k, f"character {c!r}; allowed are letters, digits and _ . , + - * / ( ) [ ]")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return ast.parse(text.strip(), mode="eval").body
    except SyntaxError as error:
        raise _error_at(text, error.offset or 1, f"it cannot be read: {error.msg}") from None
    except (ValueError, RecursionError, MemoryError, SyntaxWarning, DeprecationWarning):
        raise _error_at(text, 1, "it cannot be read; write operators between numbers, names and brackets") from None


def _names_of(tree: ast.expr) -> list[ast.Name]:
    """Return every node of a syntax tree that is a name, but not that of a called function."""
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    return [node for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in called]


def _check(text: str, node: ast.expr, names: dict[str, None]) -> int:
    """Return the number of components of a node, 1 or 3, and add its names to `names`."""
    if isinstance(node, ast.Constant):
        value = node.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise _error_at(text, node, f"{value!r} is no number")
        if value and not 1e-15 <= abs(value) <= 1e9:  # also an integer that is no double
            raise _error_at(text, node, "number out of range; allowed are 0 and 1e-15 to 1e+09")
        return 1
    if isinstance(node, ast.Name):
        names[node.id] = None
        return 1
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        return _check(text, node.operand, names)
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATOR_SIGNS:
        left, right = (_check(text, side, names) for side in (node.left, node.right))
        sign = _OPERATOR_SIGNS[type(node.op)]
        if sign == "**":
            power = node.right.value if isinstance(node.right, ast.Constant) else None
            if left != 1 or not isinstance(power, int) or not 1 <= power <= 6:
                raise _error_at(text, node.right, "a power must be a whole number from 1 to 6")
            return 1
        if sign in "+-" and left != right:
            raise _error_at(text, node, "one side has three components, the other one")
        if (sign == "/" and right == 3) or (sign == "*" and left == right == 3):
            only = "three components can be multiplied or divided by a number only"
            raise _error_at(text, node, only)
        return max(left, right)
    if isinstance(node, ast.Call):
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name not in ARGUMENT_COUNTS:
            raise _error_at(text, node, f"unknown function {name!r}; allowed are {', '.join(ARGUMENT_COUNTS)}")
        if node.keywords or len(node.args) != ARGUMENT_COUNTS[name]:
            raise _error_at(
                text, node, f"{name} takes {ARGUMENT_COUNTS[name]} argument{'s'[: ARGUMENT_COUNTS[name] - 1]}"
            )
        if any(_check(text, each, names) != 1 for each in node.args):
            raise _error_at(text, node, f"{name} takes no three components")
        return 1
    if isinstance(node, ast.List):
        if len(node.elts) != 3 or any(_check(text, each, names) != 1 for each in node.elts):
            raise _error_at(text, node, "brackets hold three components, [x, y, z]")
        return 3
    allowed = "numbers, names, + - * / **, (...), [x, y, z] and functions"
    raise _error_at(text, node, f"{type(node).__name__.lower()} is not allowed; allowed are {allowed}")


def _value(node: ast.expr, names: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]) -> Any:
    """Return the value of a node of a validated formula, a scalar or a list of three."""
    if isinstance(node, ast.Constant):
        return float(node.value)  # type: ignore[arg-type]
    if isinstance(node, ast.Name):
        return names[node.id]
    if isinstance(node, ast.UnaryOp):
        value = _value(node.operand, names, functions)
        return value if isinstance(node.op, ast.UAdd) else _each(lambda a, _: -a, value, 0.0)
    if isinstance(node, ast.Call):
        assert isinstance(node.func, ast.Name)
        return functions[node.func.id](*(_value(each, names, functions) for each in node.args))
    if isinstance(node, ast.List):
        return [_value(each, names, functions) for each in node.elts]
    assert isinstance(node, ast.BinOp)
    left = _value(node.left, names, functions)
    if isinstance(node.op, ast.Pow):
        assert isinstance(node.right, ast.Constant)
        assert isinstance(node.right.value, int)
        return math.prod([left] * node.right.value)
    return _each(_OPERATOR_FUNCTIONS[type(node.op)], left, _value(node.right, names, functions))


def _each(operation: Callable[[Any, Any], Any], left: Any, right: Any) -> Any:
    """Return an operation's result on two scalars, or a list of it on each of three components.

    A scalar is combined with each component of the other side.
    """
    if not isinstance(left, list) and not isinstance(right, list):
        return operation(left, right)
    sides = [side if isinstance(side, list) else [side] * 3 for side in (left, right)]
    return [operation(a, b) for a, b in zip(*sides, strict=True)]


def names_in(formulas: Collection[Formula]) -> tuple[str, ...]:
    """Return the names of variables, parameters and settings in formulas, each once, in order."""
    return tuple(dict.fromkeys(name for f in formulas for name in f.names))

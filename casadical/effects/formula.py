"""Formulas given as text: checked against a list of names and functions, then computed; text is never executed.

The text is split into a tree by Python's own parser, which runs nothing. Every node of the tree must be on the list
here; numbers, length and depth are limited, and by interval arithmetic every value on the way. A formula is a number,
or three in brackets, `[a, b, 0] * max(0, t - 0.5)`.
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

MOST_CHARACTERS, MOST_NODES, MOST_LEVELS, MOST_POWER = 400, 120, 20, 6
# Of numbers other than zero.
LEAST, GREATEST = 1e-15, 1e9
# Name -> number of arguments; the function of expressions, and that of numbers and arrays.
_KNOWN: Mapping[str, tuple[int, Callable[..., Any], Callable[..., Any]]] = {
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
FUNCTIONS = {name: count for name, (count, _, _) in _KNOWN.items()}
SYMBOLIC = {name: symbolic for name, (_, symbolic, _) in _KNOWN.items()}
NUMERIC = {name: numeric for name, (_, _, numeric) in _KNOWN.items()}
_SIGNS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
_OPERATIONS = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv}


@dataclass(frozen=True)
class Formula:
    """A checked formula. names : that it uses, in order; components : 1, or 3 of a formula in brackets"""

    text: str
    names: tuple[str, ...]
    components: int

    def values(self, names: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]] = SYMBOLIC) -> list[Any]:
        """Its value, one or three, from those of its names: expressions, numbers or arrays.

        functions : what the functions' names stand for, SYMBOLIC or NUMERIC
        """
        value = _value(_tree(self.text), names, functions)
        return value if isinstance(value, list) else [value]


@lru_cache(maxsize=8192)
def parse(text: str, own: frozenset[str] = frozenset()) -> Formula:
    """A formula from its text; own : names that may be those of functions, too, where nothing is called.

    Raises InputError that states what is wrong, in which column, and what is allowed.
    """
    tree = _tree(text)
    _refuse_large(text, tree)
    names: dict[str, None] = {}
    components = _check(text, tree, names)
    for node in _names_of(tree):
        if node.id in FUNCTIONS and node.id not in own:
            raise _wrong(text, node, f"{node.id} is a function; write {node.id}(...)")
    return Formula(text, tuple(names), components)


def refuse_unknown(formula: Formula, known: Callable[[str], bool], allowed: str) -> None:
    """Raises InputError for a name that is not known; allowed : those that are, in words."""
    for node in _names_of(_tree(formula.text)):
        if not known(node.id):
            raise _wrong(formula.text, node, f"unknown name {node.id!r}; allowed are {allowed}")


Interval = tuple[float, float]
# What a value divided by nearly nothing is taken to be: times this.
_POLE = 1e15


def bounds(formula: Formula, ranges: Callable[[str], Interval]) -> Interval:
    """Between which its values lie, all components together, by interval arithmetic; ranges : of its names.

    Raises InputError for a value on the way that is beyond `LARGEST_NUMBER`, or cannot be computed.
    """
    return _bounds(formula.text, _tree(formula.text), ranges)


def _bounds(text: str, node: ast.expr, ranges: Callable[[str], Interval]) -> Interval:
    parts = [_bounds(text, each, ranges) for each in ast.iter_child_nodes(node) if isinstance(each, ast.expr)]
    if isinstance(node, ast.Constant):
        low = high = float(node.value)  # type: ignore[arg-type]
    elif isinstance(node, ast.Name):
        low, high = ranges(node.id) if node.id not in FUNCTIONS else (0.0, 0.0)
    elif isinstance(node, ast.UnaryOp):
        low, high = parts[0] if isinstance(node.op, ast.UAdd) else (-parts[0][1], -parts[0][0])
    elif isinstance(node, ast.Call):
        low, high = _bounds_of_call(text, node, parts[1:])
    elif isinstance(node, ast.BinOp):
        low, high = _bounds_of_operation(text, node, *parts)
    else:
        low, high = min(part[0] for part in parts), max(part[1] for part in parts)
    if not -LARGEST_NUMBER <= low <= high <= LARGEST_NUMBER:
        raise _wrong(text, node, f"may become greater than {LARGEST_NUMBER:g}; keep its arguments small")
    return low, high


def _bounds_of_call(text: str, node: ast.Call, parts: list[Interval]) -> Interval:
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
            raise _wrong(text, node, "is the root of a negative number")
        return math.sqrt(max(low, 0.0)), math.sqrt(high)
    choose = min if name == "min" else max
    return choose(low, parts[1][0]), choose(high, parts[1][1])


def _bounds_of_operation(text: str, node: ast.BinOp, left: Interval, right: Interval) -> Interval:
    if isinstance(node.op, ast.Add):
        return left[0] + right[0], left[1] + right[1]
    if isinstance(node.op, ast.Sub):
        return left[0] - right[1], left[1] - right[0]
    if isinstance(node.op, ast.Div):
        if right == (0.0, 0.0):
            raise _wrong(text, node.right, "is zero; nothing can be divided by it")
        pole = right[0] <= 0 <= right[1]
        right = (-_POLE, _POLE) if pole else (1 / right[1], 1 / right[0])
    square = isinstance(node.op, ast.Mult) and ast.dump(node.left) == ast.dump(node.right)
    if square or isinstance(node.op, ast.Pow):
        power = 2 if square else int(right[0])
        ends = [math.prod([end] * power) for end in left]
        return (0.0 if power % 2 == 0 and left[0] <= 0 <= left[1] else min(ends)), max(ends)
    products = [a * b for a in left for b in right]
    return min(products), max(products)


def _wrong(text: str, node: ast.expr | int, why: str) -> InputError:
    column = node if isinstance(node, int) else node.col_offset + 1
    return InputError(f"formula {text!r}, column {column}: {why}")


@lru_cache(maxsize=8192)
def _tree(text: str) -> ast.expr:
    if not text.strip():
        raise InputError("formula: it is empty; a formula such as 'a * max(0, abs(tau3) - 0.3)' is needed")
    if len(text) > MOST_CHARACTERS:
        raise InputError(f"formula: it has {len(text)} characters; at most {MOST_CHARACTERS} are allowed")
    for k, c in enumerate(text, 1):
        if not (c.isascii() and (c.isalnum() or c in "_ .,+-*/()[]")):
            raise _wrong(text, k, f"character {c!r}; allowed are letters, digits and _ . , + - * / ( ) [ ]")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return ast.parse(text.strip(), mode="eval").body
    except SyntaxError as error:
        raise _wrong(text, error.offset or 1, f"it cannot be read: {error.msg}") from None
    except (ValueError, RecursionError, MemoryError, SyntaxWarning, DeprecationWarning):
        raise _wrong(text, 1, "it cannot be read; write operators between numbers, names and brackets") from None


def _names_of(tree: ast.expr) -> list[ast.Name]:
    """Every name that is not a called function's."""
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    return [node for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in called]


def _refuse_large(text: str, tree: ast.expr) -> None:
    count, level, row = 0, 0, [tree]
    while row:
        count, level = count + len(row), level + 1
        if level > MOST_LEVELS:
            raise _wrong(text, row[0], f"nested more than {MOST_LEVELS} levels deep")
        row = [child for node in row for child in ast.iter_child_nodes(node) if isinstance(child, ast.expr)]
    if count > MOST_NODES:
        raise _wrong(text, tree, f"{count} names, numbers and operations; at most {MOST_NODES} are allowed")


def _check(text: str, node: ast.expr, names: dict[str, None]) -> int:
    """Number of components of a node, 1 or 3; names are collected. Raises InputError."""
    if isinstance(node, ast.Constant):
        value = node.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise _wrong(text, node, f"{value!r} is no number")
        if value and not LEAST <= abs(value) <= GREATEST:  # also an integer that is no double
            raise _wrong(text, node, f"number out of range; allowed are 0 and {LEAST:g} to {GREATEST:g}")
        return 1
    if isinstance(node, ast.Name):
        names[node.id] = None
        return 1
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        return _check(text, node.operand, names)
    if isinstance(node, ast.BinOp) and type(node.op) in _SIGNS:
        return _checked_operation(text, node, names)
    if isinstance(node, ast.Call):
        return _checked_call(text, node, names)
    if isinstance(node, ast.List):
        if len(node.elts) != 3 or any(_check(text, each, names) != 1 for each in node.elts):
            raise _wrong(text, node, "brackets hold three components, [x, y, z]")
        return 3
    allowed = "numbers, names, + - * / **, (...), [x, y, z] and functions"
    raise _wrong(text, node, f"{type(node).__name__.lower()} is not allowed; allowed are {allowed}")


def _checked_operation(text: str, node: ast.BinOp, names: dict[str, None]) -> int:
    left, right = (_check(text, side, names) for side in (node.left, node.right))
    sign = _SIGNS[type(node.op)]
    if sign == "**":
        power = node.right.value if isinstance(node.right, ast.Constant) else None
        if left != 1 or not isinstance(power, int) or not 1 <= power <= MOST_POWER:
            raise _wrong(text, node.right, f"a power must be a whole number from 1 to {MOST_POWER}")
        return 1
    if sign in "+-" and left != right:
        raise _wrong(text, node, "one side has three components, the other one")
    if (sign == "/" and right == 3) or (sign == "*" and left == right == 3):
        raise _wrong(text, node, "three components can be multiplied or divided by a number only")
    return max(left, right)


def _checked_call(text: str, node: ast.Call, names: dict[str, None]) -> int:
    name = node.func.id if isinstance(node.func, ast.Name) else ""
    if name not in FUNCTIONS:
        raise _wrong(text, node, f"unknown function {name!r}; allowed are {', '.join(FUNCTIONS)}")
    if node.keywords or len(node.args) != FUNCTIONS[name]:
        raise _wrong(text, node, f"{name} takes {FUNCTIONS[name]} argument{'s'[: FUNCTIONS[name] - 1]}")
    if any(_check(text, each, names) != 1 for each in node.args):
        raise _wrong(text, node, f"{name} takes no three components")
    return 1


def _value(node: ast.expr, names: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]) -> Any:
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
    return _each(_OPERATIONS[type(node.op)], left, _value(node.right, names, functions))


def _each(operation: Callable[[Any, Any], Any], left: Any, right: Any) -> Any:
    """An operation on numbers, or on each of three components."""
    if not isinstance(left, list) and not isinstance(right, list):
        return operation(left, right)
    sides = [side if isinstance(side, list) else [side] * 3 for side in (left, right)]
    return [operation(a, b) for a, b in zip(*sides, strict=True)]


def names_in(formulas: Collection[Formula]) -> tuple[str, ...]:
    """Names that formulas use, each once."""
    return tuple(dict.fromkeys(name for f in formulas for name in f.names))

"""What docs/studies/mutants.py changes in the package: the rules by which mutants are drawn, one change each."""

from __future__ import annotations

import ast
from collections import Counter
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from mutants_listed import LISTED

PACKAGE = Path(__file__).parents[2] / "casadical"


@dataclass(frozen=True)
class Mutant:
    """path : below casadical; line; start, end : which characters of the file; new : what they become.

    what : the change in words; copy : how often the same change was found above it in the file.
    """

    path: str
    line: int
    start: int
    end: int
    new: str
    what: str
    copy: int = 0

    @property
    def room(self) -> str:
        return self.path.partition("/")[0]

    @property
    def name(self) -> str:
        return f"{self.path}:{self.line} {self.what}"

    @property
    def key(self) -> str:
        """Name without the line, which moves."""
        return f"{self.path} {self.what}" + (f" [{self.copy + 1}]" if self.copy else "")


SWAPPED = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"), ast.MatMult: ("@", "*"),
    ast.Lt: ("<", "<="), ast.LtE: ("<=", "<"), ast.Gt: (">", ">="), ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="), ast.NotEq: ("!=", "=="), ast.And: ("and", "or"), ast.Or: ("or", "and"),
}  # fmt: skip
NAMES = {
    "sin": "cos", "cos": "sin", "min": "max", "max": "min", "fmin": "fmax", "fmax": "fmin", "argmin": "argmax",
    "argmax": "argmin", "mean": "median", "median": "mean", "deg2rad": "rad2deg", "rad2deg": "deg2rad", "any": "all",
    "all": "any", "sqrt": "abs", "rot_x": "rot_y", "rot_y": "rot_z", "rot_z": "rot_x", "lower": "upper",
    "upper": "lower", "floor": "ceil", "ceil": "floor",
}  # fmt: skip


class _Finder(ast.NodeVisitor):
    """All changes that the rules find in one file."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.starts = [0]
        for line in text.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))
        self.found: list[tuple[int, int, int, str, str]] = []

    def place(self, line: int, column: int) -> int:
        """Of a place that ast counts in bytes, in characters."""
        whole = self.text[self.starts[line - 1] : self.starts[line]].encode()
        return self.starts[line - 1] + len(whole[:column].decode())

    def span(self, node: ast.expr) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self.place(node.lineno, node.col_offset), self.place(node.end_lineno, node.end_col_offset)

    def add(self, node: ast.expr, start: int, end: int, new: str) -> None:
        what = f"{self.text[start:end].strip()} -> {new.strip() or 'nothing'}"
        self.found.append((node.lineno, start, end, new, " ".join(what.split())))

    def between(self, left: ast.expr, right: ast.expr, op: ast.AST) -> None:
        """Another operator between two operands, or the right operand of a sum dropped."""
        if type(op) not in SWAPPED:
            return
        old, new = SWAPPED[type(op)]
        start, end = self.span(left)[1], self.span(right)[0]
        at = self.text.find(old, start, end)
        if at >= 0:
            self.add(left, at, at + len(old), new)
        if isinstance(op, ast.Add | ast.Sub) and self.text[start:end].strip() in "+-":
            self.add(left, start, self.span(right)[1], "")

    def visit_BinOp(self, node: ast.BinOp) -> None:
        if not any(isinstance(n, ast.JoinedStr) or (isinstance(n, ast.Constant) and isinstance(n.value, str))
                   for n in (node.left, node.right)):  # fmt: skip
            self.between(node.left, node.right, node.op)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        self.between(node.values[0], node.values[1], node.op)
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        self.between(node.left, node.comparators[0], node.ops[0])
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        start, (operand, _) = self.span(node)[0], self.span(node.operand)
        if isinstance(node.op, ast.USub | ast.Not):
            self.add(node, start, operand, "")
        if not (isinstance(node.op, ast.USub) and isinstance(node.operand, ast.Constant)):
            self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        start, end = self.span(node)
        if isinstance(node.value, bool):
            self.add(node, start, end, str(not node.value))
        elif isinstance(node.value, int):
            self.add(node, start, end, str(node.value + 1))
        elif isinstance(node.value, float):
            unit = node.value in (1e3, 1e-3, 1e6, 1e-6)
            self.add(node, start, end, repr(1 / node.value if unit else 1.3 * node.value + (node.value == 0)))

    def visit_Attribute(self, node: ast.Attribute) -> None:
        self.generic_visit(node)
        _, end = self.span(node)
        if node.attr == "T":
            self.add(node, end - 2, end, "")
        elif node.attr in NAMES:
            self.add(node, end - len(node.attr), end, NAMES[node.attr])

    def visit_Name(self, node: ast.Name) -> None:
        if node.id in NAMES:
            self.add(node, *self.span(node), NAMES[node.id])

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        for part in (*node.body, *node.args.defaults):
            self.visit(part)

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        for part in node.body:
            self.visit(part)

    def visit_keyword(self, node: ast.keyword) -> None:
        if node.arg not in ("strict", "frozen", "eq"):
            self.visit(node.value)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_Raise(self, node: ast.Raise) -> None:
        """Messages are no formulas."""

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Nor is text."""

    def visit_Import(self, node: ast.Import) -> None: ...

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None: ...


@cache
def changes(path: str) -> tuple[Mutant, ...]:
    """All mutants that the rules find in a file below casadical, from top to bottom."""
    text = (PACKAGE / path).read_text(encoding="utf-8")
    finder = _Finder(text)
    finder.visit(ast.parse(text))
    found, seen = [], Counter[str]()
    for line, start, end, new, what in sorted(finder.found, key=lambda change: change[:3]):
        found.append(Mutant(path, line, start, end, new, what, seen[what]))
        seen[what] += 1
    return tuple(found)


def listed() -> list[Mutant]:
    """The mutants of LISTED that the package still has."""
    found = []
    for path, old, new, what in LISTED:
        text = (PACKAGE / path).read_text(encoding="utf-8")
        at = text.find(old)
        if at >= 0:
            found.append(Mutant(path, text.count("\n", 0, at) + 1, at, at + len(old), new, what))
    return found

"""What docs/studies/mutants.py changes in the package: changes of cosmic-ray, drawn by room, and those of the audit."""

from __future__ import annotations

import ast
import random
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.provider import OperatorProvider

PACKAGE = Path(__file__).parents[2] / "casadical"


@dataclass(frozen=True)
class Mutant:
    """path : below casadical; line : of the change; text : of the changed file; what : the change in words."""

    path: str
    line: int
    text: str
    what: str

    @property
    def room(self) -> str:
        return self.path.partition("/")[0]

    @property
    def name(self) -> str:
        return f"{self.path}:{self.line} {self.what}"

    @property
    def key(self) -> str:
        """Name without the line."""
        return f"{self.path} {self.what}"


class _Plain(ast.NodeTransformer):
    """A program without its annotations, which nothing reads."""

    def visit_AnnAssign(self, node: ast.AnnAssign) -> Any:
        return node if node.value is None else ast.Assign([node.target], self.visit(node.value))

    def visit_arg(self, node: ast.arg) -> ast.arg:
        return ast.arg(node.arg)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> Any:
        node.returns = None
        return self.generic_visit(node)

    visit_AsyncFunctionDef = visit_FunctionDef  # type: ignore[assignment]


def _program(text: str) -> str:
    return ast.dump(_Plain().visit(ast.parse(text)))


def _mutant(path: str, line: int, operator: str, occurrence: int) -> Mutant | None:
    """None where the change is none to a program that runs: of an annotation, or no Python."""
    text = (PACKAGE / path).read_text(encoding="utf-8")
    changed = mutate_code(text, OperatorProvider()[operator](), occurrence)
    try:
        if changed is None or _program(changed) == _program(text):
            return None
    except SyntaxError:
        return None
    pairs = zip(text.splitlines(), changed.splitlines(), strict=False)
    was, is_ = next(((a.strip(), b.strip()) for a, b in pairs if a != b), ("", ""))
    return Mutant(path, line, changed, f"{operator} {occurrence}: {was} => {is_}")


def drawn(room: str, number: int, seed: int) -> Iterator[Mutant]:
    """So many mutants of a room: a place of all that cosmic-ray can change, and one of the changes that it knows there.

    Every place of the room is as likely as another; no rule names a file, a line or a kind of change.
    """
    places: dict[tuple[str, Any], list[tuple[str, int]]] = defaultdict(list)
    operators = {name: OperatorProvider()[name] for name in OperatorProvider()}
    for path in sorted((PACKAGE / room).rglob("*.py")):
        nodes = list(ast_nodes(get_ast(path.read_text(encoding="utf-8"))))
        for name, made in operators.items():
            if made.arguments():  # asks for the name of a variable
                continue
            found = [span for node in nodes for span in made().mutation_positions(node)]
            for occurrence, span in enumerate(found):
                places[str(path.relative_to(PACKAGE)), span].append((name, occurrence))
    rng, order = random.Random(f"{seed} {room}"), list(places)
    rng.shuffle(order)
    tried = (_mutant(path, span[0][0], *rng.choice(places[path, span])) for path, span in order)
    yield from islice((mutant for mutant in tried if mutant), number)

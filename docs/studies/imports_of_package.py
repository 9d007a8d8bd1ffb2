"""The modules of a package, and what they import by grimp, on which import-linter stands; nothing is run."""

from __future__ import annotations

import ast
import sys
from dataclasses import dataclass
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp


@dataclass(frozen=True)
class Source:
    """A module: its dotted name without the package's, its text (its stub's behind it) and its syntax tree."""

    name: str
    text: str
    tree: ast.Module

    @property
    def room(self) -> str:
        return self.name.split(".")[0]

    @property
    def lines(self) -> int:
        return len(self.text.splitlines())

    @cached_property
    def nodes(self) -> tuple[ast.AST, ...]:
        return tuple(ast.walk(self.tree))


@dataclass(frozen=True)
class House:
    """The package in one folder."""

    folder: Path

    @cached_property
    def modules(self) -> dict[str, Source]:
        found = {}
        for path in sorted(p for p in self.folder.rglob("*.py") if p.name != "__main__.py"):
            parts = path.relative_to(self.folder).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            text = "".join(p.read_text(encoding="utf-8") for p in (path, path.with_suffix(".pyi")) if p.exists())
            found[name] = Source(name, text, ast.parse(text))
        return found

    @cached_property
    def rooms(self) -> list[str]:
        return sorted({module.room for module in self.modules.values()} - {""})

    @cached_property
    def imports(self) -> dict[str, set[str]]:
        """Of each module the modules that it imports; the front door, `casadical/__init__.py`, is no part of it."""
        package = self.folder.name
        sys.path.insert(0, str(self.folder.parent))
        try:
            graph = grimp.build_graph(package, cache_dir=None)
        finally:
            sys.path.remove(str(self.folder.parent))
        found = {n: graph.find_modules_directly_imported_by(f"{package}.{n}") - {package} for n in self.modules if n}
        return {name: {other.removeprefix(f"{package}.") for other in others} for name, others in found.items()}

    @cached_property
    def arrows(self) -> dict[tuple[str, str], int]:
        """Room to room, and by how many modules of the first."""
        found: dict[tuple[str, str], int] = {}
        for name, others in self.imports.items():
            room = self.modules[name].room
            for other in {self.modules[o].room for o in others} - {room}:
                found[room, other] = found.get((room, other), 0) + 1
        return found

    @cached_property
    def circle(self) -> list[str]:
        """Modules that import each other in a loop, or none."""
        try:
            TopologicalSorter({name: sorted(others) for name, others in sorted(self.imports.items())}).prepare()
        except CycleError as error:
            return list(error.args[1])
        return []

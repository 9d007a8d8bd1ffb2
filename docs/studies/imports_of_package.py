"""The modules of a package and what they import, read with `ast`; nothing is run."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from pathlib import Path


@dataclass(frozen=True)
class Source:
    """A module: its dotted name without the package's, its text (its stub's behind it) and its syntax tree."""

    name: str
    is_package: bool
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
            found[name] = Source(name, parts[-1] == "__init__", text, ast.parse(text))
        return found

    @cached_property
    def entries(self) -> list[str]:
        return sorted(p.name for p in self.folder.iterdir() if p.name != "__pycache__")

    @cached_property
    def rooms(self) -> list[str]:
        return sorted({module.room for module in self.modules.values()} - {""})

    @cached_property
    def imports(self) -> dict[str, set[str]]:
        """Of each module the modules that it imports; the front door, `casadical/__init__.py`, is no part of it."""
        return {name: set(self._imported(module)) - {name, ""} for name, module in self.modules.items() if name}

    def _imported(self, module: Source) -> Iterator[str]:
        for node in module.nodes:
            if isinstance(node, ast.Import):
                yield from (self._known(alias.name) for alias in node.names if self._is_ours(alias.name))
            elif isinstance(node, ast.ImportFrom):
                base = self._base(module, node)
                if self._is_ours(base):
                    for alias in node.names:
                        yield self._known(f"{base}.{alias.name}")
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                package, _, name = node.value.partition(":")[0].partition(".")
                if package == self.folder.name and name in self.modules and not self.modules[name].is_package:
                    yield name

    def _base(self, module: Source, node: ast.ImportFrom) -> str:
        if not node.level:
            return node.module or ""
        own = [self.folder.name, *module.name.split(".")] if module.name else [self.folder.name]
        own = own if module.is_package else own[:-1]
        return ".".join([*own[: len(own) - node.level + 1], *([node.module] if node.module else [])])

    def _is_ours(self, name: str) -> bool:
        return name.split(".")[0] == self.folder.name

    def _known(self, name: str) -> str:
        """The module that a dotted name lies in, without the package's name."""
        name = name.partition(".")[2]
        while name not in self.modules:
            name = name.rpartition(".")[0]
        return name

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
            TopologicalSorter(self.imports).prepare()
        except CycleError as error:
            return list(error.args[1])
        return []

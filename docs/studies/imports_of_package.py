"""The modules of a package, read with `ast`: their imports, circles, repeated lines and the names that they speak."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import networkx as nx

# The blind check is left out: its simulators have their own list of causes on purpose.
INDEPENDENT = {"blind_check", "withheld", "engine", "simulation"}
REPEATED = 6  # lines


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

    @cached_property
    def words(self) -> set[str]:
        """Names and strings of its code, docstrings left out."""
        docs = {
            id(node.body[0].value)
            for node in self.nodes
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            and node.body
            and isinstance(node.body[0], ast.Expr)
        }
        found = {self.name.rpartition(".")[2]}
        for node in self.nodes:
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs:
                found |= {node.value, *node.value.split(":")[-1:]}
            elif isinstance(node, ast.Name):
                found.add(node.id)
            elif isinstance(node, ast.ClassDef):
                found.add(node.name)
            elif isinstance(node, ast.Attribute):
                found.add(node.attr)
            elif isinstance(node, ast.alias):
                found |= {node.name, node.asname or node.name}
        return found


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
    def circles(self) -> list[list[str]]:
        """Modules that import each other in a loop, the largest first."""
        graph = nx.DiGraph((name, other) for name, others in self.imports.items() for other in others)
        found = (sorted(circle) for circle in nx.strongly_connected_components(graph) if len(circle) > 1)
        return sorted(found, key=lambda circle: (-len(circle), circle))

    def typed_names(self) -> tuple[int, int]:
        """Public names at the top that a type checker sees as what they are, and all."""
        tree = self.modules[""].tree
        typed = {alias.asname for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) for alias in n.names}
        typed |= {n.name for n in tree.body if isinstance(n, ast.FunctionDef | ast.ClassDef)}
        names = _public(tree) or typed - {None}  # with a stub, the stub is the list
        return len(names & typed), len(names)


def _public(tree: ast.Module) -> set[str]:
    """Names in `__all__`, literal or made of a dictionary's keys; dunders left out."""
    values = {
        t.id: n.value for n in tree.body if isinstance(n, ast.Assign) for t in n.targets if isinstance(t, ast.Name)
    }
    values |= {
        n.target.id: n.value
        for n in tree.body
        if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name) and n.value
    }

    def strings(node: ast.expr) -> Iterator[str]:
        for part in ast.walk(node):
            if isinstance(part, ast.Dict):
                yield from (k.value for k in part.keys if isinstance(k, ast.Constant))
                return
            if isinstance(part, ast.Name) and part.id in values:
                yield from strings(values[part.id])
            elif isinstance(part, ast.Constant) and isinstance(part.value, str):
                yield part.value

    listed = values.get("__all__")
    return {name for name in strings(listed) if not name.startswith("__")} if listed else set()


def classes(house: House, folder: str, base: str) -> dict[str, set[str]]:
    """Classes on this base in the files of a folder, each with its registered name."""
    found = {}
    for name, module in house.modules.items():
        for node in module.tree.body if name.startswith(f"{folder}.") else ():
            if isinstance(node, ast.ClassDef) and base in {getattr(b, "id", "") for b in node.bases}:
                found[node.name] = {node.name, *_named(node)}
    return found


def defined(house: House) -> dict[str, set[str]]:
    """Effects that are tables of a file, by class, each with both names."""
    names = {name for said in _data_files(house) for name in said}
    return {(kind := name.title().replace("_", "")): {kind, name} for name in sorted(names)}


def _data_files(house: House) -> list[set[str]]:
    """Names of the effects that each file of data defines."""
    files = sorted(house.folder.rglob("*.effect.toml"))
    return [{d["name"] for d in tomllib.loads(file.read_text(encoding="utf-8"))["definition"]} for file in files]


def _named(node: ast.ClassDef) -> Iterator[str]:
    for n in node.body:
        target = n.target if isinstance(n, ast.AnnAssign) else n.targets[0] if isinstance(n, ast.Assign) else None
        if getattr(target, "id", "") == "name" and isinstance(n.value, ast.Constant):
            yield n.value.value


def files_naming(house: House, members: dict[str, set[str]]) -> list[int]:
    """Of each member the number of files that name it, its own among them."""
    spoken = [m.words for m in house.modules.values() if m.name and m.room not in INDEPENDENT]
    spoken += _data_files(house)
    return [sum(bool(names & said) for said in spoken) for names in members.values()]


def repeated_lines(house: House) -> int:
    """Code lines in a block of six or more that occurs again; imports, comments and docstrings are left out."""
    places: dict[tuple[str, ...], list[tuple[str, int]]] = {}
    for module in house.modules.values():
        left_out = {
            k
            for n in module.nodes
            if isinstance(n, ast.Import | ast.ImportFrom)
            or (isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant) and isinstance(n.value.value, str))
            for k in range(n.lineno, (n.end_lineno or n.lineno) + 1)
        }
        code = [
            (k, line.strip())
            for k, line in enumerate(module.text.splitlines(), 1)
            if k not in left_out and line.strip() and not line.strip().startswith("#")
        ]
        for at in range(len(code) - REPEATED + 1):
            block = code[at : at + REPEATED]
            if sum(len(line) > 2 for _, line in block) == REPEATED:  # no runs of closing brackets
                places.setdefault(tuple(line for _, line in block), []).append((module.name, at))
    marked = {
        (name, at + k) for found in places.values() if len(found) > 1 for name, at in found for k in range(REPEATED)
    }
    return len(marked)

"""What a parameter passes on its way through calls, read with `ast`; nothing is run.

The parameter is followed into every function of the package that is given it, an attribute of it, or a name made of it,
in the order in which the code is written; into each function once. It ends where it is put into an object: from there
on the object goes. A station is a stay in one file, a climb an entry on a higher floor than the one before.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import pairwise

from imports_of_package import House

Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass
class Walk:
    """The way of a parameter; entries : modules of the functions that it enters."""

    house: House
    entries: list[str] = field(default_factory=list)
    passed: set[tuple[str, str]] = field(default_factory=set)

    @cached_property
    def floor(self) -> dict[str, int]:
        """Of each room: it stands above all that it imports."""

        def of(room: str, *above: str) -> int:
            way = (*above, room)  # a room that is passed again, in a circle, is not counted twice
            return 1 + max((of(b, *way) for a, b in self.house.arrows if a == room and b not in way), default=0)

        return {room: of(room) for room in self.house.rooms}

    @property
    def stations(self) -> int:
        return sum(a != b for a, b in zip(["", *self.entries], self.entries, strict=False))

    @property
    def climbs(self) -> int:
        floors = [self.floor[name.split(".")[0]] for name in self.entries]
        return sum(b > a for a, b in pairwise(floors))

    def follow(self, module: str, name: str, *parameters: str) -> Walk:
        """Enter a function, `name` or Class.method, as one or some of its parameters."""
        node = self._definitions(module)[name]
        self.entries.append(module)
        self.passed.add((module, name))
        borne = set(parameters)
        for statement in node.body:
            self._pass_through(statement, module, name, borne, _types(node))
        return self

    def _pass_through(self, node: ast.AST, module: str, name: str, borne: set[str], types: dict[str, str]) -> None:
        if isinstance(node, ast.Assign | ast.AnnAssign | ast.NamedExpr | ast.For | ast.comprehension):
            value = node.iter if isinstance(node, ast.For | ast.comprehension) else node.value
            if value is not None and _mentions(value, borne) and not self._is_put_down(value, module):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                borne |= {n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)}
        for child in ast.iter_child_nodes(node):
            self._pass_through(child, module, name, borne, types)
        if isinstance(node, ast.Call):
            self._call(node, module, name, borne, types)

    def _call(self, node: ast.Call, module: str, name: str, borne: set[str], types: dict[str, str]) -> None:
        place = self._resolved(node.func, module, name, types)
        if place is None:
            return
        known = self._definitions(place[0]).get(place[1])
        if not isinstance(known, Function):
            return
        own = [a.arg for a in (*known.args.posonlyargs, *known.args.args)]
        bound = "." in place[1] and own[:1] in (["self"], ["cls"])
        given = [*zip(own[bound:], node.args, strict=False), *((k.arg, k.value) for k in node.keywords if k.arg)]
        if bound and isinstance(node.func, ast.Attribute):
            given.insert(0, (own[0], node.func.value))
        ours = [str(parameter) for parameter, value in given if _is_of(value, borne)]
        if ours and place not in self.passed:
            self.follow(*place, *ours)

    def _is_put_down(self, value: ast.expr, module: str) -> bool:
        place = self._resolved(value.func, module, "", {}) if isinstance(value, ast.Call) else None
        return place is not None and isinstance(self._definitions(place[0]).get(place[1]), ast.ClassDef)

    def _resolved(self, func: ast.expr, module: str, name: str, types: dict[str, str]) -> tuple[str, str] | None:
        """Module and name of what is called: a function or class, or a method of an object whose class is declared."""
        if isinstance(func, ast.Name):
            return self._home(module, func.id)
        if not isinstance(func, ast.Attribute) or not isinstance(func.value, ast.Name):
            return None
        kind = name.partition(".")[0] if func.value.id == "self" else types.get(func.value.id, "")
        home = self._home(module, kind)
        return (home[0], f"{home[1]}.{func.attr}") if home else None

    def _home(self, module: str, name: str) -> tuple[str, str] | None:
        if name in self._definitions(module):
            return module, name
        return self._imported(module).get(name)

    @cache  # noqa: B019
    def _definitions(self, module: str) -> dict[str, ast.AST]:
        found: dict[str, ast.AST] = {}
        for node in self.house.modules[module].tree.body:
            if isinstance(node, Function | ast.ClassDef):
                found.setdefault(node.name, node)
            if isinstance(node, ast.ClassDef):
                found |= {f"{node.name}.{m.name}": m for m in node.body if isinstance(m, Function)}
        return found

    @cache  # noqa: B019
    def _imported(self, module: str) -> dict[str, tuple[str, str]]:
        package = f"{self.house.folder.name}."
        return {
            alias.asname or alias.name: (node.module.removeprefix(package), alias.name)
            for node in self.house.modules[module].nodes
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(package)
            for alias in node.names
            if node.module.removeprefix(package) in self.house.modules
        }

    __hash__ = object.__hash__


def _types(node: Function) -> dict[str, str]:
    """The first class that the annotation of each parameter names."""
    arguments = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
    named = {
        a.arg: [n.id for n in ast.walk(a.annotation) if isinstance(n, ast.Name)] for a in arguments if a.annotation
    }
    return {name: classes[0] for name, classes in named.items() if classes}


def _mentions(value: ast.expr, names: set[str]) -> bool:
    return any(isinstance(n, ast.Name) and n.id in names for n in ast.walk(value))


def _is_of(value: ast.expr, names: set[str]) -> bool:
    """Whether an argument is one of these, or an attribute or item of one."""
    while isinstance(value, ast.Attribute | ast.Subscript | ast.Starred):
        value = value.value
    return isinstance(value, ast.Name) and value.id in names

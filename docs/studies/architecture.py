"""The floor plan of the package, drawn from its imports: python docs/studies/architecture.py

It reads every Python file of the package with `ast` and imports none. It writes docs/images/architecture.svg and the
tables between the markers of docs/architecture.md. `--check` writes nothing and ends in 1 if the page is out of date:
other rooms, imports or circles, or a figure that differs by more than a tenth. `--figures [PACKAGE]` prints the
figures, also of another copy of the package; architecture_before.txt holds those of commit e4e7bcd, before the rooms.

A room is an entry of the package's folder: a folder or a module. An arrow from room A to room B means that a module of
A imports one of B, anywhere in the file: inside functions, under TYPE_CHECKING, or as a module's name in a string.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from html import escape
from itertools import pairwise
from pathlib import Path
from statistics import median

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "architecture.md"
PICTURE = ROOT / "docs" / "images" / "architecture.svg"
BEFORE = Path(__file__).with_name("architecture_before.txt")
TOLERANCE = 0.1
REPEATED = 6  # lines

# What a room is for, as short as a box in the picture wants it.
PURPOSE = {
    "cli": "commands, exit codes",
    "report": "HTML reports, figures",
    "fleet": "changes, many campaigns, many robots",
    "project": "problem folders, Calibration",
    "blind_check": "diagnosis judged by simulators",
    "export": "C, MJCF, corrected programs",
    "diagnosis": "causes of the remaining error",
    "pose_selection": "which poses to measure",
    "identification": "parameters from measurements",
    "measurements": "tables of measured poses",
    "robot": "model of an arm, its files",
    "effects": "physics beyond the base model",
    "compensator": "a network for the remaining error",
    "core": "errors, types, frames, files",
}

# Members that stand for their family in "files that name a member": what the code calls them. The blind check is left
# out: its simulators have their own list of causes on purpose.
INDEPENDENT = {"blind_check", "withheld", "engine", "simulation"}
KINDS = {"pair_distance": {"pair_distance", "PairDistance"}, "contact": {"contact", "Contact"}}
LANGUAGES = {"structured text": {"structured_text", "StructuredText"}}


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
        for path in sorted(self.folder.rglob("*.py")):
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
        """Modules that import each other in a loop, the largest first (Tarjan, 1972)."""
        index: dict[str, int] = {}
        low: dict[str, int] = {}
        stack: list[str] = []
        found: list[list[str]] = []

        def visit(name: str) -> None:
            index[name] = low[name] = len(index)
            stack.append(name)
            for other in sorted(self.imports[name]):
                if other not in index:
                    visit(other)
                    low[name] = min(low[name], low[other])
                elif other in stack:
                    low[name] = min(low[name], index[other])
            if low[name] == index[name]:
                at = stack.index(name)
                found.append(sorted(stack[at:]))
                del stack[at:]

        for name in sorted(self.imports):
            if name not in index:
                visit(name)
        return sorted((c for c in found if len(c) > 1), key=lambda c: (-len(c), c))

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


def _named(node: ast.ClassDef) -> Iterator[str]:
    for n in node.body:
        target = n.target if isinstance(n, ast.AnnAssign) else n.targets[0] if isinstance(n, ast.Assign) else None
        if getattr(target, "id", "") == "name" and isinstance(n.value, ast.Constant):
            yield n.value.value


def files_naming(house: House, members: dict[str, set[str]]) -> list[int]:
    """Of each member the number of files that name it, its own among them."""
    spoken = [m.words for m in house.modules.values() if m.name and m.room not in INDEPENDENT]
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


def percentile(values: list[int], share: float) -> int:
    return sorted(values)[min(len(values) - 1, int(share * len(values)))]


def figures(house: House) -> dict[str, str]:
    """What is measured, as a name and a value."""
    files = [m.lines for m in house.modules.values()]
    functions = [
        (n.end_lineno or n.lineno) - n.lineno + 1
        for m in house.modules.values()
        for n in m.nodes
        if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    others = [
        p
        for p in house.folder.rglob("*")
        if p.is_file() and p.suffix not in (".py", ".pyi", ".pyc") and p.name != "py.typed"
    ]
    families = {
        "effect": classes(house, "effects", "Effect"),
        "kind of measurement": KINDS,
        "trainer": classes(house, "compensator.trainers", "Trainer"),
        "controller language": LANGUAGES,
    }
    typed, names = house.typed_names()
    sizes = [len(c) for c in house.circles]
    largest = f", {', '.join(map(str, sizes))} modules" if sizes else ""
    return {
        "entries at the package's root": str(len(house.entries)),
        "rooms": str(len(house.rooms)),
        "import arrows between rooms": str(len(house.arrows)),
        "circles between modules": f"{len(sizes)}{largest}",
        "top-level names that are typed": f"{typed} of {names}",
        "Python files": str(len(files)),
        "Python lines": str(sum(files)),
        "template lines": str(sum(len(p.read_text(encoding="utf-8").splitlines()) for p in others)),
        "lines in repeated blocks of six or more": str(repeated_lines(house)),
        "file length, median and 90 %": f"{median(files):.0f} and {percentile(files, 0.9)} lines",
        "function length, median and 90 %": f"{median(functions):.0f} and {percentile(functions, 0.9)} lines",
        **{
            f"files that name one {family}": _range(files_naming(house, members))
            for family, members in families.items()
        },
    }


def _range(counts: list[int]) -> str:
    low, middle, high = min(counts), median(counts), max(counts)
    return str(low) if low == high else f"{middle:.0f} ({low} to {high})"


def floors() -> list[list[str]]:
    """Rooms by floor, the top one first, as the import contract has them."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contract = next(c for c in settings["tool"]["importlinter"]["contracts"] if c["type"] == "layers")
    return [[room.strip(" ()") for room in re.split(r"[:|]", layer)] for layer in contract["layers"]]


INK, SOFT, FAINT, PAPER, WALL = "#23262b", "#5c6068", "#e7e3da", "#fdfcf9", "#8a8272"
DOWN, UP = "#0f766e", "#c2410c"
FLOOR, WIDTH, CELL = 56, 660, 34


def picture(house: House) -> str:
    """The house in section, floor above floor, and below it which room imports which."""
    storeys = floors()
    order = [room for storey in storeys for room in storey]
    left, top = 24, 108
    grid = top + FLOOR * len(storeys) + 160
    width, height = WIDTH + 2 * left, grid + CELL * len(order) + 66
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="Helvetica, Arial, sans-serif" role="img" aria-label="Floor plan of the package casadical">',
        f'<rect width="{width}" height="{height}" fill="{PAPER}"/>',
        *_section(storeys, left, top),
        *_matrix(house, order, left + 170, grid),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _section(storeys: list[list[str]], left: int, top: int) -> Iterator[str]:
    right, bottom = left + WIDTH, top + FLOOR * len(storeys)
    ridge = (left + right) / 2
    yield f'<path d="M{left - 14} {top} L{ridge} 30 L{right + 14} {top} Z" fill="{FAINT}" stroke="{WALL}"/>'
    yield _text(ridge, top - 34, "casadical", 17, INK, "middle", "bold")
    yield _text(ridge, top - 16, "the public names", 11.5, SOFT, "middle")
    for k, storey in enumerate(storeys):
        y = top + FLOOR * k
        edges = [left + WIDTH * i / len(storey) for i in range(len(storey) + 1)]
        for room, (a, b) in zip(storey, pairwise(edges), strict=True):
            yield (
                f'<rect x="{a:.1f}" y="{y}" width="{b - a:.1f}" height="{FLOOR}" fill="white" stroke="{WALL}" '
                'stroke-width="1"/>'
            )
            yield _text((a + b) / 2, y + 26, room, 14.5, INK, "middle", "bold")
            yield _text((a + b) / 2, y + 43, PURPOSE[room], 11, SOFT, "middle")
        yield f'<path d="M{left} {y} H{right}" stroke="{WALL}" stroke-width="2.5"/>'
    yield f'<rect x="{left - 8}" y="{bottom}" width="{WIDTH + 16}" height="9" fill="{WALL}"/>'
    yield _text(
        left, bottom + 34, "A room imports from the floors below; from its own where the contract says so.", 11.5
    )


def _matrix(house: House, order: list[str], left: float, top: int) -> Iterator[str]:
    """A dot where the room of the row imports the room of the column."""
    size = CELL * len(order)
    for k, room in enumerate(order):
        middle = CELL * (k + 0.5)
        yield f'<path d="M{left} {top + CELL * k} h{size} M{left + CELL * k} {top} v{size}" stroke="{FAINT}"/>'
        yield _text(left - 10, top + middle + 4, room, 12, INK, "end")
        x, y = left + middle + 4, top - 10
        yield (
            f'<text x="{x}" y="{y}" font-size="12" fill="{INK}" transform="rotate(-60 {x} {y})">{escape(room)}</text>'
        )
        yield f'<rect x="{left + CELL * k}" y="{top + CELL * k}" width="{CELL}" height="{CELL}" fill="{FAINT}"/>'
    yield f'<rect x="{left}" y="{top}" width="{size}" height="{size}" fill="none" stroke="{WALL}"/>'
    for a, b in sorted(house.arrows):
        i, j = order.index(a), order.index(b)
        x, y = left + CELL * (j + 0.5), top + CELL * (i + 0.5)
        colour = DOWN if _allowed(a, b) else UP
        yield f'<circle cx="{x}" cy="{y}" r="6" fill="{colour}"><title>{a} to {b}</title></circle>'
    yield _text(left, top + size + 26, "A dot: the room of the row imports the room of the column.", 11.5)
    yield _text(left, top + size + 43, "Orange: against the contract.", 11.5)


def _allowed(a: str, b: str) -> bool:
    level = {room: k for k, storey in enumerate(floors()) for room in storey}
    return level[a] <= level[b]


def _text(
    x: float, y: float, text: str, size: float, colour: str = SOFT, anchor: str = "start", weight: str = "normal"
) -> str:
    return (
        f'<text x="{x:g}" y="{y:g}" font-size="{size:g}" fill="{colour}" text-anchor="{anchor}" '
        f'font-weight="{weight}">{escape(text)}</text>'
    )


def imports_table(house: House) -> str:
    """Of each room, top floor first, the rooms that it imports."""
    order = [room for storey in floors() for room in storey]
    rows = ["| room | imports |", "|---|---|"]
    for room in order:
        below = [other for other in order if (room, other) in house.arrows]
        rows.append(f"| `{room}` | {', '.join(f'`{b}`' for b in below) or 'nothing of the package'} |")
    circles = [", ".join(f"`{name}`" for name in circle) for circle in house.circles]
    rows += ["", "Circles between modules: " + ("; ".join(circles) if circles else "none") + "."]
    return "\n".join(rows)


def figures_table(house: House) -> str:
    before = dict(re.split(r" {2,}", line, maxsplit=1) for line in BEFORE.read_text(encoding="utf-8").splitlines())
    rows = ["| | before | now |", "|---|---|---|"]
    rows += [f"| {name} | {before.get(name, '')} | {value} |" for name, value in figures(house).items()]
    return "\n".join(rows)


def filled(text: str, house: House) -> str:
    """The page with new tables between their markers."""
    for name, table in (("imports", imports_table(house)), ("figures", figures_table(house))):
        text = re.sub(
            rf"(<!-- {name} -->\n).*?(<!-- end of {name} -->)",
            lambda m, t=table: f"{m[1]}\n{t}\n\n{m[2]}",
            text,
            flags=re.DOTALL,
        )
    return text


def out_of_date(house: House) -> list[str]:
    """What of the committed page and picture no longer holds, a line each."""
    found = []
    page = PAGE.read_text(encoding="utf-8")
    if imports_table(house) not in page:
        found.append("the table of imports")
    if not PICTURE.exists() or PICTURE.read_text(encoding="utf-8") != picture(house):
        found.append("the picture")
    for row in figures_table(house).splitlines():
        name, value = row.split(" | ")[0], row.rstrip(" |").split(" | ")[-1]
        old = next((line for line in page.splitlines() if line.startswith(name + " | ")), "")
        now, then = (list(map(float, re.findall(r"\d+", v))) for v in (value, old.rstrip(" |").split(" | ")[-1]))
        if len(now) != len(then) or any(abs(a - b) > max(TOLERANCE * b, 2) for a, b in zip(now, then, strict=True)):
            found.append(f"a figure:{name[1:]}: {value}")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; 1 where the page is out of date")
    parser.add_argument("--figures", nargs="?", type=Path, const=ROOT / "casadical", metavar="PACKAGE")
    options = parser.parse_args()
    if options.figures:
        print("\n".join(f"{name:42}  {value}" for name, value in figures(House(options.figures)).items()))
        return 0
    house = House(ROOT / "casadical")
    if options.check:
        stale = out_of_date(house)
        print("\n".join(f"out of date: {what}" for what in stale) or "up to date")
        return int(bool(stale))
    PICTURE.write_text(picture(house), encoding="utf-8")
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), house), encoding="utf-8")
    print(f"wrote {PICTURE.relative_to(ROOT)} and the tables of {PAGE.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""The floor plan of the package, drawn from its imports: python docs/studies/architecture.py

It reads every Python file of the package with `ast` and imports none. It writes docs/images/architecture.svg and the
tables between the markers of docs/architecture.md. `--check` writes nothing and ends in 1 if the page is out of date:
other rooms, imports or circles, or a figure that differs by more than a tenth. `--figures [PACKAGE]` prints the
figures, also of another copy of the package, and more: what a parameter passes (`parameter_walk`), who calls, how long
functions and tests are. architecture_before.txt holds those of commit e4e7bcd, before the rooms,
architecture_0408a23.txt those before one way in, one engine, one teller, architecture_now.txt those after.

A room is an entry of the package's folder: a folder or a module. An arrow from room A to room B means that a module of
A imports one of B, anywhere in the file: inside functions, under TYPE_CHECKING, or as a module's name in a string.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from pathlib import Path
from statistics import median

from floor_plan import ROOT, floors, picture
from imports_of_package import House, classes, defined, files_naming, repeated_lines
from parameter_walk import Walk, callers

PAGE = ROOT / "docs" / "architecture.md"
PICTURE = ROOT / "docs" / "images" / "architecture.svg"
BEFORE = Path(__file__).with_name("architecture_before.txt")
TOLERANCE = 0.1

# Members that stand for their family in "files that name a member": what the code calls them.
KINDS = {"pair_distance": {"pair_distance", "PairDistance"}, "contact": {"contact", "Contact"}}
LANGUAGES = {"structured text": {"structured_text", "StructuredText"}}


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
        "effect": classes(house, "effects", "Effect") | defined(house),
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


# Ways of a parameter: module, function, parameter.
WAYS = (
    ("diagnosis.diagnose", "diagnose", "robot"),
    ("identification.identification", "identify", "robot"),
    ("project.calibration", "calibrate", "problem"),
)


def further(house: House) -> dict[str, str]:
    """What is measured beside the page: ways of parameters, callers, public names, commands, tests, long functions."""
    found = {}
    for module, function, parameter in WAYS:
        way = Walk(house).follow(module, function, parameter)
        value = f"{way.stations} stations, {way.climbs} climbs, {len(way.names)} names"
        found[f"`{parameter}` in {function}"] = value
    for function in ("diagnose", "identify"):
        found[f"places that call {function}"] = str(len(callers(house, function)))
    page = (house.folder.parent / "docs" / "reference.md").read_text(encoding="utf-8")
    found["public names"] = str(len(re.findall(r"^   casadical\.\S+$", page, re.MULTILINE)))
    every = [n for m in house.modules.values() for n in m.nodes]
    cli = [n for m in house.modules.values() if m.room == "cli" for n in m.nodes]
    loops = [len(n.iter.elts) - 1 for n in cli if isinstance(n, ast.For) and _registered(n)]
    found["commands"] = str(sum(loops) + sum(_registers(n) for n in cli))
    tests = [p.read_text(encoding="utf-8") for p in house.folder.parent.joinpath("tests").rglob("*.py")]
    found["lines of tests"] = str(sum(len(text.splitlines()) for text in tests))
    found["private names that tests import"] = str(sum(map(_private_imports, tests)))
    found["patches of the package in tests"] = str(sum(_patches(text, house.folder.name) for text in tests))
    calls = [getattr(n.func, "id", getattr(n.func, "attr", "")) for n in every if isinstance(n, ast.Call)]
    found["factorisations by Cholesky"] = str(calls.count("cholesky"))
    found["places that read instructions of SX"] = str(calls.count("n_instructions"))
    made = [n.id for n in every if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
    made += [n.name.lstrip("_") for n in every if _is_function(n)]
    found["names that are idioms"] = ", ".join(f"{word} {made.count(word)}" for word in IDIOMS)
    written = [n for n in every if isinstance(n, ast.Subscript) and isinstance(n.ctx, ast.Store)]
    found["writes into `__dict__`"] = str(sum(getattr(n.value, "attr", "") == "__dict__" for n in written))
    sizes = {f"{m.name}.{n.name}": _code_lines(n) for m in house.modules.values() for n in m.nodes if _is_function(n)}
    longest = sorted(sizes, key=lambda name: -sizes[name])[:3]
    found["functions above 60 lines of code"] = str(sum(size > 60 for size in sizes.values()))
    return found | {"longest functions": ", ".join(f"{name} {sizes[name]}" for name in longest)}


# Names of variables and functions that say nothing of the thing.
IDIOMS = ("of", "found", "told", "instead", "left_open", "misnamed", "as_it_is")


def _private_imports(text: str) -> int:
    imports = (n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.ImportFrom) and n.module)
    names = [a.name for n in imports if n.module.startswith("casadical") for a in n.names]
    return sum(name.startswith("_") and not name.endswith("_") for name in names)


def _patches(text: str, package: str) -> int:
    """Calls of `monkeypatch.setattr` on what is imported from the package, or on a name in it."""
    tree = ast.parse(text)
    imports = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and (n.module or "").startswith(package)]
    own = {a.asname or a.name for n in imports for a in n.names} | {package, "import_module"}
    calls = (n for n in ast.walk(tree) if isinstance(n, ast.Call) and getattr(n.func, "attr", "") == "setattr")
    return sum(re.split(r"[.(]", ast.unparse(n.args[0]).strip("'"))[0] in own for n in calls if n.args)


def _is_function(node: ast.AST) -> bool:
    return isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)


def _registers(node: ast.AST) -> bool:
    """Whether it is a call of a Typer's `command`."""
    return isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "command"


def _registered(node: ast.For) -> bool:
    return any(map(_registers, ast.walk(node)))


def _code_lines(node: ast.FunctionDef) -> int:
    """Of a function, without its docstring."""
    first = node.body[0]
    doc = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
    return node.end_lineno - node.lineno + 1 - doc * (first.end_lineno - first.lineno + 1)


def _range(counts: list[int]) -> str:
    low, middle, high = min(counts), median(counts), max(counts)
    return str(low) if low == high else f"{middle:.0f} ({low} to {high})"


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
        house = House(options.figures)
        print("\n".join(f"{name:42}  {value}" for name, value in (figures(house) | further(house)).items()))
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

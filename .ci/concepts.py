"""The ratchet: count what a reader of the package has to carry, and compare with the committed `.ci/concepts.json`.

python .ci/concepts.py            prints the figures; ends in 1 where one is above the committed one
python .ci/concepts.py --write    lowers the committed figures to those of now
python .ci/concepts.py --raise    raises them, too

Raising a figure needs a commit whose body says what the new thing replaces, and why nothing that was there could carry
it; a commit that raises one and has no body is an error here.
"""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
COMMITTED = ".ci/concepts.json"


def git(*command: str) -> str:
    command = ("git", "-c", "safe.directory=*", *command)
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout


def texts(*patterns: str) -> dict[Path, str]:
    """Return the text of every tracked file that matches a pattern of git."""
    paths = (ROOT / name for name in git("ls-files", "-z", *patterns).split("\0") if name)
    return {path: path.read_text(encoding="utf-8") for path in paths if path.is_file()}


def assignments(tree: ast.Module) -> list[list[str]]:
    """Return the constants in capitals of each statement at the level of the module."""
    found = []
    for node in (n for n in tree.body if isinstance(n, ast.Assign | ast.AnnAssign)):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        names = [n.id for t in targets for n in getattr(t, "elts", [t]) if isinstance(n, ast.Name)]
        found.append([name for name in names if name.isupper()])
    return [names for names in found if names]


def is_dataclass(node: ast.ClassDef) -> bool:
    return any("dataclass" in ast.unparse(decorator) for decorator in node.decorator_list)


def public_without_docstring(tree: ast.Module) -> int:
    """Return the number of public functions, and public methods of public classes, without a docstring."""
    bodies = [tree.body, *(n.body for n in tree.body if isinstance(n, ast.ClassDef) and not n.name.startswith("_"))]
    functions = (n for body in bodies for n in body if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef))
    functions = (f for f in functions if "overload" not in map(ast.unparse, f.decorator_list))
    return sum(not f.name.startswith("_") and not ast.get_docstring(f) for f in functions)


def figures() -> dict[str, int]:
    """Return every count by its name; each may fall and not rise."""
    sources = texts("casadical/*.py")
    trees = [ast.parse(source) for source in sources.values()]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    functions = [n for n in nodes if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    classes = [n for n in nodes if isinstance(n, ast.ClassDef)]
    words = Counter(re.findall(r"\w+", "\n".join(sources.values())))
    small = [
        f
        for f in functions
        if f.name.startswith("_") and not f.name.startswith("__")
        and f.end_lineno - f.lineno < 10 and words[f.name] == 2
    ]  # fmt: skip
    statements = [names for tree in trees for names in assignments(tree)]
    constants = [name for names in statements for name in names]
    modules = Counter(name for tree in trees for name in {n for names in assignments(tree) for n in names})
    lines = [line for source in sources.values() for line in source.splitlines()]
    tests, studies = texts("tests/*.py"), texts("docs/studies/*.py")
    pages = texts("docs/*.md", "README.md", ":!docs/studies")
    return {
        "package lines": len(lines),
        "lines over 100 characters": sum(len(line) > 100 for line in lines),
        "fmt: skip": sum("fmt: skip" in line for line in lines),
        "functions": len(functions),
        "private functions of ten lines at most, used once": len(small),
        "public functions without a docstring": sum(map(public_without_docstring, trees)),
        "classes": len(classes),
        "dataclasses": sum(map(is_dataclass, classes)),
        "module constants": len(constants),
        "module constants of one word": sum("_" not in name and len(name) > 2 for name in constants),
        "statements that assign several constants": sum(len(names) > 1 for names in statements),
        "constants' names in more than three modules": sum(count > 3 for count in modules.values()),
        "test lines": sum(len(text.splitlines()) for text in tests.values()),
        "study lines": sum(len(text.splitlines()) for text in studies.values()),
        "words of docs and README": sum(len(text.split()) for text in pages.values()),
    }


def raised_without_reason() -> list[str]:
    """Return the commits that raised a committed figure and say nothing in their body."""
    found, later = [], None
    for line in git("log", "--first-parent", "--format=%H", "--", COMMITTED).split():
        held = json.loads(git("show", f"{line}:{COMMITTED}"))
        if later and any(value > held.get(name, value) for name, value in later[1].items()):
            subject, _, body = git("log", "-1", "--format=%B", later[0]).partition("\n")
            found += [f"{later[0][:8]} {subject}"] if not body.strip() else []
        later = (line, held)
    return found


def main() -> int:
    """Print figures and faults and return the exit code."""
    path = ROOT / COMMITTED
    now, held = figures(), json.loads(path.read_text(encoding="utf-8"))
    if {"--write", "--raise"} & {*sys.argv}:
        lower = {name: min(value, held.get(name, value)) for name, value in now.items()}
        path.write_text(json.dumps(now if "--raise" in sys.argv else lower, indent=4) + "\n", encoding="utf-8")
        held = json.loads(path.read_text(encoding="utf-8"))
    for name, value in now.items():
        change = value - held.get(name, -1)
        print(f"{name:52s} {value:8,}  {f'{change:+,}' if change else ''}".rstrip())
    above = [name for name, value in now.items() if value > held.get(name, -1)]
    if above:
        print(f"above {COMMITTED}: {', '.join(above)}. Let what is there carry it; or: python .ci/concepts.py --raise")
        print("in a commit whose body says what the new thing replaces and why nothing that was there could carry it")
    elif now != held:
        print(f"below {COMMITTED}: python .ci/concepts.py --write keeps the gain")
    unexplained = raised_without_reason()
    if unexplained:
        print("figures raised by a commit without a body:", *unexplained, sep="\n    ")
    return int(bool(above or unexplained))


if __name__ == "__main__":
    sys.exit(main())

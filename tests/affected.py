"""Which tests a change touches: python tests/affected.py [--above] [SINCE] | xargs python -m pytest -n auto

Prints, one a line, the tests of the files that differ from the commit SINCE (main): the tests with the name of
a file's folder in the package, a test itself, and always tests/house. With --above also the tests of the rooms that
import a changed room. What is shared by all tests touches all.
"""

import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[1]
OTHER = {
    "docs": ("docs",),
    "README.md": ("docs",),
    "problems": ("project", "cli", "docs"),
    "data": ("project", "cli", "diagnosis", "blind_check"),
}


def changed(since: str) -> list[str]:
    """Paths that differ from a commit, new ones included."""
    out = []
    for command in (("diff", "--name-only", since), ("ls-files", "--others", "--exclude-standard")):
        out.append(subprocess.run(["git", *command], cwd=ROOT, capture_output=True, text=True, check=True).stdout)
    return "".join(out).split()


def importers(room: str) -> list[str]:
    """Rooms of the package with a module that imports this one."""
    line = re.compile(rf"^ *(?:from|import) casadical\.{room}\b", re.MULTILINE)  # examples in docstrings do not count
    files = (p for p in (ROOT / "casadical").rglob("*.py") if line.search(p.read_text(encoding="utf-8")))
    return sorted({p.relative_to(ROOT / "casadical").parts[0] for p in files} - {room, "__init__.py"})


def own_tests(path: str, *, above: bool = False) -> list[str]:
    """Folders and files of tests that a changed file touches."""
    top, *rest = Path(path).parts
    folder = ROOT / "tests" / Path(*rest).parent if rest else ROOT
    if top == "casadical" and len(rest) > 1:
        while not folder.is_dir():
            folder = folder.parent
        more = [f"tests/{room}" for room in importers(rest[0])] if above else []
        return [str(folder.relative_to(ROOT)), *more]
    if top == "tests" and rest[0] == "numpy_physics":  # the oracle of the engine, and the robots of many campaigns
        return ["tests/blind_check", "tests/diagnosis"]
    if top == "tests" and len(rest) > 1:
        return [path if Path(path).match("test_*.py") else str(folder.relative_to(ROOT))]
    if top in ("tests", "pyproject.toml", "casadical"):
        return ["tests"]
    return [f"tests/{name}" for name in OTHER.get(top, ())]


def affected(paths: Iterable[str], *, above: bool = False) -> list[str]:
    """Tests that these changes touch, nothing twice and nothing that is not there."""
    found = {"tests/house", *(test for path in paths for test in own_tests(path, above=above))}
    found = {test for test in found if (ROOT / test).exists()}
    return sorted(test for test in found if not any(str(parent) in found for parent in Path(test).parents))


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if word != "--above"]
    print("\n".join(affected(changed(words[0] if words else "main"), above="--above" in sys.argv)))

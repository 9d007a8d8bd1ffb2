"""What lies at the top, what no file may name, and what every module says of itself."""

import ast
import gzip
import lzma
import re
from pathlib import Path

from repository import ROOT, tracked

TOP = {
    *("pyproject.toml", "casadical", "problems", "tests", "data", "docs"),
    *("README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff"),
}

# In pieces, so that this file does not hold what it looks for.
HOSTS = [
    "pypi" + ".org", "python" + "hosted.org", "registry" + ".npmjs", "deb" + ".debian.org", "crates" + ".io",
    "proxy" + ".golang", "repo" + ".maven", "index" + "-url",
]  # fmt: skip
MACHINE_PATH = re.compile(r"(?<![\w.])/(?:" + "|".join(["wor" + "k", "ro" + "ot", "ho" + "me", "User" + "s"]) + r")/\w")


def test_the_top_level_is_as_agreed() -> None:
    names = {path.parts[0] for path in tracked()}
    assert {name for name in names if not name.startswith(".")} == TOP


def named_in(path: Path) -> list[str]:
    """Registries and paths of a machine that a file names."""
    raw = (ROOT / path).read_bytes()
    damaged = "replace" if path.parent.name == "found" else "strict"  # of tests/fuzz, where some are no text
    text = {".xz": lzma.decompress, ".gz": gzip.decompress}.get(path.suffix, bytes)(raw).decode("utf-8", damaged)
    machine = MACHINE_PATH.search(text)
    return [host for host in HOSTS if host in text] + ([machine[0]] if machine else [])


def test_no_file_names_a_machine_or_a_registry() -> None:
    files = [path for path in tracked() if path.suffix not in (".csv", ".png")]
    assert len(files) > 900
    assert {str(path): named for path in files if (named := named_in(path))} == {}


def test_every_module_says_what_it_is() -> None:
    modules = [path for path in tracked() if path.parts[0] == "casadical" and path.suffix == ".py"]
    assert len(modules) > 300
    assert [
        str(path) for path in modules if not ast.get_docstring(ast.parse((ROOT / path).read_text(encoding="utf-8")))
    ] == []


def test_the_wheel_carries_the_types_marker() -> None:
    assert (ROOT / "casadical" / "py.typed").exists()


def test_the_tests_mirror_the_package() -> None:
    """A folder of tests is named as the folder of the package that it tests; every room has one."""
    house_and_docs = {"house", "docs", "fuzz"}
    folders = {path.parent for path in tracked() if path.parts[0] == "tests" and path.name.startswith("test_")}
    names = {folder.relative_to("tests") for folder in folders}
    assert names.isdisjoint({Path()}), "a test lies in no room's folder"
    package = ROOT / "casadical"
    assert [n for n in sorted(names) if n.parts[0] not in house_and_docs and not (package / n).is_dir()] == []
    rooms = {path.parts[1] for path in tracked() if path.parts[0] == "casadical" and len(path.parts) > 2}
    assert rooms - {name.parts[0] for name in names} == set()


# Outside of core/reading.py: what the package installs or makes itself, and what reads as it goes.
OWN_FILES = {
    "core/files.py": "writes them",
    "core/compile_cache.py": "libraries of the private cache",
    "core/lazy.py": "a stub of the package",
    "core/version.py": "the package's own version",
    "core/telling/page.py": "templates of the package",
    "diagnosis/formula_cache.py": "the package's own code, for its hash",
    "measurements/vocabulary.py": "a list of the package",
    "measurements/table_parts.py": "reads regular files of any size in parts",
    "export/c/emit.py": "templates of the package",
    "project/live/server.py": "the package's own page",
    "cli/terminal.py": "the null device",
}
READS = {"read_text", "read_bytes", "open", "parse", "read_csv", "read_excel", "ParquetFile"}
OF_TEXTS = {"pd.read_csv", "ast.parse", "tomlkit.parse"}


def reads_in(path: Path) -> list[str]:
    """Calls that open a file past the gate of core/reading.py."""
    calls = [n for n in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))) if isinstance(n, ast.Call)]
    named = [c.func.id for c in calls if isinstance(c.func, ast.Name) and c.func.id == "open"]
    methods = [ast.unparse(c.func) for c in calls if isinstance(c.func, ast.Attribute) and c.func.attr in READS]
    return named + [name for name in methods if name not in OF_TEXTS]


def test_every_file_is_opened_by_the_gate() -> None:
    modules = [p for p in tracked() if p.parts[0] == "casadical" and p.suffix == ".py"]
    found = {str(p.relative_to("casadical")): reads for p in modules if (reads := reads_in(p))}
    found.pop("core/reading.py")
    assert found.keys() == OWN_FILES.keys() & found.keys(), {k: v for k, v in found.items() if k not in OWN_FILES}

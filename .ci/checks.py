"""Check what the repository says of itself: python .ci/checks.py prints every fault and ends in 1 if there is one.

A reference is dead if what it names does not exist: a file or a link in a page, a name of the package between
backticks in a page, a docstring or a comment, a command or an option of the command line. The other checks are on the
layout of the repository, on files that are opened past the checked reader, and on ties that rounding would decide.
Counts that may fall but not rise are compared by `.ci/concepts.py`.
"""

from __future__ import annotations

import ast
import gzip
import importlib.util
import lzma
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
# Entries at the top of the repository that may be tracked; hidden ones are free.
TOP_ENTRIES = {
    *("casadical", "data", "docs", "problems", "tests", "pyproject.toml"),
    *("README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff"),
}
# Options of other programs that pages name.
FOREIGN_OPTIONS = {
    *("--dist", "--help", "--keep-going", "--version", "--rm", "--user", "--memory", "--durations"),
    *("--install-completion", "--show-completion"),
    *("--qx", "--qy", "--qz", "--qw", "--frame-id", "--child-frame-id"),  # static_transform_publisher of ROS 2
}
# Names of other programs and of data that are described, not used.
FOREIGN_NAMES = {
    *("PDispOn", "kinematics_params_file", "DelayedPDActuatorCfg", "figure.write_html"),
    "ur_description",
    *("joint1_rpy", "voltage_V", "kernel.units"),  # composed of a name and a number or unit; of generated code
    *("goal_x_m", "goal_yaw_rad", "current1_abs", "current6_abs"),
}
FILE_ENDINGS = (".toml", ".json", ".txt", ".py", ".md", ".csv", ".parquet", ".xml")
# In pieces, so that this file does not contain what it searches for.
REGISTRY_HOSTS = [
    "pypi" + ".org",
    "python" + "hosted.org",
    "registry" + ".npmjs",
    "deb" + ".debian.org",
    "crates" + ".io",
    "proxy" + ".golang",
    "repo" + ".maven",
    "index" + "-url",
]
MACHINE_PATH = re.compile(r"(?<![\w.])/(?:" + "|".join(["wor" + "k", "ro" + "ot", "ho" + "me", "User" + "s"]) + r")/\w")
# Modules that may open files without core/reading.py, and why.
OWN_FILES = {
    "core/files.py": "writes the files",
    "core/mapped_function.py": "libraries of the private cache",
    "core/lazy.py": "a stub of the package",
    "core/reporting/page.py": "templates of the package",
    "core/reporting/template.py": "templates of the package",
    "diagnosis/formula_cache.py": "the package's own code, for its hash",
    "measurements/raw_table.py": "Parquet of bytes that core/reading.py has read",
    "measurements/vocabulary.py": "a list of the package",
    "export/c/c_source.py": "templates of the package",
    "project/acceptance/certificate.py": "words of the package",
    "project/live/server.py": "the package's own page",
    "cli/terminal.py": "the null device",
}


def tracked(*patterns: str) -> list[Path]:
    """Return the tracked files that match the patterns of git, relative to the root."""
    command = ["git", "-c", "safe.directory=*", "ls-files", "-z", *patterns]
    listed = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return [Path(name) for name in listed.split("\0") if name and (ROOT / name).exists()]


@cache
def text_of(path: Path) -> str:
    return (ROOT / path).read_text(encoding="utf-8")


@cache
def nodes_of(path: Path) -> list[ast.AST]:
    """Return the syntax tree of a Python file as a list, the module first."""
    return list(ast.walk(ast.parse(text_of(path))))


class Package:
    """Names that the package defines: per module, per class, and every word that its code contains."""

    def __init__(self) -> None:
        self.names: dict[str, set[str]] = defaultdict(set)
        self.members: dict[str, set[str]] = defaultdict(set)
        self.bases: dict[str, set[str]] = defaultdict(set)
        for path in tracked("casadical/*.py", "casadical/*.pyi"):
            parts = path.with_suffix("").parts
            module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            self._read(module, nodes_of(path))
            for k in range(1, len(parts)):  # a folder has its modules as names
                self.names[".".join(parts[:k])].add(parts[k])

    def _read(self, module: str, nodes: list[ast.AST]) -> None:
        self.names[module] |= set(_bound(nodes[0].body))
        for node in nodes:
            if isinstance(node, ast.ClassDef):
                self.members[node.name] |= set(_bound(node.body)) | {
                    n.attr for n in ast.walk(node) if isinstance(n, ast.Attribute) and isinstance(n.ctx, ast.Store)
                }
                self.bases[node.name] |= {ast.unparse(base).rpartition(".")[2] for base in node.bases}

    def has_member(self, owner: str, name: str) -> bool:
        """Return whether a class of this name, or a base of it that is not ours, may have the member."""
        known = name in self.members[owner] or name.startswith("__")
        return known or any(b not in self.members or self.has_member(b, name) for b in self.bases[owner] if b != owner)

    def exists(self, reference: str) -> bool:
        """Return whether `a.b` may be a name of the package; True where `a` is none that it defines."""
        parts = reference.split(".")
        if parts[0] == "casadical":
            return self._in_module("casadical", parts[1:]) or self.exists(".".join(parts[1:]))
        modules = [m for m in self.names if f".{m}".endswith(f".{parts[0]}")]
        owners = [c for c in self.members if c == parts[0]]
        if len(parts) == 1 or (not modules and not owners):
            return bool(modules or owners or len(parts) > 1)
        # `robot.base` or `log.runs()` of a page may be a variable that is named after its class.
        variable = parts[0].replace("_", "")
        owners += [c for c in self.members if c.lower().endswith(variable) or variable == "result"]
        if any(self.has_member(owner, parts[1]) for owner in owners):
            return True
        return any(self._in_module(module, parts[1:]) for module in modules)

    def _in_module(self, module: str, parts: list[str]) -> bool:
        if not parts:
            return True
        if f"{module}.{parts[0]}" in self.names:
            return self._in_module(f"{module}.{parts[0]}", parts[1:])
        known = parts[0] in self.names[module]
        return known and (len(parts) == 1 or parts[0] not in self.members or self.has_member(parts[0], parts[1]))


def _bound(body: Iterable[ast.stmt]) -> Iterator[str]:
    """Yield the names that statements bind, those under `if` and `try` and imports included."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Import | ast.ImportFrom):
            yield from ((alias.asname or alias.name).partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.If | ast.Try | ast.With):
            yield from _bound(node.body + getattr(node, "orelse", []))
        else:
            yield from (n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store))


def words_of_code(paths: Iterable[Path]) -> set[str]:
    """Return every identifier and every word of a string, docstrings and comments left out."""
    words: set[str] = set()
    for path in paths:
        if path.suffix not in (".py", ".pyi"):
            words.update(re.findall(r"\w+", text_of(path)))
            continue
        nodes = nodes_of(path)
        docstrings = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        for node in nodes:
            match node:
                case ast.Name():
                    words.add(node.id)
                case ast.Attribute():
                    words.add(node.attr)
                case ast.arg() | ast.keyword():
                    words.add(node.arg or "")
                case ast.FunctionDef() | ast.ClassDef():
                    words.add(node.name)
                case ast.alias():
                    words.update(node.name.split("."))
                case ast.Constant(value=str(text)) if id(node) not in docstrings:
                    words.add(text)
                    words.update(re.findall(r"\w+", text))
    return words


def composed(name: str, words: set[str]) -> bool:
    """Return whether code may compose the name of parts that it contains: `q2_m`, `std_rz`, `rest_once_urad`."""
    if all(part in words for part in re.split(r"\d+", name) if part not in ("", "_")):
        return True
    cuts = [k for k, letter in enumerate(name) if letter == "_"]
    two = ({name[: k + 1], name[k + 1 :]} <= words or {name[:k], name[k:]} <= words for k in cuts)
    return any(two) or any({name[: i + 1], name[i + 1 : j], name[j:]} <= words for i in cuts for j in cuts if i < j)


def pages() -> list[Path]:
    """Return the pages that speak of the present; the changelog speaks of the past."""
    return tracked("README.md", "docs/*.md", ".github/*.md", "problems/*.md", "data/*.md")


def anchors(page: Path) -> set[str]:
    """Return the anchors that a code host gives to the headings of a page."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    kept = (re.sub(r"[^\w\- ]", "", re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", h).lower()) for h in headings)
    return {heading.strip().replace(" ", "-") for heading in kept} | set(re.findall(r"^\(([\w-]+)\)=$", text, re.M))


def dead_links() -> Iterator[str]:
    """Yield links of pages and paths between backticks that lead nowhere."""
    for path in tracked("*.md"):
        for link in re.findall(r"\]\(([^)\s]+)\)", text_of(path)):
            target, _, anchor = link.partition("#")
            if re.match(r"[a-z]+:", link):
                continue
            file = (ROOT / path.parent / target) if target else ROOT / path
            if not file.exists() or (anchor and file.suffix == ".md" and anchor not in anchors(file)):
                yield f"{path}: link to {link}"
    for path in (path for path in pages() if path.parts[0] != "data"):
        for file, name in re.findall(r"`([\w/]+/\w+\.py):?([\w.]*)`", text_of(path)):
            defines = re.compile(rf"^ *(?:def|class) {name.rpartition('.')[2]}\b", re.MULTILINE)
            if not any(not name or defines.search(text_of(p)) for p in tracked(f"*/{file}", file)):
                yield f"{path}: `{file}:{name}`"
    listed = {str(path) for path in tracked()} | {str(p) for path in tracked() for p in path.parents}
    names = {Path(name).name for name in listed}
    for path in [*pages(), *tracked("*.py")]:
        text = text_of(path)
        for named in re.findall(r"`((?:docs|data|problems|casadical|tests|\.ci)/[\w./-]*\w)/?`", text):
            if named not in listed and not named.endswith(("NAME.py", "X.csv")):
                yield f"{path}: `{named}`"
        for named in re.findall(r"`(?:casadical/[\w/]+/)?(\w+\.py)\b", text) if path.parts[0] != "tests" else ():
            if named not in names and not re.search(rf"file: {named}|{named}`? of your|import {named[:-3]}", text):
                yield f"{path}: `{named}`"


def dead_names() -> Iterator[str]:
    """Yield names between backticks that neither the package nor another tracked file defines."""
    package = Package()
    ours = [p for p in tracked() if p.parts[0] != "tests" and p.suffix not in (".md", ".png", ".svg", ".gz", ".xz")]
    words = words_of_code(p for p in ours if p.suffix in (".py", ".pyi") or (ROOT / p).stat().st_size < 100_000)
    words |= FOREIGN_NAMES | {part for p in tracked() for part in (*p.parts, p.stem)}
    for path in pages():  # what a page's own examples define
        words |= set(re.findall(r"\w+", " ".join(re.findall(r"```.*?```", text_of(path), re.DOTALL))))
    for path in [*pages(), *tracked("casadical/*.py")]:
        for number, line in enumerate(text_of(path).splitlines(), 1):
            for name in re.findall(r"`+~?([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)(?:\(\))?`", line):
                simple = re.fullmatch(r"[a-z]\w*_\w+|[A-Z]\w*[a-z]\w*[A-Z]\w*", name)
                if simple and not (name in words or composed(name, words)):
                    yield f"{path}:{number}: `{name}`"
                other = name in words or name.endswith(FILE_ENDINGS) or f"JSON `{name}`" in line
                if "." in name and not other and not package.exists(name):
                    yield f"{path}:{number}: `{name}`"


def commands() -> dict[str, set[str]]:
    """Return the options of every command, by its words without `casadical`."""
    import typer

    from casadical.cli import app

    found: dict[str, set[str]] = {}

    def visit(words: tuple[str, ...], command: object) -> None:
        options = {o for p in command.params for o in (*p.opts, *p.secondary_opts) if o.startswith("-")}
        found[" ".join(words)] = options
        for name, below in getattr(command, "commands", {}).items():
            visit((*words, name), below)

    visit((), typer.main.get_command(app))
    return found


def dead_options() -> Iterator[str]:
    """Yield commands and options that pages, docstrings and messages name and the command line does not have."""
    known = commands()
    every = set().union(*known.values()) | FOREIGN_OPTIONS
    for path in tracked("docs/*.py", "tests/*.py", ".ci/*"):
        every |= set(re.findall(r"[\"' ](--[a-z][\w-]+)", text_of(path)))
    for path in [*pages(), *tracked("casadical/*.py")]:
        for number, line in enumerate(text_of(path).splitlines(), 1):
            for option in re.findall(r"(?<![\w-])--[a-z][\w-]*\w", line):
                if option not in every:
                    yield f"{path}:{number}: {option}"
    for path in pages():
        for number, line in enumerate(text_of(path).splitlines(), 1):
            for call in re.findall(r"(?:^ {4,}|^\$ |`|&& )casadical ([a-z][a-z-]*[^`|#]*)", line):
                words = call.split()
                name = next((n for n in (" ".join(words[:2]), words[0]) if n in known), None)
                if name is None:
                    yield f"{path}:{number}: casadical {words[0]}"
                    continue
                # Of a group: those of the command that it stands for, too.
                its_own = set().union(*(options for n, options in known.items() if f"{n} ".startswith(f"{name} ")))
                for option in set(re.findall(r"(?<!\S)\[?(--[a-z][\w-]*\w)", call)) - its_own - FOREIGN_OPTIONS:
                    yield f"{path}:{number}: casadical {name} {option}"


def layout() -> Iterator[str]:
    """Yield faults in the layout of the repository."""
    files = tracked()
    for name in {path.parts[0] for path in files} - TOP_ENTRIES:
        if not name.startswith("."):
            yield f"{name}: not agreed at the top of the repository"
    for path in files:
        if path.suffix not in (".csv", ".png"):
            unpack = {".xz": lzma.decompress, ".gz": gzip.decompress}.get(path.suffix, bytes)
            text = unpack((ROOT / path).read_bytes()).decode("utf-8", "replace")
            named = [host for host in REGISTRY_HOSTS if host in text]
            for what in named + [m[0] for m in MACHINE_PATH.finditer(text)][:1]:
                yield f"{path}: names a registry or a machine's path: {what}"
    for path in tracked("casadical/*.py"):
        if not ast.get_docstring(nodes_of(path)[0]):
            yield f"{path}: no docstring of the module"
    tests = [path for path in tracked("tests/*.py") if path.stem != "conftest"]
    stems = [path.stem for path in tests]
    for path in tests:
        if path.stem != "__init__" and stems.count(path.stem) > 1:
            yield f"{path}: another module of the tests has this name; all are on one path"
        folder = path.parent.relative_to("tests")
        mirrors = folder.parts and (ROOT / "casadical" / folder).is_dir()
        if path.name.startswith("test_") and not mirrors and folder.parts[:1] not in (("house",), ("docs",), ("fuzz",)):
            yield f"{path}: lies in no folder with the name of one of the package"
    tested = {path.parts[1] for path in tests}
    for room in {path.parts[1] for path in tracked("casadical/*.py") if len(path.parts) > 2} - tested:
        yield f"casadical/{room}: has no tests"


def files_opened() -> Iterator[str]:
    """Yield calls that open a file of a user past core/reading.py, which checks size, encoding and kind."""
    opens = {"read_text", "read_bytes", "open", "parse", "read_csv", "read_excel", "ParquetFile"}
    for path in tracked("casadical/*.py"):
        if str(path.relative_to("casadical")) in {"core/reading.py", *OWN_FILES}:
            continue
        for call in (n for n in nodes_of(path) if isinstance(n, ast.Call)):
            name = ast.unparse(call.func)
            method = isinstance(call.func, ast.Attribute) and call.func.attr in opens
            if name == "open" or (method and name not in {"pd.read_csv", "ast.parse", "tomlkit.parse", "os.open"}):
                yield f"{path}:{call.lineno}: {name} opens a file past core/reading.py"


def ties() -> Iterator[str]:
    """Yield choices of a best one whose ties are decided by rounding, hence by the processor."""
    for path in tracked(
        "casadical/diagnosis/*.py", "casadical/fleet/*.py", "casadical/identification/pose_selection/*.py"
    ):
        for call in (n for n in nodes_of(path) if isinstance(n, ast.Call)):
            name = ast.unparse(call.func)
            key = next((ast.unparse(k.value) for k in call.keywords if k.arg == "key"), "len")
            masks = any(isinstance(argument, ast.Compare) for argument in call.args)
            if (name.endswith(".argmax") and not masks) or (name in ("max", "min") and key != "len"):
                yield f"{path}:{call.lineno}: rounding decides among ties: take first_of_best or best_of"


def errors_untold() -> Iterator[str]:
    """Yield public functions that raise an error of the package and do not say so in their docstring.

    A command's docstring is its help; a method without a docstring overrides one that tells it.
    """
    ours = {"InputError", "ConvergenceError", "CasadicalError"}
    for path in (path for path in tracked("casadical/*.py") if path.parts[1] != "cli"):
        for function in (n for n in nodes_of(path) if isinstance(n, ast.FunctionDef) and not n.name.startswith("_")):
            raises = (n.exc for n in ast.walk(function) if isinstance(n, ast.Raise) and isinstance(n.exc, ast.Call))
            told = "Raises" in (ast.get_docstring(function) or "Raises")
            if not told and {ast.unparse(call.func) for call in raises} & ours:
                yield f"{path}:{function.lineno}: {function.name} raises an error; its docstring says no `Raises ...`"


CHECKS = (dead_links, dead_names, dead_options, layout, files_opened, ties, errors_untold)


def main() -> int:
    """Print the faults of all checks and return the exit code."""
    sys.path.insert(0, str(ROOT))
    if importlib.util.find_spec("typer") is None:
        sys.exit("checks.py needs the environment of the tests: pip install -e '.[dev]'")
    faults = {check.__name__: list(check()) for check in CHECKS}
    for name, found in faults.items():
        for fault in found:
            print(f"{name.replace('_', ' ')}: {fault}")
    return int(any(faults.values()))


if __name__ == "__main__":
    sys.exit(main())

"""docs/reference.md: its names are those at the top and below, what their sections say is true, their examples run."""

import ast
import doctest
import enum
import importlib
import importlib.util
import inspect
import re
import shutil
import textwrap
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path

import pytest
from walk import ROOT, blocks

from casadical import InputError

PAGE = ROOT / "docs" / "reference.md"
SECTION = re.compile(r"^(\w[\w ]*)\n-{4,}\n(.*?)(?=\n\w[\w ]*\n-{4,}\n|\Z)", re.MULTILINE | re.DOTALL)
AT_MOST = 80  # names that a user must know and we must keep
OURS = {"InputError", "ConvergenceError", "CasadicalError"}
COMPARED = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
# What an example needs that the base install has not, by the beginning of its name.
NEEDS = {
    "casadical.export.load": "gcc",
    "casadical.blind_check.mujoco_physics": "mujoco",
    "casadical.blind_check": "mujoco",
    "casadical.export.replay_campaign": "mujoco",
    "casadical.Fleet": "distributed",
    "casadical.run_fleet": "distributed",
    "casadical.plot": "plotly",
    "casadical.report": "plotly",
    "casadical.read_urdf": "yourdfpy",
}


def named(name: str) -> object:
    """What stands behind a name of the page."""
    package, _, last = name.rpartition(".")
    thing = getattr(importlib.import_module(package), last)
    if inspect.ismodule(thing):  # a function in a module of its own name
        thing = getattr(thing, last)
    return inspect.unwrap(thing)


@cache
def documented() -> dict[str, object]:
    """Every function and class of the page."""
    names = re.findall(r"^   (casadical\.\S+)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    return {name: named(name) for name in names}


def methods(name: str, thing: object) -> Iterator[tuple[str, object]]:
    """Public methods of a class by name, properties aside: their summary says what they are."""
    for key, member in vars(thing).items() if inspect.isclass(thing) else ():
        function = getattr(member, "__func__", member)
        if not key.startswith("_") and inspect.isfunction(function):
            yield f"{name}.{key}", inspect.unwrap(function)


@cache
def inside() -> dict[str, object]:
    """Of the blind check's physics and steps, which engine.md and its commands show: their examples run, too."""
    parts = ("mujoco_physics", "generation.make", "prediction.predict", "scoring.score")
    physics = [f"{parts[0]}.{name}" for name in importlib.import_module(f"casadical.blind_check.{parts[0]}").__all__]
    things = {name: named(f"casadical.blind_check.{name}") for name in (*physics, *parts[1:])}
    return {f"casadical.blind_check.{name}": thing for name, thing in things.items() if callable(thing)}


@cache
def everything() -> dict[str, object]:
    whole = {**documented(), **inside()}
    return {**whole, **{n: f for name, thing in whole.items() for n, f in methods(name, thing)}}


@cache
def sections(thing: object) -> dict[str, str]:
    return dict(SECTION.findall((inspect.getdoc(thing) or "") + "\n"))


def arguments(thing: object) -> set[str]:
    if inspect.isclass(thing):
        if issubclass(thing, enum.Enum | Exception):
            return set()
        if is_dataclass(thing) and thing.__dataclass_params__.init:
            return {f.name for f in fields(thing) if f.init}
        thing = vars(thing).get("__init__")
        if thing is None:
            return set()
    return set(inspect.signature(thing).parameters) - {"self", "cls"}


def described(section: str) -> set[str]:
    """Names of the section's entries."""
    named = (
        line.partition(" : ")[0] for line in section.splitlines() if re.match(r"\*{0,2}\w+(, \*{0,2}\w+)* : ", line)
    )
    return {name.lstrip("*") for names in named for name in names.split(", ")}


def raised(thing: object) -> set[str]:
    """Errors of the package that a function raises itself."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(thing)))
    calls = [n.exc.func for n in ast.walk(tree) if isinstance(n, ast.Raise) and isinstance(n.exc, ast.Call)]
    return {getattr(call, "id", "") for call in calls} & OURS


def test_the_page_has_every_public_name_at_the_top() -> None:
    import casadical

    tops = {name.removeprefix("casadical.") for name in documented() if name.count(".") == 1}
    assert tops == set(casadical.__all__)
    assert len(documented()) <= AT_MOST


def test_every_public_name_has_its_reason() -> None:
    rows = re.findall(r"^\| `(\S+)` \| (\S.*) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert [f"casadical.{name}" for name, _ in rows] == list(documented())


def test_every_name_has_an_example() -> None:
    without = [name for name, thing in documented().items() if ">>> " not in sections(thing).get("Examples", "")]
    assert without == ["casadical.export.ProgramLanguage"]  # controllers' programs are its examples


def items(thing: object) -> str:
    """Arguments and fields that are described: in a section, or in lines `name : what it is` before all sections."""
    text = inspect.getdoc(thing) or ""
    return sections(thing).get("Parameters", re.split(r"\n\w[\w ]*\n-{4,}\n", text)[0])


def test_an_argument_that_is_described_exists() -> None:
    strange = {
        name: sorted(described(items(thing)) - arguments(thing) - {*dir(thing), *getattr(thing, "__annotations__", ())})
        for name, thing in everything().items()
    }
    assert {name: names for name, names in strange.items() if names} == {}


def test_every_error_that_it_raises_is_named() -> None:
    functions = {name: thing for name, thing in everything().items() if inspect.isfunction(thing)}
    unsaid = {name: [e for e in raised(f) if e not in str(f.__doc__)] for name, f in functions.items()}
    assert {name: errors for name, errors in unsaid.items() if errors} == {}


def test_faults_of_a_docstring_are_found() -> None:
    def bare(q: float) -> float:
        """Nothing is said of q, and p is no argument.

        Parameters
        ----------
        p : float
            what it is
        """
        if q < 0:
            raise InputError("q")
        return q

    def short(q: float) -> float:
        """Of q.

        p : what it is

        Examples
        --------
        >>> r : 3
        """
        return q

    assert described(items(bare)) - arguments(bare) == described(items(short)) - arguments(short) == {"p"}
    assert raised(bare) == {"InputError"}
    assert described("q : float, shape (3,) [m]\nr, t : int\n    how many\nNo r : s\ns : int\n") == {"q", "r", "t", "s"}


@pytest.fixture(scope="module")
def before(tmp_path_factory) -> tuple[Path, dict[str, object]]:
    """A folder as the page asks for, and what its first lines make: read, identified and diagnosed once."""
    folder = tmp_path_factory.mktemp("reference")
    for name in ("problems", "data"):
        (folder / name).symlink_to(ROOT / name)
    (block,) = [b for b in blocks(PAGE) if b.language == "python"]
    made: dict[str, object] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        exec(block.text, made)
    return folder, made


def lacking(name: str) -> str:
    """The tool that an example needs and that is not here."""
    needed = [tool for begin, tool in NEEDS.items() if name.startswith(begin)]
    there = {tool: shutil.which(tool) or importlib.util.find_spec(tool) for tool in needed}
    return next((tool for tool, found in there.items() if not found), "")


@pytest.mark.parametrize("name", sorted(name for name, thing in everything().items() if ">>> " in str(thing.__doc__)))
def test_the_example_runs(name: str, before: tuple[Path, dict[str, object]], monkeypatch) -> None:
    if tool := lacking(name):
        pytest.skip(f"{tool} is not installed")
    folder, made = before
    monkeypatch.chdir(folder)
    test = doctest.DocTestParser().get_doctest(inspect.getdoc(everything()[name]), dict(made), name, None, 0)
    said: list[str] = []
    doctest.DocTestRunner(optionflags=COMPARED).run(test, out=said.append)
    assert said == []

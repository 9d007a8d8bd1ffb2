"""docs/reference.md: public names, docstrings that say what a caller must know, and examples that run."""

import doctest
import importlib
import importlib.util
import inspect
import re
import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from walk import ROOT, blocks

PAGE = ROOT / "docs" / "reference.md"
SECTION = re.compile(r"^(\w[\w ]*)\n-{4,}\n(.*?)(?=\n\w[\w ]*\n-{4,}\n|\Z)", re.MULTILINE | re.DOTALL)
ARRAY = re.compile(r"\b(?:Array|NDArray|ArrayLike|Vector|ndarray|Buffer)\b")
SHAPE = re.compile(r"shapes? \(|\((?:(?:\w+|\.{3}), ?)*\w*\d?,?\)|see `|see :func|as of `|inverse of `")
UNIT = re.compile(r"\[[^\]]+\]|_mm\b|\bSI\b|boolean|bool|degrees|radians|see `|see :func|as of `")
# Arrays without a unit, as what they hold has none.
UNITLESS = {
    *("casadical.compensator.Layout.layers", "casadical.compensator.Layout.weights"),
    *("casadical.Effect.parts", "casadical.effects.Effect.parts", "casadical.effects.JointErrorCurve.parts"),
}
# What an example needs that the base install has not, by the beginning of its name.
NEEDS = {
    "casadical.export.load": "gcc",
    "casadical.blind_check": "mujoco",
    "casadical.export.replay_campaign": "mujoco",
    "casadical.Fleet": "distributed",
    "casadical.run_fleet": "distributed",
    "casadical.plot": "plotly",
    "casadical.report": "plotly",
    "casadical.read_urdf": "yourdfpy",
}


def named(name: str) -> object:
    """Return what stands behind a name of the page."""
    package, _, last = name.rpartition(".")
    thing = getattr(importlib.import_module(package), last)
    if inspect.ismodule(thing):  # a function in a module of its own name
        thing = getattr(thing, last)
    return inspect.unwrap(thing)


@cache
def documented() -> dict[str, object]:
    """Return every function and class of the page."""
    names = re.findall(r"^   (casadical\.\S+)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    return {name: named(name) for name in names}


@cache
def members() -> dict[str, object]:
    """Return the members of families, public by their line in a registry."""
    registries = {"effects": "effects.registry", "compensator": "compensator.trainers"}
    return {
        f"casadical.{room}.{name}": kind
        for room, registry in registries.items()
        for name, kind in vars(importlib.import_module(f"casadical.{registry}")).items()
        if inspect.isclass(kind)
    }


@cache
def inside() -> dict[str, object]:
    """Return the blind check's physics and steps, whose examples run, too."""
    package = importlib.import_module("casadical.blind_check.mujoco_physics")
    names = [f"mujoco_physics.{name}" for name in package.__all__]
    names += ["generation.make", "prediction.predict", "scoring.score"]
    things = {f"casadical.blind_check.{name}": named(f"casadical.blind_check.{name}") for name in names}
    return {name: thing for name, thing in things.items() if callable(thing)}


def methods(name: str, thing: object) -> Iterator[tuple[str, object]]:
    """Yield the public methods and properties of a class as functions, by name."""
    for key, member in vars(thing).items() if inspect.isclass(thing) else ():
        for attribute in ("func", "fget", "__func__"):
            member = getattr(member, attribute, member)
        if not key.startswith("_") and inspect.isfunction(member):
            yield f"{name}.{key}", inspect.unwrap(member)


def with_methods(things: dict[str, object]) -> dict[str, object]:
    return things | {n: f for name, thing in things.items() for n, f in methods(name, thing)}


def sections(thing: object) -> dict[str, str]:
    return dict(SECTION.findall((inspect.getdoc(thing) or "") + "\n"))


def test_every_name_has_a_docstring_and_an_example() -> None:
    assert [name for name, thing in (documented() | members()).items() if not thing.__doc__] == []
    without = [name for name, thing in documented().items() if ">>> " not in sections(thing).get("Examples", "")]
    assert without == []


def test_shapes_and_units_of_arrays_are_told() -> None:
    things = with_methods(documented() | members())
    noted = {n: vars(t) if inspect.isclass(t) else {"__annotations__": t.__annotations__} for n, t in things.items()}
    arrays = [n for n in things if any(ARRAY.search(str(a)) for a in noted[n].get("__annotations__", {}).values())]
    docs = {name: inspect.getdoc(things[name]) or "" for name in arrays}
    assert len(docs) > 25
    assert [name for name, text in docs.items() if not SHAPE.search(text)] == []
    assert [name for name, text in docs.items() if name not in UNITLESS and not UNIT.search(text)] == []


def lacking(name: str) -> bool:
    """Return whether an example needs a tool that is not here."""
    needed = [tool for begin, tool in NEEDS.items() if name.startswith(begin)]
    return not all(shutil.which(tool) or importlib.util.find_spec(tool) for tool in needed)


@pytest.mark.slow
def test_the_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a folder as the page asks for, after the page's first lines: read, identified and diagnosed once."""
    for name in ("problems", "data"):
        (tmp_path / name).symlink_to(ROOT / name)
    (block,) = [b for b in blocks(PAGE) if b.language == "python"]
    made: dict[str, object] = {}
    monkeypatch.chdir(tmp_path)
    exec(block.text, made)
    things = with_methods(documented() | inside())
    names = sorted(name for name, thing in things.items() if ">>> " in str(thing.__doc__) and not lacking(name))
    assert len(names) > 50
    said: list[str] = []
    for name in names:
        test = doctest.DocTestParser().get_doctest(inspect.getdoc(things[name]), dict(made), name, None, 0)
        doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE).run(test, out=said.append)
    assert said == []

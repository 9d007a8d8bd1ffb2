"""Public names: those of the stubs are found when they are used, and the reference and the pages know them."""

import importlib
import importlib.util
import inspect
import re
from functools import cache

import pytest
from command_line import ROOT

LAZY = sorted(".".join(path.parent.relative_to(ROOT).parts) for path in (ROOT / "casadical").rglob("__init__.pyi"))
PACKAGES = [*LAZY, "casadical.effects"]
# Members of families: public in their package by their line in the registry, and listed on the page from there.
REGISTRIES = {"casadical.effects": "effects.registry", "casadical.compensator": "compensator.trainers"}


@cache
def names_of(*packages: str) -> list[str]:
    return [f"{package}.{name}" for package in packages for name in importlib.import_module(package).__all__]


def thing(name: str) -> object:
    package, _, last = name.rpartition(".")
    return getattr(importlib.import_module(package), last)


@pytest.mark.parametrize("package", LAZY)
def test_every_name_of_a_stub_is_found(package: str) -> None:
    module = importlib.import_module(package)
    assert module.__all__
    for name in module.__all__:
        assert getattr(module, name).__name__ == name
        assert importlib.util.find_spec(f"{package}.{name}") is None, "a module of this name hides it"
    with pytest.raises(AttributeError, match=f"nothing_of_this_name.*{module.__all__[0]}"):
        _ = module.nothing_of_this_name


def test_the_reference_lists_every_public_name() -> None:
    """What may be relied on: a name is listed where it is imported from, or at the top if it stands there too."""
    page = (ROOT / "docs" / "reference.md").read_text()
    listed = re.findall(r"^   (casadical\.\S+)$", page, re.MULTILINE)
    assert len(listed) == len(set(map(thing, listed)))
    names = names_of(*PACKAGES)
    at_top = [thing(name) for name in names if name.count(".") == 1]
    public = {name for name in names if name.count(".") == 1 or not any(thing(name) is t for t in at_top)}
    public = {n for n in public if inspect.isclass(thing(n)) or inspect.isfunction(inspect.unwrap(thing(n)))}
    public -= {f"{p}.{n}" for p, m in REGISTRIES.items() for n in vars(importlib.import_module(f"casadical.{m}"))}
    assert sorted(public - set(listed)) == []
    assert [name for name in listed if name.rpartition(".")[0] in PACKAGES and name not in public] == []
    assert [name for name in REGISTRIES.values() if f".. automodule:: casadical.{name}\n" not in page] == []

"""Public names: those of the packages, found when they are used, and none of them untyped."""

import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest
from repository import ROOT

BIN = Path(sys.executable).parent
LAZY = sorted(".".join(path.parent.relative_to(ROOT).parts) for path in (ROOT / "casadical").rglob("__init__.pyi"))
PACKAGES = [*LAZY, "casadical.compensator", "casadical.effects", "casadical.pose_selection"]
NAMES = [f"{package}.{name}" for package in PACKAGES for name in importlib.import_module(package).__all__]
# Of packages whose page lists a part of their names.
FURTHER = ["casadical.blind_check.mujoco_physics"]
# Pages about the inside of the package, for whoever changes it or runs its blind check: they name modules.
ABOUT_THE_INSIDE = ("linear-gaussian.md", "blind-check.md")
FURTHER_NAMES = [f"{package}.{name}" for package in FURTHER for name in importlib.import_module(package).__all__]
# Members of families: public in their package by their line in the registry, and listed on the page from there.
REGISTRIES = {"casadical.effects": "effects.registry", "casadical.compensator": "compensator.trainers.registry"}
MEMBERS = [
    f"{package}.{name}"
    for package, registry in REGISTRIES.items()
    for name, kind in vars(importlib.import_module(f"casadical.{registry}")).items()
    if isinstance(kind, type)
]


@pytest.mark.parametrize("package", LAZY)
def test_every_name_of_a_stub_is_found(package: str) -> None:
    module = importlib.import_module(package)
    assert module.__all__
    for name in module.__all__:
        assert getattr(module, name).__name__ == name
        assert importlib.util.find_spec(f"{package}.{name}") is None, "a module of this name hides it"
    with pytest.raises(AttributeError, match=f"nothing_of_this_name.*{module.__all__[0]}"):
        _ = module.nothing_of_this_name


def test_types_hold_and_mypy_sees_one_behind_every_name(tmp_path: Path) -> None:
    user = tmp_path / "user.py"
    names = [name for name in NAMES + MEMBERS + FURTHER_NAMES if not inspect.ismodule(thing(name))]
    lines = [f"import {package}" for package in PACKAGES + FURTHER] + [f"reveal_type({name})" for name in names]
    user.write_text("\n".join(lines) + "\n")
    done = subprocess.run([BIN / "mypy", "casadical", user], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    revealed = re.findall(r'note: Revealed type is "(.*)"', done.stdout)
    assert len(revealed) == len(names) > 100
    assert [name for name, seen in zip(names, revealed, strict=True) if seen == "Any"] == []


def test_the_reference_lists_every_public_name() -> None:
    """What may be relied on: a name is listed where it is imported from, or at the top if it stands there too."""
    page = (ROOT / "docs" / "reference.md").read_text()
    listed = re.findall(r"^   (casadical\.\S+)$", page, re.MULTILINE)
    assert len(listed) == len(set(listed))
    assert all(thing(name) for name in listed)
    at_top = [thing(name) for name in NAMES if name.count(".") == 1]
    public = {name for name in NAMES if name.count(".") == 1 or not any(thing(name) is t for t in at_top)}
    public = {
        name for name in public if inspect.isclass(thing(name)) or inspect.isfunction(inspect.unwrap(thing(name)))
    }
    assert sorted(public - set(listed)) == []
    assert [name for name in listed if name.rpartition(".")[0] in PACKAGES and name not in public] == []
    assert [name for name in REGISTRIES.values() if f".. automodule:: casadical.{name}\n" not in page] == []


def thing(name: str) -> object:
    package, _, last = name.rpartition(".")
    return getattr(importlib.import_module(package), last)


def test_the_pages_import_public_names_only() -> None:
    """Those of the README, of the pages, and of the tutorials; a page on the inside imports what it is about."""
    public = {*NAMES, *MEMBERS, *FURTHER_NAMES, *PACKAGES, *FURTHER}
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "tutorials").glob("*.py")]
    imported = set()
    for page in (p for p in pages if p.name not in ABOUT_THE_INSIDE):
        for module, names in re.findall(r"^ *from (casadical[\w.]*) import ([\w, ]+)", page.read_text(), re.MULTILINE):
            imported |= {(page.name, f"{module}.{name.split()[0]}") for name in names.split(",")}
    assert len(imported) > 40
    assert sorted(name for name in imported if name[1] not in public) == []

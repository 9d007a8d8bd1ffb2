"""The script that draws the floor plan finds every import, and the committed page is what it makes."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from walk import ROOT

sys.path.insert(0, str(ROOT / "docs" / "studies"))

import architecture

pytestmark = pytest.mark.slow  # ways are walked in processes of their own

FILES = {
    "__init__.py": '"""Toy."""\n_HOME = {"a": "toy.low.a", "b": "toy.high"}\n__all__ = ["__version__", *_HOME]\n',
    "low/__init__.py": "",
    "low/a.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from toy.middle import m\n",
    "middle/__init__.py": "",
    "middle/m.py": "def f():\n    from ..low import a\n    return a\n",
    "high.py": 'import toy.middle.m\nLAZY = "toy.low.a:name"\nABOUT = "toy is no module, toy.nothing neither"\n',
}


@pytest.fixture(scope="module")
def house():
    """The package, read once."""
    return architecture.House(ROOT / "casadical")


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        path = tmp_path / "toy" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "toy"


def test_hidden_imports_are_arrows(toy: Path) -> None:
    """Under TYPE_CHECKING, inside a function, relative, and as a string."""
    house = architecture.House(toy)
    assert set(house.arrows) == {("low", "middle"), ("middle", "low"), ("high", "middle"), ("high", "low")}
    assert house.circles == [["low.a", "middle.m"]]
    assert house.entries == ["__init__.py", "high.py", "low", "middle"]


def test_names_behind_getattr_are_not_typed(toy: Path) -> None:
    assert architecture.House(toy).typed_names() == (0, 2)
    front = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from toy.low.a import a as a\n"
    (toy / "__init__.py").write_text(front + FILES["__init__.py"])
    assert architecture.House(toy).typed_names() == (1, 2)
    (toy / "__init__.py").write_text('"""Toy."""\n')
    (toy / "__init__.pyi").write_text("from toy.low.a import a as a\nfrom toy.high import b as b\n")
    assert architecture.House(toy).typed_names() == (2, 2)


def test_repeated_blocks_are_counted(toy: Path) -> None:
    block = "".join(f"value_{k} = {k}\n" for k in range(7))
    (toy / "low" / "a.py").write_text(block)
    (toy / "middle" / "m.py").write_text("first = 0\n" + block)
    assert architecture.repeated_lines(architecture.House(toy)) == 14


CALLS = {
    "low/a.py": """
class Kept:
    def __init__(self, robot): ...
    def moved(self): return 1
def turned(arm): return arm
def checked(arm, kept: Kept): return kept.moved()
""",
    "high.py": """
from toy.low.a import Kept, checked, turned
def ask(robot, free):
    turn = turned(robot.base)
    kept = Kept(turn)
    checked(turn, kept)
    own(arm=robot)
    return later(kept, free)
def own(arm): return arm.values
def later(kept, free): return turned(kept)
def turned_again(): return turned(1), turned(2)
""",
}


def test_a_parameter_is_followed_until_it_is_put_into_an_object(toy: Path) -> None:
    for name, text in CALLS.items():
        (toy / name).write_text(text)
    house = architecture.House(toy)
    way = architecture.Walk(house).follow("high", "ask", "robot")
    assert way.entries == ["high", "low.a", "low.a", "high"]  # ask, turned, checked, own
    assert (way.stations, way.climbs, way.names) == (3, 1, {"robot", "turn", "arm"})
    assert architecture.callers(house, "turned") == ["high:10", "high:11", "high:11", "high:4"]
    assert architecture.callers(house, "own") == []  # its own module's


def test_imports_agree_with_import_linters_graph(house) -> None:
    """An independent reader: grimp, on which import-linter stands. It does not follow names in strings."""
    grimp = pytest.importorskip("grimp")
    graph = grimp.build_graph("casadical", cache_dir=None)
    assert len(graph.modules) > 0.9 * len(house.imports)
    for name in house.imports:
        if f"casadical.{name}" not in graph.modules:
            continue  # in a folder without __init__.py
        theirs = graph.find_modules_directly_imported_by(f"casadical.{name}") - {"casadical"}
        assert {t.partition(".")[2] for t in theirs} <= house.imports[name], name


def test_the_committed_page_is_up_to_date(house) -> None:
    """If not: python docs/studies/architecture.py"""
    assert architecture.out_of_date(house) == []


def test_a_new_import_makes_the_page_out_of_date(house, monkeypatch) -> None:
    monkeypatch.setitem(house.arrows, ("core", "cli"), 1)
    assert {"the table of imports", "the picture"} <= set(architecture.out_of_date(house))


def test_every_room_has_a_paragraph(house) -> None:
    page = architecture.PAGE.read_text(encoding="utf-8")
    rooms = [room for storey in architecture.floors() for room in storey]
    assert sorted(rooms) == house.rooms
    assert [room for room in rooms if f"\n**{room}** " not in page] == []


def stops() -> dict[str, list[str]]:
    """The ways of the page: the heading's first words, and FILE:FUNCTION of each stop."""
    part = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8").partition("\n## Six ways")[2]
    ways = (way.partition("\n") for way in part.partition("\n## ")[0].split("\n### ")[1:])
    return {title: re.findall(r"^\d+\. `(\S+?)`", text, re.MULTILINE) for title, _, text in ways}


WALKS = {
    "A CSV": "calibrate",
    "A campaign to": "diagnose",
    "A campaign through": "fleet",
    "A table": "verify",
    "An effect": "effect",
    "A network": "network",
}


@pytest.mark.parametrize("title", WALKS)
def test_a_way_is_walked_in_the_order_of_its_stops(title: str, tmp_path: Path) -> None:
    """Each stop is a function that the walk really enters, and none before an earlier stop."""
    if title in ("An effect", "A network") and not (shutil.which("gcc") or shutil.which("clang")):
        pytest.skip("no C compiler")
    (way,) = (found for name, found in stops().items() if name.startswith(title))
    assert len(way) > 8
    walk = [sys.executable, Path(__file__).with_name("walked.py"), WALKS[title], tmp_path]
    environment = {**os.environ, "CASADICAL_CACHE": str(tmp_path / "cache")}  # an empty one: nothing is skipped
    done = subprocess.run(walk, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    entered = json.loads(done.stdout.splitlines()[-1])
    assert [stop for stop in way if stop not in entered] == []
    assert way == sorted(way, key=entered.index)

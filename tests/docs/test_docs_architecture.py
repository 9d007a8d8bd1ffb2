"""The script that draws the floor plan: the committed page is what it makes, its ways are walked."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from walk import ROOT

sys.path.insert(0, str(ROOT / "docs" / "studies"))

import architecture
from imports_of_package import House


@pytest.fixture(scope="module")
def house() -> House:
    return House(ROOT / "casadical")


@pytest.mark.slow
def test_the_committed_page_is_up_to_date(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    """If not: python docs/studies/architecture.py"""
    assert architecture.out_of_date(house) == []
    monkeypatch.setitem(house.arrows, ("core", "cli"), 1)
    assert {"the table of imports", "the picture"} <= set(architecture.out_of_date(house))


def stops(heading: str) -> list[str]:
    """Return FILE:FUNCTION of each stop of the way under a heading that begins so."""
    part = architecture.PAGE.read_text(encoding="utf-8").partition("\n## Three ways")[2]
    (text,) = (way for way in part.partition("\n## ")[0].split("\n### ")[1:] if way.startswith(heading))
    return re.findall(r"^\d+\. `(\S+?)`", text, re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("heading", "way"), [("A CSV", "calibrate"), ("A campaign", "diagnose"), ("An effect", "effect")]
)
def test_a_way_is_walked_in_the_order_of_its_stops(heading: str, way: str, tmp_path: Path) -> None:
    """Each stop is a function that the walk really enters, and none before an earlier stop."""
    named = stops(heading)
    assert len(named) > 8
    walk = [sys.executable, Path(__file__).with_name("walked.py"), way, tmp_path]
    environment = {**os.environ, "CASADICAL_CACHE": str(tmp_path / "cache")}  # an empty one: nothing is skipped
    done = subprocess.run(walk, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    entered = json.loads(done.stdout.splitlines()[-1])
    assert [stop for stop in named if stop not in entered] == []
    assert named == sorted(named, key=entered.index)

"""The page on the diagnosis: its tables are those of the code, and its code runs."""

import sys
from pathlib import Path

import command_line
import pytest
from cases import ROOT

sys.path.insert(0, str(ROOT / "docs" / "studies"))

import diagnosis_tables

PAGE = ROOT / "docs" / "diagnosis.md"


def blocks() -> list[str]:
    parts = PAGE.read_text(encoding="utf-8").split("```python\n")[1:]
    return [part.split("```")[0] for part in parts]


def test_tables_are_those_of_the_code() -> None:
    """If not: python docs/studies/diagnosis_tables.py"""
    page = PAGE.read_text(encoding="utf-8")
    assert diagnosis_tables.filled(page) == page, "run: python docs/studies/diagnosis_tables.py"
    assert "| `hose_drag` |" in page


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1], ids=["use", "own effect"])
def test_code_runs_as_it_stands(number: int, tmp_path: Path) -> None:
    for name in ("problems", "data"):
        (tmp_path / name).symlink_to(ROOT / name)
    done = command_line.python(blocks()[number], tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("explained [")
    if number == 0:
        assert "friction_windup@3" in done.stdout
        assert len((tmp_path / "next.csv").read_text().splitlines()) == 11


def test_own_effect_is_twenty_lines() -> None:
    own = blocks()[1].split("@dataclass")[1].split("\n\n\nrobot")[0]
    assert len([line for line in own.splitlines() if line.strip()]) <= 20

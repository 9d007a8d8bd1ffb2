"""The pages on the diagnosis: their tables are those of the code, and their code runs."""

import re
import sys
from pathlib import Path

import command_line
import pytest
from cases import ROOT

sys.path.insert(0, str(ROOT / "docs" / "studies"))

import diagnosis_tables

PAGE = ROOT / "docs" / "diagnosis.md"


def test_tables_are_those_of_the_code() -> None:
    """If not: python docs/studies/diagnosis_tables.py"""
    pages = [path.read_text(encoding="utf-8") for path in diagnosis_tables.PAGES]
    assert [diagnosis_tables.filled(page) for page in pages] == pages, "run: python docs/studies/diagnosis_tables.py"
    marked = {name for page in pages for name in re.findall(r"<!-- (\w+) -->\n.", page)} - {"end"}
    assert marked == set(diagnosis_tables.tables())
    assert "\n- **`hose_drag`**: " in pages[0]


@pytest.mark.slow
def test_code_runs_as_it_stands(tmp_path: Path) -> None:
    for name in ("problems", "data"):
        (tmp_path / name).symlink_to(ROOT / name)
    code = PAGE.read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    done = command_line.python(code, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("explained [")
    assert "friction_windup@3" in done.stdout
    assert len((tmp_path / "next.csv").read_text().splitlines()) == 11


def test_an_own_effect_is_twenty_lines() -> None:
    page = (ROOT / "docs" / "add-an-effect.md").read_text(encoding="utf-8")
    own = page.split("@dataclass")[1].split("\n\n\nrobot")[0]
    assert len([line for line in own.splitlines() if line.strip()]) <= 20

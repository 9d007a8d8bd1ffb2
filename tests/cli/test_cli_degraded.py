"""The command where something is missing: the same figures as elsewhere, or a sentence."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from casadical import calibrate

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
PLANAR = ROOT / "problems" / "planar"
COMMAND = [sys.executable, "-c", "from casadical.cli import main; main()"]
UNSET = ("HOME", "XDG_CACHE_HOME", "CASADICAL_CACHE", "TERM", "LANG", "USER", "LOGNAME", "TMPDIR", "COLUMNS")

# Each world: what is changed in the environment, None for what is removed; faults that do not touch each other.
WORLDS: dict[str, dict[str, str | None]] = {
    "no compiler, a terminal of one column": {"PATH": "/nowhere", "CC": "/nowhere/cc", "COLUMNS": "1", "LINES": "1"},
    "no cache, a locale that is not there": {"CASADICAL_CACHE": "/dev/null/cache", "LC_ALL": "tr_TR.ISO-8859-9"},
    "no home, an output in ASCII": {**dict.fromkeys(UNSET), "PYTHONIOENCODING": "ascii:strict"},
    "a home and a proxy that are not there, colours by force, a locale without letters": {
        "HOME": "/nowhere",
        "XDG_CACHE_HOME": None,
        "CASADICAL_CACHE": None,
        "FORCE_COLOR": "1",
        "LC_ALL": "C",
        "PYTHONUTF8": "0",
        "PYTHONCOERCECLOCALE": "0",
        "HTTPS_PROXY": "http://127.0.0.1:9",
        "HTTP_PROXY": "http://127.0.0.1:9",
    },
}


def environment(change: dict[str, str | None]) -> dict[str, str]:
    whole = os.environ | {"PYTHONPATH": str(ROOT)} | change
    return {name: value for name, value in whole.items() if value is not None}


@pytest.fixture(scope="module")
def expected() -> object:
    return calibrate(PLANAR).to_json()


@pytest.fixture
def named(tmp_path: Path) -> Path:
    """A problem with a title that not every encoding has."""
    text = (PLANAR / "problem.toml").read_text(encoding="utf-8")
    text = text.replace("../../data", str(ROOT / "data")).replace('title = "', 'title = "Größe 大 ')
    folder = tmp_path / "größe"
    folder.mkdir()
    (folder / "problem.toml").write_text(text, encoding="utf-8")
    (folder / "robot.toml").write_bytes((PLANAR / "robot.toml").read_bytes())
    return folder


@pytest.mark.parametrize("world", WORLDS)
def test_the_same_figures_in_every_world(world: str, expected, named: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept.json"
    command = [*COMMAND, "calibrate", str(named), "--json", str(kept)]
    done = subprocess.run(command, cwd=tmp_path, env=environment(WORLDS[world]), capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    found = json.loads(kept.read_text(encoding="utf-8"))
    assert found["methods"] == expected["methods"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["größe", "kept.json"], "nothing is made in the folder"


def test_without_standard_output_the_files_are_written_all_the_same(expected, tmp_path: Path) -> None:
    line = f"{' '.join(map(repr, COMMAND))} calibrate {str(PLANAR)!r} --json kept.json <&- >&- 2>&-"
    assert subprocess.run(["sh", "-c", line], cwd=tmp_path, env=environment({}), check=False).returncode == 0
    assert json.loads((tmp_path / "kept.json").read_text())["methods"] == expected["methods"]

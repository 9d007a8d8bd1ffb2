"""The README's code and commands work as they stand there."""

import re
import subprocess
from pathlib import Path

import command_line
import pytest
from repository import ROOT, fenced

README = ROOT / "README.md"
VENV = "python3 -m venv .venv && .venv/bin/pip install "


def test_the_two_commands_are_whole() -> None:
    calibrate, tests = (block.strip() for block in fenced(README, "sh"))
    assert calibrate.startswith(f"{VENV}. && .venv/bin/casadical calibrate ")
    assert tests == f"{VENV}-e '.[dev]' && .venv/bin/python -m pytest -n auto"


@pytest.mark.slow
def test_the_calibrate_command_runs() -> None:
    """Its last part, in this process; .ci/run makes a fresh environment by the second command."""
    name, *arguments = fenced(README, "sh")[0].strip().split(" && ")[-1].split()
    assert Path(name).name == "casadical"
    done = command_line.run(*arguments)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("report (held out)") == 2
    assert done.stdout.count("are not identifiable.") == 2


def test_ci_runs_the_readmes_command() -> None:
    script = ROOT / ".ci" / "run"
    assert script.stat().st_mode & 0o111
    line = next(line for line in script.read_text().splitlines() if line.startswith("command="))
    found = subprocess.run(
        ["bash", "-c", f'{line}; echo "$command"'], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == fenced(README, "sh")[1].strip()


@pytest.mark.slow
def test_the_example_runs(tmp_path: Path) -> None:
    (code,) = fenced(README, "python")
    assert len([line for line in code.splitlines() if line.strip()]) <= 15
    for name in ("problems", "data"):
        (tmp_path / name).symlink_to(ROOT / name)
    done = command_line.python(code, tmp_path)
    assert done.returncode == 0, done.stderr
    before, after = map(float, re.search(r"mean: ([\d.]+) mm .*, ([\d.]+) mm", done.stdout).groups())
    assert after < 0.6 < before
    assert (tmp_path / "ur10_calibrated.toml").exists()


def test_a_robot_in_the_docs_is_one(tmp_path: Path) -> None:
    from casadical import read_robot

    six_axis = (ROOT / "problems" / "hh800" / "robot.toml").read_text().replace("casadical = 1", "")
    for k, text in enumerate(fenced(ROOT / "docs" / "robot-file.md", "toml")):
        if "[[joint]]" not in text:  # what a robot may have besides: in the file of one
            head, first, rest = text.partition("[[")
            text = head + six_axis + "\n" + first + rest
        (tmp_path / f"{k}.toml").write_text(text)
        read_robot(tmp_path / f"{k}.toml")

"""Lint, format and the floor plan hold; the types, in test_house_names."""

import subprocess
import sys
from pathlib import Path

import pytest
from repository import ROOT

BIN = Path(sys.executable).parent
COMMANDS = ["ruff check", "ruff format --check", "mypy", "lint-imports"]


@pytest.mark.parametrize("command", [c for c in COMMANDS if c != "mypy"], ids=lambda text: text.replace(" ", "-"))
def test_house_rule(command: str) -> None:
    tool, *arguments = command.split()
    done = subprocess.run([BIN / tool, *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"

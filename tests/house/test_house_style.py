"""Lint, format and the floor plan hold; the types, in test_house_names. Ties are broken by rule where answers are."""

import ast
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


@pytest.mark.parametrize("room", ["diagnosis", "fleet", "pose_selection"])
def test_what_is_chosen_is_the_first_of_the_best_on_every_processor(room) -> None:
    for path in (ROOT / "casadical" / room).rglob("*.py"):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(call, ast.Call):
                continue
            where = f"{path.name}:{call.lineno}: rounding decides among ties: take first_of_best or best_of"
            name, keys = ast.unparse(call.func), {k.arg: ast.unparse(k.value) for k in call.keywords}
            if name.endswith(".argmax"):
                assert any(isinstance(argument, ast.Compare) for argument in call.args), where
            if name in ("max", "min") and "key" in keys:
                assert keys["key"] == "len", where

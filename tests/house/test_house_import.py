"""What an import loads, seen in a fresh process; a stopwatch would only measure the machine."""

import importlib.util
import json
import subprocess
import sys

import pytest

HEAVY = {"casadi", "numpy", "pandas", "pydantic", "typer", "rich", "scipy", "matplotlib"}
KINEMATICS = {"casadical.robot", "casadical.identification", "casadical.effects"}


def loaded_by(statement: str) -> set[str]:
    lines = (
        "import json, sys",
        "before = set(sys.modules)",
        statement,
        "print(json.dumps([*set(sys.modules) - before]))",
    )
    program = "\n".join(lines)
    out = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    return set(json.loads(out.splitlines()[-1]))


def test_import_of_casadical_loads_nothing_heavy() -> None:
    loaded = loaded_by("import casadical")
    assert "casadical" in loaded
    assert loaded & HEAVY == set()
    assert {name for name in loaded if name.startswith("casadical.")} == {"casadical.core", "casadical.core.lazy"}
    assert len(loaded) < 20  # the few modules of the standard library that importlib and typing bring


def test_the_help_loads_no_solver() -> None:
    statement = "from casadical.cli import app\ntry:\n    app(['calibrate', '--help'])\nexcept SystemExit:\n    pass"
    assert loaded_by(statement) & {"casadi", "numpy", "pandas"} == set()


@pytest.mark.parametrize(
    ("package", "foreign"),
    [
        ("casadical.export", KINEMATICS | {"casadical.compensator"}),
        ("casadical.blind_check.mujoco_physics", KINEMATICS | {"casadi", "casadical.export", "casadical.compensator"}),
        ("casadical.project.calibration", {"scipy", "lark", "mujoco", "plotly"}),
        ("casadical.project.diagnosis", {"scipy", "lark", "mujoco", "plotly"}),
    ],
)
def test_a_package_loads_nothing_foreign_to_it(package: str, foreign: set[str]) -> None:
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not part of this version")
    loaded = loaded_by(f"import {package}")
    assert package in loaded
    assert loaded & foreign == set()

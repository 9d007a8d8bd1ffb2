"""What an import loads, seen in a fresh process; a stopwatch would only measure the machine."""

import importlib.util
import json
import subprocess
import sys

import pytest
from command_line import ROOT

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
    command = [sys.executable, "-c", program]
    out = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout
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


ALLOWED_TO_PHYSICS = {"casadical", "casadical.core", "casadical.core.basics", "casadical.core.lazy"}
PHYSICS = "casadical.blind_check.mujoco_physics"
# Every effect there is, hidden and measured by the physics of the blind check.
PHYSICS_AT_WORK = f"""
import numpy as np
sys.path.insert(0, "tests/blind_check")
from mujoco_physics.machines import built
from {PHYSICS} import LISTED, UNLISTED, campaign, draw_effect
for word in (*LISTED, *UNLISTED):
    plant = built("kr210")
    campaign(plant, [draw_effect(plant, word, np.random.default_rng(0))], 2, seed=1, truth=True)
"""


@pytest.mark.parametrize(
    ("package", "foreign"),
    [
        ("casadical.export", KINEMATICS | {"casadical.compensator"}),
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


def test_the_compensator_loads_no_other_package_of_casadical_and_no_casadi() -> None:
    loaded = loaded_by("import casadical.compensator")
    assert {name.split(".")[1] for name in loaded if name.startswith("casadical.")} == {"core", "compensator"}
    assert "casadi" not in loaded


@pytest.mark.slow
@pytest.mark.parametrize(("program", "needs"), [(f"import {PHYSICS}", "numpy"), (PHYSICS_AT_WORK, "mujoco")])
def test_the_physics_load_nothing_of_what_they_judge(program: str, needs: str) -> None:
    """Once they have done their work; what shows results in a notebook knows no model."""
    pytest.importorskip(needs, reason=f"{needs} is not installed")
    loaded = loaded_by(program)
    ours = {name for name in loaded if name.split(".")[0] == "casadical"} - ALLOWED_TO_PHYSICS
    assert {m for m in ours if not m.startswith((PHYSICS, "casadical.core.reporting"))} == {"casadical.blind_check"}
    assert {name.split(".")[0] for name in loaded} & {"casadi", "pinocchio", "sklearn"} == set()
    assert f"{PHYSICS}.causes_load" in loaded
    assert ("mujoco" in loaded) == (needs == "mujoco")

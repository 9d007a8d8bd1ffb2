"""The engine shares no code with the model, the effects or the diagnosis."""

import json
import subprocess
import sys

import pytest

OURS = {"blind_check", "core"}
LOADED = "import json, sys; print(json.dumps([*sys.modules]))"
# Every effect there is, hidden and measured.
AT_WORK = """
import numpy as np
from machines import built
from casadical.blind_check import mujoco_physics as engine
for word in (*engine.LISTED, *engine.UNLISTED):
    plant = built("kr210")
    engine.campaign(plant, [engine.draw_effect(plant, word, np.random.default_rng(0))], 2, seed=1, truth=True)
"""


def loaded_by(program: str, folder: str) -> set[str]:
    done = subprocess.run(
        [sys.executable, "-c", program + LOADED], capture_output=True, text=True, cwd=folder, check=True
    )
    return set(json.loads(done.stdout))


def ours(loaded: set[str]) -> set[str]:
    return {m.split(".")[1] for m in loaded if m.startswith("casadical.")}


def test_importing_the_engine_loads_the_simulation_and_nothing_else_of_casadical():
    loaded = loaded_by("import casadical.blind_check.mujoco_physics\n", ".")
    assert ours(loaded) == OURS
    assert not {"casadi", "mujoco"} & loaded


def test_the_engine_at_work_loads_nothing_of_the_model_the_effects_or_the_diagnosis(request):
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    loaded = loaded_by(AT_WORK, str(request.path.parent))
    assert "mujoco" in loaded
    assert ours(loaded) == OURS
    assert "casadi" not in loaded

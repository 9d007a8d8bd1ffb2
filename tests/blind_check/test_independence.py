"""Judge and judged stand apart, in fresh processes: what each of them has loaded once it has done its work."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow  # a process each
ROOM = "casadical.blind_check"
# Of the package, the physics may load no more than this.
ALLOWED = {"casadical", "casadical.core", "casadical.core.basics", "casadical.core.lazy", ROOM}
# The second shows things in a notebook and knows no model.
PHYSICS = (f"{ROOM}.mujoco_physics", "casadical.core.reporting")
# Every effect there is, hidden and measured.
MUJOCO_AT_WORK = """
import numpy as np
sys.path.insert(0, "..")
from mujoco_physics.machines import built
from casadical.blind_check.mujoco_physics import LISTED, UNLISTED, campaign, draw_effect
for word in (*LISTED, *UNLISTED):
    plant = built("kr210")
    campaign(plant, [draw_effect(plant, word, np.random.default_rng(0))], 2, seed=1, truth=True)
"""


def loaded_by(program: str) -> set[str]:
    """Modules that a process has loaded after a program."""
    tail = "\nprint(json.dumps([*sys.modules]))"
    done = subprocess.run(
        [sys.executable, "-c", "import json, sys\n" + program + tail],
        capture_output=True, text=True, cwd=Path(__file__).parent, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.parametrize(
    ("program", "needs"),
    [("import casadical.blind_check.mujoco_physics", "numpy"), (MUJOCO_AT_WORK, "mujoco")],
    ids=["import", "mujoco at work"],
)
def test_the_physics_load_nothing_of_what_they_judge(program: str, needs: str) -> None:
    pytest.importorskip(needs, reason=f"{needs} is not installed")
    loaded = loaded_by(program)
    ours = {m for m in loaded if m.split(".")[0] == "casadical"}
    assert {m for m in ours if m not in ALLOWED and not m.startswith(PHYSICS)} == set()
    assert {m.split(".")[0] for m in loaded} & {"casadi", "pinocchio", "sklearn"} == set()
    assert f"{ROOM}.mujoco_physics.causes_load" in ours
    assert ("mujoco" in loaded) == (needs == "mujoco")

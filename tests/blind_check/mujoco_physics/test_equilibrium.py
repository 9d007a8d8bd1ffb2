"""Where the engine comes to rest, against the simulator's fixed point and against Pinocchio."""

import numpy as np
import numpy_physics as simulation
import pytest

from casadical.blind_check import mujoco_physics as engine

from .machines import ROBOTS, built

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'casadical[withheld]'")
TRUE = ["x_true_mm", "y_true_mm", "z_true_mm"]


# The simulator closes the four-bar in a plane, the engine in space with ball joints: they differ in the second order.
@pytest.mark.parametrize(("name", "within_um"), [("hh800", 0.5), ("kr210", 0.1), ("ur10e", 0.1)])
def test_without_effects_the_engine_agrees_with_the_independent_simulator(name, within_um):
    machine = built(name)
    ours = engine.campaign(machine, (), 40, 3, repeatability_urad=8.0, truth=True)
    theirs = simulation.campaign(machine, 40, 3, truth=True)
    assert np.abs(ours[TRUE] - theirs[TRUE]).to_numpy().max() < 1e-3 * within_um
    assert np.abs(ours - theirs).to_numpy().max() < 2e-3 * within_um  # the same noise, too


@pytest.mark.parametrize("name", ROBOTS)
def test_the_same_rest_is_reached_by_a_simulated_move(name):
    machine = built(name)
    idle = engine.Hidden("friction_windup", 2, {"size": 1e-12, "load_share": 0.0})
    moved, still = (engine.campaign(machine, h, 8, 4, truth=True) for h in ((idle,), ()))
    assert np.abs(moved[TRUE] - still[TRUE]).to_numpy().max() < 1e-5

"""Where the engine comes to rest, against Pinocchio and the work of the motors."""

import numpy as np
import pytest
from marks import MUJOCO

from casadical.blind_check import mujoco_physics as engine
from casadical.blind_check.mujoco_physics import mechanism
from casadical.blind_check.mujoco_physics.equilibrium import Engine, Stop
from casadical.blind_check.mujoco_physics.mechanism import start

from .machines import ROBOTS, built, drawn, stops
from .oracle import rest

pytestmark = MUJOCO
TRUE = ["x_true_mm", "y_true_mm", "z_true_mm"]


@pytest.mark.parametrize("name", ROBOTS)
def test_the_same_rest_is_reached_by_a_simulated_move(name):
    machine = built(name)
    idle = engine.Hidden("friction_windup", 2, {"size": 1e-12, "load_share": 0.0})
    moved, still = (engine.campaign(machine, h, 8, 4, truth=True) for h in ((idle,), ()))
    assert np.abs(moved[TRUE] - still[TRUE]).to_numpy().max() < 1e-5


# The engine's loop is not rigid: its coupler gives as much as would a joint 10,000 times stiffer than joint 3.
@pytest.mark.parametrize(("name", "within_um"), [("hh800", 0.2), ("kr210", 0.05), ("ur10e", 0.05)])
def test_without_effects_the_engine_rests_where_pinocchios_weights_and_the_springs_are_in_balance(name, within_um):
    machine = built(name)
    q = drawn(machine, 4)
    for payload in (0.0, machine.payload_kg):
        ours = engine.positions(machine, (), stops(q, payload))
        theirs = np.array([rest(machine, payload, angles) for angles in q])
        assert np.linalg.norm(ours - theirs, axis=1).max() < 1e-6 * within_um


def test_the_loop_closes_within_a_tenth_of_a_micrometre_under_full_load():
    machine = built("hh800")
    moving = Engine(mechanism(machine))
    for q in drawn(machine, 12):
        moving.rest(Stop(q, np.ones(6), start(machine, q), machine.payload_kg))
        ends = [moving.data.site(name).xpos for name in ("coupler_end", "rocker_end")]
        assert np.linalg.norm(ends[0] - ends[1]) < 1e-7

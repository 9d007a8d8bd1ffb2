"""What load, play and friction do in the engine is what their physics demands."""

import numpy as np
import pytest
from marks import MUJOCO

from casadical.blind_check import mujoco_physics as engine
from casadical.blind_check.mujoco_physics import Hidden
from casadical.blind_check.mujoco_physics.cause import settle
from casadical.blind_check.mujoco_physics.equilibrium import Engine, Stop
from casadical.blind_check.mujoco_physics.hidden import cause
from casadical.blind_check.mujoco_physics.mechanism import start

from .machines import built, drawn, shift, stops

pytestmark = MUJOCO


def test_friction_of_joint_3_of_a_four_bar_holds_the_crank_back():
    machine = built("hh800")
    hidden = Hidden("friction_windup", 3, {"size": 50e-6, "load_share": 0.0})
    for q in drawn(machine, 3):
        moving = Engine(cause(hidden).built(engine.mechanism(machine), machine))
        cranks = []
        for came in (-1.0, 1.0):
            moving.rest(Stop(q, np.full(6, came), start(machine, q), 0.0))
            cranks.append(moving.data.joint("joint3").qpos[0])
        assert cranks[0] - cranks[1] == pytest.approx(100e-6, rel=0.03)


def test_a_loose_flange_moves_only_under_a_payload_and_no_further_than_its_stops():
    machine, q = built("kr210"), drawn(built("kr210"), 12)
    hidden = Hidden("loose_flange", None, {"size": 100e-6})
    assert np.abs(shift(machine, hidden, stops(q, 0.0))).max() < 1e-7
    moved = np.linalg.norm(shift(machine, hidden, stops(q, machine.payload_kg)), axis=1)
    farthest = 100e-6 * np.linalg.norm(machine.reflector)
    assert 1.2 * farthest < moved.max() <= 1.001 * np.sqrt(2) * farthest


def test_a_worn_bearing_lets_the_link_drop_along_gravity_within_its_play():
    machine, q = built("kr210"), drawn(built("kr210"), 12)
    moved = shift(machine, Hidden("bearing_play", 2, {"size": 40e-6}), stops(q, machine.payload_kg))
    assert (moved[:, 2] < -20e-6).all()
    assert np.linalg.norm(moved, axis=1).max() < 1.05 * np.sqrt(2) * 40e-6


def test_a_hose_pulls_only_when_it_is_drawn_out():
    machine, q = built("ur10e"), drawn(built("ur10e"), 40)
    moved = np.linalg.norm(shift(machine, Hidden("hose_pull", None, {"size": 150e-6}), stops(q, 0.0)), axis=1)
    assert (moved < 1e-8).any()
    assert (moved > 5e-6).any()


def test_a_tool_that_slipped_stays_where_it_slipped_to():
    machine = built("kr210")
    hidden = Hidden("tool_slip", None, {"size": 60e-6, "grip": 0.5})
    tipped, other, upright = np.deg2rad([[0, -60, 40, 0, 70, 0], [0, -60, 40, 0, 70, 180], [0, -60, 40, 0, 110, 0]])
    assert _steepness(machine, tipped) > 0.6 > 0.4 > _steepness(machine, upright)
    ends = [
        shift(machine, hidden, stops(np.array([first, upright]), machine.payload_kg))[1] for first in (tipped, other)
    ]
    assert np.linalg.norm(ends[0] - ends[1]) > 60e-6
    assert np.linalg.norm(ends, axis=1).max() < 90e-6


def _steepness(machine, q) -> float:
    """How much of the payload's weight pulls along the flange's face."""
    body = settle(machine, stops(q[None], 0.0)).bodies[5][0]
    return float(np.linalg.norm(np.cross(body[:3, :3] @ machine.axes[5], [0, 0, 1])))

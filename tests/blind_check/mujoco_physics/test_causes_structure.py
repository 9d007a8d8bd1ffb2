"""What bends, grows, wobbles, tips and creeps in the engine is what its physics demands."""

import numpy as np
import pytest
from marks import MUJOCO

from casadical.blind_check import mujoco_physics as engine
from casadical.blind_check.mujoco_physics import Hidden
from casadical.blind_check.mujoco_physics.cause import reflector, settle
from casadical.blind_check.mujoco_physics.equilibrium import Engine, Stop
from casadical.blind_check.mujoco_physics.hidden import cause
from casadical.blind_check.mujoco_physics.mechanism import start

from .machines import built, drawn, nominal, shift, stops

pytestmark = MUJOCO


def test_a_crack_opens_one_way_only():
    machine = built("kr210")
    at = stops(drawn(machine, 60), machine.payload_kg)
    one, other = (
        np.linalg.norm(
            shift(machine, Hidden("cracked_link", None, {"link": 3, "size": 1e-4, "towards": t}), at), axis=1
        )
        for t in (0.5, 0.5 + np.pi)
    )
    closed = [moved < 2e-7 for moved in (one, other)]
    assert all(5 < c.sum() < 55 for c in closed)
    assert (closed[0] ^ closed[1]).mean() > 0.95


def test_a_loose_anchor_tips_to_one_side_or_the_other_and_no_further():
    machine = built("kr210")
    hidden = Hidden("loose_anchor", None, {"size": 50e-6, "towards": 0.3})
    moving = Engine(cause(hidden).built(engine.mechanism(machine), machine))
    tips = []
    for q in drawn(machine, 30):
        moving.rest(Stop(q, np.ones(6), start(machine, q), machine.payload_kg))
        tips.append(moving.data.joint("tip").qpos[0])
    assert np.abs(tips).max() < 50.1e-6
    assert np.mean(np.abs(tips) > 49e-6) > 0.5
    assert {np.sign(t) for t in tips} == {-1.0, 1.0}


@pytest.mark.parametrize("name", ["hh800", "kr210"])
def test_a_robot_warm_through_and_through_is_the_same_robot_larger(name):
    machine = nominal(name)
    q = np.repeat(drawn(machine, 4), 2, axis=0)
    at = stops(q, 0.0, time_s=np.repeat([1.0, 4e5, 8e5, 12e5], 2) + np.tile([0.0, 3e5], 4), warmth_K=5.0)
    moved = shift(machine, Hidden("thermal_growth", None, {"size": 12e-6, "lag_minutes": 8.0}), at)
    rest = settle(machine, at)
    flange = rest.bodies[5, :, :3, :3] @ machine.home[5, :3, 3] + rest.bodies[5, :, :3, 3]
    larger = 60e-6 * (flange + 0.3 * (reflector(rest) - flange))
    assert np.linalg.norm(moved[0]) < 0.02 * np.linalg.norm(larger[0])  # cold after a second
    np.testing.assert_allclose(moved[1:], larger[1:], atol=3e-3 * np.abs(larger).max())


def test_a_column_warm_on_one_side_leans_and_straightens_again():
    machine = built("kr210")
    at = stops(np.repeat(drawn(machine, 1), 4, axis=0), 0.0, time_s=[10.0, 600.0, 6000.0, 60000.0], warmth_K=6.0)
    hidden = Hidden("thermal_bend", None, {"size": 15e-6, "towards": 1.0, "lag_minutes": 30.0})
    moved = np.linalg.norm(shift(machine, hidden, at), axis=1)
    assert moved[0] > moved[1] > moved[2] > moved[3]
    assert moved[0] > 5e-5
    assert moved[3] < 1e-7


def test_wrong_points_are_few_and_far_off():
    machine = built("ur10e")
    sizes = {"share": 0.2, "size": 1e-3}
    with_, without = (
        engine.campaign(machine, h, 60, 1, noise_mm=0.0, repeatability_urad=0.0)[["x_mm", "y_mm", "z_mm"]].to_numpy()
        for h in ((Hidden("outliers", None, sizes),), ())
    )
    off = np.linalg.norm(with_ - without, axis=1)
    assert 0.05 < np.mean(off > 0) < 0.4
    assert off[off > 0].min() >= 0.499

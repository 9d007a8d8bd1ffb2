"""What load, play and friction do in the engine is what their physics demands."""

from dataclasses import replace

import numpy as np
import pytest

from casadical.blind_check import mujoco_physics as engine
from casadical.blind_check.mujoco_physics import Hidden
from casadical.blind_check.mujoco_physics.cause import moments, rated_torque, reflector, settle
from casadical.blind_check.mujoco_physics.equilibrium import Engine, Stop
from casadical.blind_check.mujoco_physics.hidden import cause
from casadical.blind_check.mujoco_physics.robot import start

from .machines import angle_about, built, drawn, nominal, shift, stops

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'casadical[withheld]'")


@pytest.mark.parametrize(("name", "joint"), [("kr210", 2), ("ur10e", 5), ("hh800", 4)])
def test_friction_holds_the_joint_back_by_its_windup_on_the_side_it_came_from(name, joint):
    machine, q = built(name), drawn(built(name), 6)
    hidden = Hidden("friction_windup", joint, {"size": 50e-6, "load_share": 0.8})
    for came in (-1.0, 1.0):
        at = stops(q, machine.payload_kg, approach=came)
        angle, left = angle_about(machine, at, joint, shift(machine, hidden, at))
        load = np.abs(settle(machine, at).load[:, joint - 1]) / rated_torque(machine)[joint - 1]
        np.testing.assert_allclose(angle, -came * 50e-6 * (1 + 0.8 * load), atol=1.5e-6)
        assert left.max() < 1e-6


def test_friction_of_joint_3_of_a_four_bar_holds_the_crank_back():
    machine = built("hh800")
    hidden = Hidden("friction_windup", 3, {"size": 50e-6, "load_share": 0.0})
    for q in drawn(machine, 3):
        moving = Engine(cause(hidden).built(engine.mechanism(machine), machine))
        cranks = []
        for came in (-1.0, 1.0):
            moving.rest(Stop(q, np.full(6, came), start(machine, q), 0.0))
            cranks.append(moving.coordinate("joint3"))
        assert cranks[0] - cranks[1] == pytest.approx(100e-6, rel=0.03)


def test_backlash_is_taken_up_by_the_load_and_where_there_is_none_by_the_approach():
    machine = nominal("kr210")
    hidden = Hidden("backlash", 5, {"size": 80e-6, "friction": 0.1})
    q = drawn(machine, 40)
    load = settle(machine, stops(q, machine.payload_kg)).load[:, 4]
    heavy = np.abs(load) > 0.2 * rated_torque(machine)[4]
    sides = {}
    for came in (-1.0, 1.0):
        at = stops(q, machine.payload_kg, approach=came)
        sides[came], left = angle_about(machine, at, 5, shift(machine, hidden, at))
        assert left.max() < 1e-6
    assert (np.abs(load[heavy]) > 1.5 * 0.1 * 80e-6 * machine.stiffness[4]).all()
    assert heavy.sum() > 10
    for angle in sides.values():
        np.testing.assert_allclose(
            angle[heavy], 80e-6 * np.sign(load[heavy]), atol=1.2 * 0.1 * 80e-6
        )  # the bearing winds the spring
    vertical = Hidden("backlash", 1, {"size": 80e-6, "friction": 0.1})  # gravity has no torque about it
    at = stops(q[:6], machine.payload_kg, approach=1.0)
    angle, _ = angle_about(machine, at, 1, shift(machine, vertical, at))
    np.testing.assert_allclose(angle, -1.1 * 80e-6, atol=2e-6)


@pytest.mark.parametrize("knee", [0.2, 0.0])
def test_a_joint_that_hardens_follows_its_curve_of_torque_against_twist(knee):
    machine, joint = built("kr210"), 3
    size, linear, rated = 120e-6, 0.15, rated_torque(built("kr210"))[2]
    hidden = Hidden("nonlinear_stiffness", joint, {"size": size, "knee": knee, "linear": linear})
    at = stops(drawn(machine, 25), machine.payload_kg)
    angle, _ = angle_about(machine, at, joint, shift(machine, hidden, at))
    load = settle(machine, at).load[:, joint - 1]
    if knee:  # two straight pieces that meet at the knee; the twist at large torques is `size` beyond the linear one
        extra = np.sign(load) * size * np.minimum(np.abs(load) / (knee * rated), 1.0)
    else:  # the root of a x + b x^3 = torque
        a, b = linear * rated / size, (1 - linear) * rated / size**3
        extra = np.array([np.roots([b, 0, a, -t])[np.argmin(np.abs(np.roots([b, 0, a, -t]).imag))].real for t in load])
    np.testing.assert_allclose(angle, extra, atol=1.5e-6)


def test_a_balancing_spring_gives_the_torque_of_its_energy():
    machine = built("kr210")
    hidden = Hidden("gravity_compensator", None, {"size": 0.3, "lean": 0.2, "post": 2.5})
    mechanism = cause(hidden).built(engine.mechanism(machine), machine)
    moving, cord = Engine(mechanism), mechanism.cords[0]
    springs = []
    for q in drawn(machine, 5):
        moving.rest(Stop(q, np.ones(6), start(machine, q), machine.payload_kg))
        angles = np.array([moving.coordinate(f"joint{j}") for j in range(1, 7)])

        def energy(turn: float, angles=angles) -> float:
            moving.data.qpos[1] = angles[1] + turn
            moving.mujoco.mj_kinematics(moving.model, moving.data)
            post, lug = (moving.data.site(name).xpos for name in ("post", "lug"))
            return 0.5 * cord.stiffness * max(np.linalg.norm(post - lug) - cord.rest[1], 0.0) ** 2

        springs.append(-(energy(1e-5) - energy(-1e-5)) / 2e-5)
        weights = moments(replace(settle(machine, stops(q[None], machine.payload_kg)), angles=angles[None]))[0, 1]
        carried = machine.stiffness[1] * (angles[1] - q[1])
        assert carried == pytest.approx(weights + springs[-1], abs=2e-3 * rated_torque(machine)[1])
    assert np.abs(springs).max() > 0.05 * rated_torque(machine)[1]


@pytest.mark.parametrize("name", ["hh800", "ur10e"])
def test_a_wrong_payload_bends_the_springs_by_its_weight_and_nothing_without_payload(name):
    machine, q = built(name), drawn(built(name), 8)
    hidden = Hidden("payload_error", None, {"size": 0.08, "shift_m": (0.02, -0.01, 0.03)})
    wrong = replace(machine, payload_factor=1.08, payload_com=machine.payload_com + np.array([0.02, -0.01, 0.03]))
    at = stops(q, machine.payload_kg)
    moved = reflector(settle(wrong, at)) - reflector(settle(machine, at))
    np.testing.assert_allclose(shift(machine, hidden, at), moved, atol=1e-7)
    assert np.abs(shift(machine, hidden, stops(q, 0.0))).max() < 1e-9


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

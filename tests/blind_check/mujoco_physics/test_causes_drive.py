"""What gears, encoders, belts and bevels do in the engine is what their geometry demands."""

import numpy as np
import pytest

from casadical.blind_check import mujoco_physics as engine
from casadical.blind_check.mujoco_physics import Hidden
from casadical.blind_check.mujoco_physics.equilibrium import Engine, Stop
from casadical.blind_check.mujoco_physics.hidden import cause
from casadical.blind_check.mujoco_physics.robot import start

from .machines import angle_about, built, drawn, shift, stops

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'casadical[withheld]'")

TURN = np.linspace(-np.pi, np.pi, 48, endpoint=False)


def errors_of_a_turn(hidden: Hidden) -> np.ndarray:
    """Angle errors (48,) [rad] of the unloaded wrist joint 6 of the KR210 over a turn of its readings."""
    machine = built("kr210")
    q = np.tile(np.deg2rad([20.0, -60.0, 40.0, 10.0, 50.0, 0.0]), (48, 1))
    q[:, hidden.joint - 1] = TURN
    at = stops(q, 0.0)
    angle, left = angle_about(machine, at, hidden.joint, shift(machine, hidden, at))
    assert left.max() < 1e-6
    return angle


def harmonics(angle: np.ndarray) -> np.ndarray:
    return 2 * np.abs(np.fft.rfft(angle)) / len(angle)


def test_a_wheel_off_its_centre_errs_as_the_angle_seen_from_a_point_off_the_centre():
    size, towards = 120e-6, 0.7
    sizes = {"size": size, "towards": towards, "oval": 0.0, "oval_towards": 0.0}
    angle = errors_of_a_turn(Hidden("gear_eccentricity", 6, sizes))
    # a circle of radius 1 about (size, towards): the shaft's angle is read where its ray meets the rim
    rim = np.exp(1j * TURN) - size * np.exp(1j * (towards + np.pi))
    seen = np.angle(rim / np.exp(1j * TURN))
    assert np.std(angle) == pytest.approx(np.std(seen), rel=0.01)
    assert harmonics(angle)[1] == pytest.approx(size, rel=0.01)
    assert harmonics(angle)[2:].max() < 1e-3 * size


def test_an_oval_wheel_errs_twice_a_turn():
    sizes = {"size": 0.0, "towards": 0.0, "oval": 80e-6, "oval_towards": 0.4}
    parts = harmonics(errors_of_a_turn(Hidden("gear_eccentricity", 6, sizes)))
    assert parts[2] == pytest.approx(80e-6, rel=0.02)
    assert np.delete(parts, [0, 2]).max() < 1e-3 * 80e-6


def test_teeth_err_at_their_frequency_and_its_odd_multiples():
    parts = harmonics(errors_of_a_turn(Hidden("transmission_ripple", 6, {"size": 40e-6, "cycles": 4, "phase": 0.3})))
    assert np.argmax(parts) == 4
    assert np.delete(parts, [4, 12, 20]).max() < 1e-2 * parts[4]


def test_a_scratch_errs_only_beside_it():
    angle = errors_of_a_turn(Hidden("encoder_pit", 6, {"size": 90e-6, "at_rad": 1.0, "width_rad": 0.5}))
    assert np.abs(angle[np.abs(TURN - 1.0) > 0.5]).max() < 1e-8
    assert np.abs(angle).max() == pytest.approx(90e-6, rel=0.05)


def test_a_damaged_tooth_errs_for_a_tenth_of_each_turn_of_its_pinion():
    angle = errors_of_a_turn(Hidden("damaged_tooth", 6, {"size": 90e-6, "ratio": 3.0, "at_rad": 0.0}))
    hit = np.abs(angle) > 1e-7
    np.testing.assert_allclose(angle[hit], -90e-6, rtol=1e-3)
    assert np.mean(hit) == pytest.approx(0.1, abs=0.05)


def test_a_warm_gear_drifts_late_but_in_the_end_in_proportion():
    machine = built("ur10e")
    q = np.repeat(drawn(machine, 1), 40, axis=0)
    at = stops(q, 0.0, time_s=np.linspace(60.0, 7200.0, 40), warmth_K=5.0)
    angle, _ = angle_about(
        machine, at, 4, shift(machine, Hidden("thermal_zero_drift", 4, {"size": 6e-6, "lag_minutes": 10.0}), at)
    )
    assert angle[0] < 0.2 * 30e-6
    assert (np.diff(angle) > -1e-9).all()
    assert angle[-1] == pytest.approx(30e-6, rel=0.01)


def test_bevels_turn_the_joint_with_its_neighbour_and_pass_its_torque_back():
    machine, c = built("kr210"), 2e-3
    hidden = Hidden("joint_coupling", 5, {"source": 4, "size": c})
    moving = Engine(cause(hidden).built(engine.mechanism(machine), machine))
    plain = Engine(engine.mechanism(machine))
    for q in drawn(machine, 5):
        stop = Stop(q, np.ones(6), start(machine, q), machine.payload_kg)
        plain.rest(stop)
        moving.rest(stop)
        (a4, a5), (b4, b5) = ([e.coordinate(f"joint{j}") for j in (4, 5)] for e in (plain, moving))
        assert b5 - a5 == pytest.approx(c * a4, rel=2e-3)
        torque5 = machine.stiffness[4] * (b5 - c * b4 - q[4])
        back = machine.stiffness[3] * (b4 - a4)
        loads = np.abs(machine.stiffness[3] * (a4 - q[3]))
        assert back == pytest.approx(c * torque5, abs=5e-3 * loads + 0.05 * abs(c * torque5) + 0.5)

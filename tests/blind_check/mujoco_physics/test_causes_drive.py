"""What gears, encoders, belts and bevels do in the engine is what their geometry demands."""

import numpy as np
import pytest
from marks import MUJOCO

from casadical.blind_check.mujoco_physics import Hidden
from casadical.blind_check.mujoco_physics.causes_load import gear_eccentricity

from .machines import angle_about, built, shift, stops

pytestmark = MUJOCO

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


def test_an_eccentric_gear_errs_alike_in_every_turn():
    at = stops([[0, 0, 0, 0, 0, 1.0 + 2 * np.pi * k] for k in (0, 2, -3)], 0.0)
    errors = gear_eccentricity.act(built("kr210"), at, joint=6, size=4e-5, towards=0.3, oval=1e-5, oval_towards=1.0)
    assert abs(errors[0]) > 1e-5
    np.testing.assert_allclose(errors, errors[0])


def test_a_scratch_errs_only_beside_it():
    angle = errors_of_a_turn(Hidden("encoder_pit", 6, {"size": 90e-6, "at_rad": 1.0, "width_rad": 0.5}))
    assert np.abs(angle[np.abs(TURN - 1.0) > 0.5]).max() < 1e-8
    assert np.abs(angle).max() == pytest.approx(90e-6, rel=0.05)


def test_a_damaged_tooth_errs_for_a_tenth_of_each_turn_of_its_pinion():
    angle = errors_of_a_turn(Hidden("damaged_tooth", 6, {"size": 90e-6, "ratio": 3.0, "at_rad": 0.0}))
    hit = np.abs(angle) > 1e-7
    np.testing.assert_allclose(angle[hit], -90e-6, rtol=1e-3)
    assert np.mean(hit) == pytest.approx(0.1, abs=0.05)

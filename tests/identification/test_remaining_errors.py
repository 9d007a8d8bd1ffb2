"""The errors that remain after a calibration: their mean square, where nothing was measured, and the robot file."""

from dataclasses import replace

import arms
import numpy as np
import pytest

from casadical import InputError, identify, read_robot, write_robot
from casadical.effects import GearEccentricity
from casadical.identification.accuracy import predicted
from casadical.identification.remaining_errors import learn_remaining, residuals_and_jacobian
from casadical.measurements.measurements import unmeasured
from casadical.robot.robot import with_joint_harmonics

ARM = arms.six_axis()
SIZE = 3e-4  # rad, of each joint's own error that no calibration has: some tenths of a millimetre


@pytest.fixture(scope="module")
def built():
    """An arm as built whose joints turn by once-a-turn errors."""
    effects = [GearEccentricity(j) for j in range(1, 7)]
    robot = arms.planted(ARM, 4).with_effect(*effects)
    rng = np.random.default_rng(1)
    return robot.with_values({p.name: SIZE * rng.normal() for e in effects for p in e.parameters()})


def errors_at(robot, built, q):
    """Distance between the calibrated and the true arm, with the noise of a measurement, shape (n,) [m]."""
    away = predicted(robot, unmeasured(q))[0] - predicted(built, unmeasured(q))[0]
    return np.linalg.norm(away + arms.NOISE * np.random.default_rng(5).normal(size=away.shape), axis=1)


def expected_at(robot, q):
    """Root mean square of the distance by the robot's own account, shape (n,) [m]: rest^2 + tr(J M J')."""
    remaining = robot.remaining
    model = with_joint_harmonics(robot)
    scale = np.array([model.parameters[name].scale for name in remaining.names])
    J = 1e-3 * residuals_and_jacobian(model, [unmeasured(q)], remaining.names)[1] / scale
    return np.sqrt(remaining.rest**2 + ((J @ remaining.factor) ** 2).sum(axis=(1, 2)))


def rms(values):
    return np.sqrt(np.mean(values**2))


@pytest.fixture(scope="module")
def calibrated(built):
    """Identified from poses of half of the range of each joint, with what remains."""
    found = identify(ARM, arms.positions(built, 0.5 * arms.readings(built, 200, 5), 6), ["kinematic"])
    return replace(found.robot, remaining=learn_remaining(found))


def test_their_mean_square_is_that_of_the_errors_at_poses_like_the_measured_ones(built, calibrated) -> None:
    q = 0.5 * arms.readings(built, 800, 7)
    assert rms(errors_at(calibrated, built, q)) == pytest.approx(rms(expected_at(calibrated, q)), rel=0.2)


def test_they_grow_with_the_errors_where_nothing_was_measured(built, calibrated) -> None:
    inside, outside = 0.5 * arms.readings(built, 400, 7), arms.readings(built, 1600, 8)
    outside = outside[(abs(outside) > 1.5).any(axis=1)]
    assert rms(expected_at(calibrated, outside)) > 1.5 * rms(expected_at(calibrated, inside))
    assert rms(errors_at(calibrated, built, outside)) > 1.5 * rms(errors_at(calibrated, built, inside))
    assert np.mean(errors_at(calibrated, built, outside) <= 2 * expected_at(calibrated, outside)) > 0.9


def test_a_zero_has_no_sign_that_rounding_chooses(calibrated) -> None:
    factor = calibrated.remaining.factor
    assert (factor == 0).any()
    assert not np.signbit(factor[factor == 0]).any()


def test_a_robot_file_keeps_them_and_other_values_have_none(calibrated, tmp_path) -> None:
    write_robot(calibrated, tmp_path / "robot.toml")
    read = read_robot(tmp_path / "robot.toml")
    q = arms.readings(ARM, 20, 3)
    np.testing.assert_allclose(expected_at(read, q), expected_at(calibrated, q), rtol=1e-6)
    assert read.with_values({"a2": 0.501}).remaining is None


def test_too_few_poses_have_none(built) -> None:
    found = identify(ARM, arms.positions(built, arms.readings(built, 25, 5), 6), ["theta*"])
    with pytest.raises(InputError, match=r"need 30 poses with a measured position; there are 25"):
        learn_remaining(found)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("rest = ", "rest = -", r"remaining: rest = -.*; it must be a positive number"),
        ("    [", "    [1.0, ", r"remaining.factor: rows of \[.*\] numbers; all alike"),
        ('"a1"', '"a9"', r"remaining: no parameter 'a9'"),
        ("rest = ", "times = 1.7\nrest = ", r"remaining.times = 1.7: unknown key"),
    ],
)
def test_faults_of_the_file_are_named(calibrated, tmp_path, old, new, message) -> None:
    write_robot(calibrated, tmp_path / "robot.toml")
    text = (tmp_path / "robot.toml").read_text()
    head, remaining = text.split("[remaining]")
    (tmp_path / "robot.toml").write_text(f"{head}[remaining]{remaining.replace(old, new, 1)}")
    with pytest.raises(InputError, match=message):
        read_robot(tmp_path / "robot.toml")

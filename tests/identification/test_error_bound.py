"""The bound of the error that remains holds what it says, grows where nothing was measured, and is kept in the file."""

from dataclasses import replace

import arms
import numpy as np
import pytest

from casadical import InputError, identify, read_robot, write_robot
from casadical.effects import GearEccentricity
from casadical.identification.accuracy import predicted
from casadical.identification.error_bound import learn_bound
from casadical.measurements.measurements import unmeasured
from casadical.robot.error_bound import bound_at

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


@pytest.fixture(scope="module")
def calibrated(built):
    """Identified from poses of half of the range of each joint, with its bound."""
    found = identify(ARM, arms.positions(built, 0.5 * arms.readings(built, 200, 5), 6), ["kinematic"])
    return replace(found.robot, bound=learn_bound(found))


def test_it_holds_about_95_percent_of_the_errors_at_poses_like_the_measured_ones(built, calibrated) -> None:
    q = 0.5 * arms.readings(built, 800, 7)
    errors, bound = errors_at(calibrated, built, q), bound_at(calibrated, q)
    assert 0.92 < np.mean(errors <= bound) < 0.99
    assert bound.mean() < 1.5 * np.quantile(errors, 0.95)


def test_a_zero_has_no_sign_that_rounding_chooses(calibrated) -> None:
    factor = calibrated.bound.factor
    assert (factor == 0).any()
    assert not np.signbit(factor[factor == 0]).any()


def test_it_grows_with_the_errors_where_nothing_was_measured(built, calibrated) -> None:
    inside, outside = 0.5 * arms.readings(built, 400, 7), arms.readings(built, 1600, 8)
    outside = outside[(abs(outside) > 1.5).any(axis=1)]
    grown = bound_at(calibrated, outside)
    assert grown.mean() > 1.5 * bound_at(calibrated, inside).mean()
    assert errors_at(calibrated, built, outside).mean() > 1.5 * errors_at(calibrated, built, inside).mean()
    assert np.mean(errors_at(calibrated, built, outside) <= grown) > 0.9


def test_a_robot_file_keeps_it_and_other_values_have_none(calibrated, tmp_path) -> None:
    write_robot(calibrated, tmp_path / "robot.toml")
    read = read_robot(tmp_path / "robot.toml")
    q = arms.readings(ARM, 20, 3)
    np.testing.assert_allclose(bound_at(read, q), bound_at(calibrated, q), rtol=1e-6)
    moved = read.with_values({"a2": 0.501})
    assert moved.bound is None
    with pytest.raises(InputError, match=r"has no bound; `casadical calibrate` writes one"):
        bound_at(moved, q)


def test_another_tool_and_load_keep_the_bound(calibrated) -> None:
    q = arms.readings(ARM, 50, 3)
    longer = np.array(calibrated.tool.T)
    longer[2, 3] += 0.3
    held = replace(calibrated, tool=replace(calibrated.tool, T=longer))
    assert bound_at(held, q).mean() > bound_at(calibrated, q).mean()


def test_a_joint_that_is_never_moved_leaves_a_bound(built) -> None:
    q, later = (0.5 * arms.readings(built, n, seed) * [1, 1, 1, 1, 1, 0] for n, seed in ((200, 5), (400, 7)))
    found = identify(ARM, arms.positions(built, q, 6), ["kinematic"])
    robot = replace(found.robot, bound=learn_bound(found))
    assert 0.9 < np.mean(errors_at(robot, built, later) <= bound_at(robot, later)) < 0.995


def test_too_few_poses_have_no_bound(built) -> None:
    found = identify(ARM, arms.positions(built, arms.readings(built, 25, 5), 6), ["theta*"])
    with pytest.raises(InputError, match=r"needs 30 poses with a measured position; there are 25"):
        learn_bound(found)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("rest = ", "rest = -", r"bound: rest = -.*; it must be a positive number"),
        ("    [", "    [1.0, ", r"bound.factor: rows of \[.*\] numbers; all alike"),
        ('"a1"', '"a9"', r"bound: no parameter 'a9'"),
    ],
)
def test_faults_of_the_file_are_named(calibrated, tmp_path, old, new, message) -> None:
    write_robot(calibrated, tmp_path / "robot.toml")
    text = (tmp_path / "robot.toml").read_text()
    head, bound = text.split("[bound]")
    (tmp_path / "robot.toml").write_text(f"{head}[bound]{bound.replace(old, new, 1)}")
    with pytest.raises(InputError, match=message):
        read_robot(tmp_path / "robot.toml")

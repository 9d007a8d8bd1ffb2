"""Indices against their definitions, and slopes against finite differences."""

from pathlib import Path

import numpy as np
import pytest
from scipy import linalg

from casadical import InputError, read_campaign_robot
from casadical.core.statistics import thirds
from casadical.effects import Backlash, JointZeroStep
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import Noise, unmeasured
from casadical.pose_selection.information import SPECTRAL, checked, noise_covariance, observability

ROOT = Path(__file__).parents[2]


def test_indices_are_those_of_sun_and_hollerbach() -> None:
    J = np.random.default_rng(0).normal(size=(30, 5)) * [1, 3, 0.2, 1, 7]
    s = linalg.svdvals(J)
    found = observability(J, 10)
    assert found["O1"] == pytest.approx(linalg.det(J.T @ J) ** (1 / 10) / np.sqrt(10), rel=1e-10)
    assert found["O2"] == pytest.approx(1 / np.linalg.cond(J), rel=1e-10)
    assert found["O3"] == pytest.approx(1 / linalg.norm(linalg.pinv(J), 2), rel=1e-10)
    assert found["O4"] == pytest.approx(s.min() ** 2 / s.max(), rel=1e-10)
    assert found["O5"] == pytest.approx(1 / linalg.svdvals(linalg.pinv(J)).sum(), rel=1e-10)


def test_indices_of_too_few_poses_are_zero() -> None:
    J = np.random.default_rng(0).normal(size=(6, 7))
    assert set(observability(J, 2).values()) == {0.0}
    assert set(observability(np.column_stack([J[:, :2], J[:, :1]]), 2).values()) == {0.0}


@pytest.mark.parametrize("index", SPECTRAL)
def test_logarithms_and_slopes(index: str) -> None:
    J = np.random.default_rng(1).normal(size=(20, 4)) * [1, 3, 0.2, 7]
    w = np.linalg.eigvalsh(J.T @ J)
    log, slope = SPECTRAL[index]
    assert np.exp(log(w)) == pytest.approx(observability(J, 1)[index], rel=1e-10)
    h = 1e-6 * w
    numeric = [(log(w + h * e) - log(w - h * e)) / (2 * hk) for e, hk in zip(np.eye(4), h, strict=True)]
    np.testing.assert_allclose(slope(w), numeric, rtol=1e-6, atol=1e-9)


def test_an_unknown_criterion_is_refused_with_those_there_are() -> None:
    with pytest.raises(InputError, match="'E' is not known; allowed: O1, O2"):
        checked("E")


def test_thirds_hold_a_third_each() -> None:
    values = np.random.default_rng(0).permutation(np.arange(300.0))
    assert np.bincount(thirds(values)[0]).tolist() == [100, 100, 100]
    assert (thirds(values)[0] == values // 100).all()


def test_rounding_moves_no_value_over_an_edge() -> None:
    """Of joints that stand at few angles, readings moved by 1e-12 made other parts."""
    rng = np.random.default_rng(0)
    values = rng.integers(0, 5, 301) * 0.5
    for _ in range(5):
        moved = values + 1e-12 * rng.standard_normal(301)
        assert (thirds(moved)[0] == thirds(values)[0]).all()


def test_the_covariance_of_a_point_holds_what_each_joint_repeats() -> None:
    """By finite differences of the positions, of a robot whose model follows two logged columns."""
    robot = read_campaign_robot(ROOT / "problems" / "ur10e").with_effect(Backlash(2), JointZeroStep(3))
    rng = np.random.default_rng(0)
    columns = {"payload_kg": np.full(5, 3.0), "approach2": rng.choice([-1.0, 1.0], 5), "progress": np.linspace(0, 1, 5)}
    m = unmeasured(rng.uniform(-1, 1, (5, 6)), columns)
    step = 1e-6 * np.eye(6)
    there = [[predicted(robot, unmeasured(m.q + way * s, columns))[0] for s in step] for way in (1, -1)]
    J = (np.array(there[0]) - np.array(there[1])).transpose(1, 2, 0) / 2e-6
    found = noise_covariance(robot, m, Noise(2e-5, 1e-5))
    expected = (0.02**2) * np.eye(3) + (J * 1e-2) @ (J * 1e-2).transpose(0, 2, 1)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-9)

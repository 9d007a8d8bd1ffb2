"""Corrected positions and joint targets, against finite differences, plain formulas and the paper's robot itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from casadical import read_problem
from casadical.compensator import Backprop, Compensator
from casadical.core.errors import InputError
from casadical.export.correction import Compensated, compensated

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def parts(calibrated):
    """The HH800's identification, a compensator that is not null, and the poses of the report."""
    problem, results, _ = calibrated("hh800")
    result = results["SKCM"]
    m = problem.sets["train"][0]
    # A residual twice as smooth as life, so that the network is kept and has something to say.
    smooth = np.column_stack([np.sin(m.q[:, 0]), np.cos(m.q[:, 1]), 0.5 * np.sin(m.q[:, 2])])
    compensator = Compensator.fit(m.q, smooth, trainer=Backprop(steps=400), seed=1)
    assert compensator.helps
    return result, compensator, problem.sets["report"][0].q


@pytest.fixture(scope="module")
def whole(parts) -> Compensated:
    return compensated(*parts[:2])


def turn(R: np.ndarray, other: np.ndarray) -> float:
    """Angle between two orientations [rad], by the trace."""
    return float(np.arccos(np.clip((np.trace(R.T @ other) - 1) / 2, -1, 1)))


def test_position_is_kinematics_plus_network(parts, whole: Compensated) -> None:
    result, compensator, q = parts
    expected = result.predict(q)[0] + 1e-3 * compensator.correction_mm(q)
    assert whole.position(q) == pytest.approx(expected, abs=1e-12)
    assert np.abs(whole.position(q) - result.predict(q)[0]).max() > 2e-4


def test_the_casadi_function_says_the_same(parts, whole: Compensated) -> None:
    f, q = whole.function, parts[2][:7]
    assert (f.name(), f.name_in(), f.name_out()) == ("compensated", ["q"], ["p", "R"])
    for row in q:
        p, R = f(row)
        assert p.full().ravel() == pytest.approx(whole.position(row)[0], abs=1e-12)
        assert R.full().T @ R.full() == pytest.approx(np.eye(3), abs=1e-12)


def test_the_null_compensator_changes_nothing(parts) -> None:
    result, compensator, q = parts
    null = compensated(result, replace(compensator, network=None))
    assert null.position(q) == pytest.approx(result.predict(q)[0], abs=1e-15)


@pytest.mark.parametrize("orientation", [True, False])
def test_joint_targets_bring_the_tool_where_the_nominal_model_says(parts, whole: Compensated, orientation) -> None:
    """By the robots' own functions, not by what the result says of itself."""
    result, _, q = parts
    found = whole.correct_joints(q, orientation=orientation)
    nominal, before, worst = result.placed, 0.0, 0.0
    phi = nominal.parameters.values
    for asked, target in zip(q[found.converged], found.q[found.converged], strict=True):
        p, R = (x.full() for x in nominal.pose(asked, phi))
        before = max(before, np.linalg.norm(whole.position(asked)[0] - p.ravel()))
        assert np.linalg.norm(whole.position(target)[0] - p.ravel()) < 1e-6
        worst = max(worst, turn(whole.function(target)[1].full(), R))
    assert before > 5e-3
    assert (worst < 2e-6) == orientation
    assert found.converged.sum() >= 0.95 * len(q)
    assert found.change == pytest.approx(found.q - q)


def test_without_orientation_the_change_is_the_smallest(parts, whole: Compensated) -> None:
    """To first order it has no part in the null space of the position's Jacobian, taken by finite differences."""
    q = parts[2][:5]
    found = whole.correct_joints(q, orientation=False)
    assert np.all(np.linalg.norm(found.change, axis=1) <= np.linalg.norm(whole.correct_joints(q).change, axis=1))
    for row, change in zip(q, found.change, strict=True):
        step = 1e-6 * np.eye(6)
        J = (whole.position(row + step) - whole.position(row - step)).T / 2e-6
        null_space = np.linalg.svd(J)[2][3:]
        assert np.abs(null_space @ change).max() < 0.02 * np.linalg.norm(change)


def test_near_singular_poses_are_flagged_and_their_targets_stay_near(parts, whole: Compensated) -> None:
    q = parts[2][:20].copy()
    q[:10, 4] = 0.0  # axes 4 and 6 in line
    found = whole.correct_joints(q)
    assert found.near_singular[:10].all()
    assert not found.near_singular[10:].all()
    assert np.all(np.isfinite(found.q))
    assert np.abs(found.change).max() < 1.0 + 1e-12  # 20 clamped steps of 0.05
    missed = ~found.converged
    assert missed[:10].any()
    assert "near a singular pose" in found.verdict
    assert np.all(found.left[missed] + found.left_angle[missed] > 1e-6)
    assert np.all(whole.correct_joints(q, orientation=False).converged)


def test_one_function_for_the_controller(parts, whole: Compensated) -> None:
    """Its remainder after four steps is what the robots say it is."""
    result, _, q = parts
    f = whole.correction()
    assert (f.name(), f.name_in(), f.name_out()) == ("correct_joints", ["q"], ["q_target", "left"])
    assert f.is_a("SXFunction")
    assert f.size_out("left") == (6, 1)
    assert whole.correction(orientation=False, steps=1).size_out("left") == (3, 1)
    target, left = (x.full() for x in f.map(len(q))(q.T))
    nominal = result.placed
    goal = nominal.position.map(len(q))(q.T, nominal.parameters.values).full().T
    remains = (goal - whole.position(target.T)).T
    assert remains == pytest.approx(left[:3], abs=1e-12)
    assert np.median(np.abs(left)) < 1e-8
    one = whole.correction(steps=1).map(len(q))(q.T)[1].full()
    assert np.median(np.abs(one)) > 10 * np.median(np.abs(left))


def test_it_generates_c(whole: Compensated, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    whole.correction().generate("correct_joints.c")
    assert "correct_joints" in (tmp_path / "correct_joints.c").read_text()


def test_a_planar_arm_gets_positions_only(calibrated) -> None:
    """Two joints reach two of three coordinates: the height is left, and said to be left."""
    _, results, _ = calibrated("planar")
    q = read_problem(ROOT / "problems" / "planar").sets["report"][0].q
    random = np.random.default_rng(0)
    noise = Compensator.fit(random.normal(size=(20, 2)), random.normal(size=(20, 3)), trainer=Backprop(steps=5))
    assert not noise.helps
    found = compensated(results["KM"], noise).correct_joints(q)
    assert found.left.max() < 1e-4
    assert not found.left_angle.any()


def test_refusals(parts, calibrated) -> None:
    result, compensator, q = parts
    with pytest.raises(InputError, match="belongs to another robot"):
        compensated(calibrated("planar")[1]["KM"], compensator)
    with pytest.raises(InputError, match=r"nominal: .* has 2 joints"):
        compensated(result.robot, compensator, nominal=calibrated("planar")[0].robot)
    with pytest.raises(InputError, match="nominal="):
        compensated(result.robot, compensator).correct_joints(q)
    whole = compensated(result, compensator)
    with pytest.raises(InputError, match=r"shape \(n, 6\)"):
        whole.correct_joints(q[:, :5])
    with pytest.raises(InputError, match="finite"):
        whole.correct_joints(np.where(np.arange(6) == 2, np.nan, q))


def test_given_the_robot_and_its_nominal_model_it_is_the_same(parts, whole: Compensated) -> None:
    result, compensator, q = parts
    other = compensated(result.robot, compensator, nominal=result.placed)
    assert other.correct_joints(q[:5]).q == pytest.approx(whole.correct_joints(q[:5]).q, abs=1e-12)
    assert isinstance(whole.function, ca.Function)

"""Predicted positions are as unsure as they are wrong, also where the measured poses determined nothing."""

import sys
from dataclasses import replace
from pathlib import Path

import arms
import numpy as np
import pytest

from casadical import identify
from casadical.effects import GearEccentricity
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import unmeasured
from casadical.robot.robot import Covariance, Knowledge

sys.path.append(str(Path(__file__).parents[2] / "docs" / "studies"))
import prediction_coverage as study

ARM = arms.six_axis()
TURNING = study.turning(study.arm())


@pytest.fixture(scope="module")
def built():
    return arms.planted(ARM, 4)


def sigma(result, q):
    """Standard deviation of predicted positions, shape (n,) [m]."""
    return np.sqrt(np.trace(result.predict(q)[1], axis1=1, axis2=2))


def identified_only(result, q):
    """Covariance of positions by the identified parameters alone, shape (n, 3, 3) [m^2]."""
    names, step = result.names, 1e-6
    columns = []
    for name in names:
        p = result.start.parameters[name]
        sides = []
        for sign in (1, -1):
            values = dict(zip(names, result.estimate, strict=True))
            values[name] += sign * step * p.scale
            sides.append(predicted(result.start, unmeasured(q), values)[0])
        columns.append((sides[0] - sides[1]) / (2 * step * p.scale))
    J = np.stack(columns, axis=2)
    return np.asarray(J @ np.nan_to_num(result.covariance) @ J.transpose(0, 2, 1))


@pytest.mark.slow
@pytest.mark.parametrize("design", ["one plane", "few poses", "one pose", "+-180 deg", "half the workspace"])
def test_intervals_hold_the_truth_anywhere(design) -> None:
    """Fewer designs and one size of errors of those in docs/studies/prediction_coverage.py, and one robot."""
    cases = [study.identified(TURNING, (design, 1.0), np.random.default_rng([3, n])) for n in range(4)]
    every, only = (
        {key: np.mean([c[key] for c in found]) for key in found[0]}
        for found in (
            [study.held(r, r.predict(q)[1], miss) for r, q, miss in cases],
            [study.held(r, identified_only(r, q), miss) for r, q, miss in cases],
        )
    )
    assert every["held"] > 0.9
    assert every["sigma"] < 4 * every["error"]  # and they are not merely wide
    if design not in ("few poses", "half the workspace"):
        assert only["held"] < 0.6  # by the identified parameters alone


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.1, 2.0])
@pytest.mark.parametrize("design", ["one pose", "+-180 deg"])
def test_how_well_a_robot_is_built_is_learnt_from_what_the_poses_determine(design, size) -> None:
    """Errors far from the priors' size, of the arm and of where base and tool stand in the file (see the study)."""
    cases = [study.identified(TURNING, (design, size), np.random.default_rng([5, n])) for n in range(4)]
    found = [study.held(r, r.predict(q)[1], miss) for r, q, miss in cases]
    assert np.mean([c["held"] for c in found]) > 0.85
    assert np.median([c["sigma"] / c["error"] for c in found]) < 5


def test_where_poses_were_measured_nothing_is_added(built) -> None:
    """Readings of one plane: what they do not tell of the robot they do not need."""
    q = arms.readings(built, 60, 5)
    q[:, [0, 3, 5]] = q[0, [0, 3, 5]]
    result = identify(ARM, arms.positions(built, q, 6), ["kinematic"])
    assert sigma(result, q).max() < 3 * arms.NOISE
    assert sigma(result, arms.readings(built, 60, 7)).mean() > 30 * arms.NOISE


def test_where_all_is_identified_the_covariance_is_that_of_the_identified(built) -> None:
    robot = replace(ARM, base=replace(ARM.base, unknown="none"))
    q, probe = arms.readings(built, 60, 5), arms.readings(built, 20, 7)
    result = identify(robot, arms.positions(built, q, 6), ["theta*"])
    held = [p.name for p in robot.parameters if p.name not in result.names]
    surely = replace(result, start=known_exactly(result.start, held))
    problem = replace(result.problem, robot=surely.start)
    alone = replace(surely, problem=problem).predict(probe)[1]
    np.testing.assert_allclose(alone, identified_only(result, probe), rtol=1e-4, atol=1e-13)
    assert (sigma(result, probe) > 3 * np.sqrt(np.trace(alone, axis1=1, axis2=2))).all()


def known_exactly(robot, names):
    """The robot, of which a file says that these parameters have no variance to speak of."""
    C = Covariance(tuple(names), 1e-24 * np.eye(len(names)))
    return replace(robot, knowledge=Knowledge((C,)))


def test_what_the_robots_file_knows_counts_for_its_priors(built) -> None:
    """One sigma of a held length, known from elsewhere: along the last axis it is that of the point, to the digit."""
    q, probe = arms.readings(built, 60, 5), arms.readings(built, 5, 7)
    found = []
    for error in (1e-3, 2e-3):
        names = [p.name for p in ARM.parameters if p.group == "geometry"]
        variances = [error**2 if n == "d6" else 1e-24 for n in names]
        robot = replace(ARM, knowledge=Knowledge((Covariance(tuple(names), np.diag(variances)),)))
        robot = replace(robot, base=replace(robot.base, unknown="none"), tool=replace(robot.tool, unknown="none"))
        result = identify(robot, arms.positions(ARM, q, 6), ["theta2"])
        found.append(sigma(result, probe))
    assert found[0] == pytest.approx(1e-3, rel=0.3)
    assert found[1] == pytest.approx(2 * found[0], rel=0.02)


def test_a_prior_counts_from_its_mean_wherever_the_robots_file_begins(built) -> None:
    """Readings of one plane; one prior of an effect, whose sizes are 0 in one file, and the prior's in another."""
    effect = GearEccentricity(2)
    told = {p.name: 1e-2 for p in effect.parameters()}
    q, probe = arms.readings(built, 60, 5), arms.readings(built, 20, 7)
    q[:, [0, 3, 5]] = q[0, [0, 3, 5]]
    m = arms.positions(built.with_effect(effect).with_values(told), q, 6)
    empty = ARM.with_effect(effect)
    priors = {name: (mean, 1e-3) for name, mean in told.items()}
    free = ["kinematic", effect.label]
    found = [sigma(identify(robot, m, free, priors=priors), probe) for robot in (empty, empty.with_values(told))]
    assert found[0] == pytest.approx(found[1], rel=2e-5)


def test_held_parameters_move_identified_ones() -> None:
    """A straight arm of two links in a plane, the second reading fixed: only the sum of its lengths can be told.

    With the joint bent by b the end is off by e (cos b - 1, sin b) if the second length is e longer and the first e
    shorter: the variance at the pose is that of the length times 2 (1 - cos b).
    """
    flat = replace(arms.planar(), tool=replace(arms.planar().tool, unknown="position"))
    names = [p.name for p in flat.parameters]
    C = Covariance(tuple(names), np.diag([1e-6 if n == "tool_x" else 1e-24 for n in names]))
    q = np.column_stack([np.linspace(-1, 1, 40), np.zeros(40)])
    robot = replace(flat, knowledge=Knowledge((C,)))
    result = identify(robot, arms.positions(flat, q, 1), ["a1", "theta1"])
    bent = np.array([0.3, 1.0, 2.0])
    probe = np.column_stack([np.zeros(3), bent])
    assert sigma(result, probe) == pytest.approx(1e-3 * np.sqrt(2 * (1 - np.cos(bent))), rel=0.02)


def test_a_frame_that_is_not_determined_stays_where_it_was(built) -> None:
    q = np.tile(arms.readings(built, 1, 5), (30, 1))
    result = identify(ARM, arms.positions(built, q, 6), ["kinematic"])
    np.testing.assert_allclose(result.start.base.T[:3, :3], np.eye(3), atol=1e-6)
    np.testing.assert_allclose(result.start.tool.T, ARM.tool.T, atol=0.02)

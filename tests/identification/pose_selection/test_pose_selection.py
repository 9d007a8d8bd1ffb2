"""Selections: what they promise against identifications, their circumstances, and their order."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import elbow, planar, positions, readings

import casadical
from casadical import InputError, Joint, Robot, identify
from casadical.core.linear_gaussian.noise import whitening_of
from casadical.core.reporting.result import plain_text
from casadical.effects import Backlash, FrameDrift, PayloadError, ThermalGrowth
from casadical.effects.instrument import Session
from casadical.identification.accuracy import errors
from casadical.identification.figures import fit_quality
from casadical.identification.pose_selection import Circumstances, Noise, Workspace, forecast
from casadical.identification.pose_selection.candidates import (
    Candidates,
    _later_column,
    candidates_at,
    draw,
    expected,
    later_poses,
    noise_covariance,
    one_turn,
    scaled_jacobian,
    timeline,
)
from casadical.identification.pose_selection.design_problem import _allowed
from casadical.identification.pose_selection.planning import MeasurementPlan
from casadical.identification.pose_selection.pose_search import Forecast, select_poses
from casadical.identification.pose_selection.selection import TIME_PARTS, in_measuring_order, travel, travel_distances
from casadical.identification.pose_selection.workspace import read_workspace
from casadical.identification.prior import carry_over
from casadical.robot.robot import Covariance, Knowledge

ROBOT = planar()
SIGMA = 3e-5
QUICK = {"pool": 200, "restarts": 1}


@pytest.fixture(scope="module")
def robot():
    return elbow()


@pytest.fixture(scope="module")
def chosen(robot):
    return select_poses(robot, None, 25, noise=Noise(SIGMA), **QUICK)


def test_expected_standard_errors_are_those_that_an_identification_reports(robot, chosen) -> None:
    results = [
        identify(robot, replace(positions(robot, chosen.q, s, SIGMA), sigma=SIGMA), priors=False) for s in range(3)
    ]
    for result in results:
        assert result.names == chosen.names
        scale = np.sqrt(result.variance)
        np.testing.assert_allclose(result.standard_errors / scale, chosen.standard_errors, rtol=0.02)
    q = readings(robot, 20, 9)
    _, covariance = results[0].predict(q)
    mean = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / results[0].variance)
    np.testing.assert_allclose(chosen.expected_error(expected(robot, q, {}, "test")), mean, rtol=0.02)


def test_noise_of_joints_is_that_of_moved_readings(robot) -> None:
    q = readings(robot, 2, 3)
    m = expected(robot, q, {}, "test")
    rng = np.random.default_rng(0)
    jitter = 1e-5 * rng.normal(size=(4000, *q.shape))
    moved = 1e3 * expected(robot, (q + jitter).reshape(-1, 6), {}, "moved").position.reshape(-1, 2, 3)
    spread = np.array([np.cov(moved[:, k].T) for k in range(2)])
    found = noise_covariance(robot, m, Noise(1e-9, 1e-5))
    np.testing.assert_allclose(found, spread, atol=0.06 * np.abs(spread).max())
    J = scaled_jacobian(robot, ("d4", "theta5"), m)
    W = np.linalg.inv(found)
    A = whitening_of(found)[0] @ J
    np.testing.assert_allclose(A.transpose(0, 2, 1) @ A, J.transpose(0, 2, 1) @ W @ J, rtol=1e-9)


def test_scaled_jacobian_against_finite_differences(robot) -> None:
    names = ("a2", "theta3", "c2", "tool_x", "base_rz")
    q = readings(robot, 4, 1)
    J = scaled_jacobian(robot, names, expected(robot, q, {}, "test"))
    for k, name in enumerate(names):
        p = robot.parameters[name]
        h = 1e-3 * p.scale
        ends = [robot.with_values({name: p.value + s * h}) for s in (1, -1)]
        high, low = (expected(end, q, {}, "test").position for end in ends)
        np.testing.assert_allclose(J[:, :, k], 1e3 * (high - low) / 2e-3, rtol=1e-4, atol=1e-6)


def test_chosen_poses_are_better_than_random_ones(robot) -> None:
    found = select_poses(robot, None, 20, **QUICK)
    rng = np.random.default_rng(5)
    random = [replace(found, m=expected(robot, draw(robot, 20, Workspace(), rng), {}, "random")) for _ in range(20)]
    assert found.accuracy < min(s.accuracy for s in random)


def test_given_candidates_are_chosen_from(robot) -> None:
    q = readings(robot, 60, 2)
    found = select_poses(robot, q, 20)
    assert {tuple(v) for v in found.q} <= {tuple(v) for v in q}
    assert len({tuple(v) for v in found.q}) == 20


def test_poses_keep_their_distance_or_may_be_chosen_again(robot) -> None:
    q = readings(robot, 60, 5)
    far = select_poses(robot, q, 12, min_distance=0.3).q
    lower, upper = robot.limits
    share = (np.abs(far[:, None] - far) / (upper - lower)).max(axis=2)
    assert share[~np.eye(12, dtype=bool)].min() > 0.3
    few = select_poses(robot, q[:8], 12, min_distance=None)
    assert len(few.q) == 12 > len(np.unique(few.q, axis=0))


def test_measured_poses_count_and_are_not_measured_again(robot) -> None:
    before = positions(robot, readings(robot, 15, 3), 0, SIGMA)
    found = select_poses(robot, np.concatenate([before.q, readings(robot, 80, 4)]), 10, measured=before)
    distance = np.abs(found.q[:, None] - before.q[None]).max(axis=2)
    assert distance.min() > 1e-6
    alone = replace(found, measured=None)
    assert found.accuracy < alone.accuracy
    sigma = Noise().sigma
    seen = positions(robot, np.concatenate([found.q, before.q]), 1, sigma)
    both = identify(robot, replace(seen, sigma=sigma), priors=False)
    assert both.names == found.names
    np.testing.assert_allclose(both.standard_errors / np.sqrt(both.variance), found.standard_errors, rtol=0.02)


def test_effects_get_the_circumstances_that_tell_them(robot) -> None:
    arm = robot.with_effect(Backlash(2), PayloadError())
    found = select_poses(arm, None, 25, interest=["backlash@2", "payload_error"], **QUICK)
    assert set(found.m.conditions["approach2"]) == {-1.0, 1.0}
    assert set(found.m.conditions["payload_kg"]) == {0.0, 10.0}
    assert "backlash@2.half" in found.names
    assert {"approach2", "payload_kg"} <= set(found.table.columns)
    half = replace(found.m, conditions=found.m.conditions | {"payload_kg": np.full(25, 2.5)})
    assert set(replace(found, m=half).table["payload_kg"]) == {2.5}


@pytest.mark.slow
def test_groups_measure_each_reading_in_every_way(robot) -> None:
    arm = robot.with_effect(Backlash(2), Backlash(3))
    ways = Circumstances(payloads=(0.0, 4.0, 10.0), every_payload=True, both_approaches=True, repeats=2)
    found = select_poses(arm, None, 12, circumstances=ways, pool=40, restarts=1)
    assert len(found) == 12 * 3 * 2 * 2
    _, group = np.unique(found.q, axis=0, return_inverse=True)
    for k in range(12):
        mine = group.ravel() == k
        seen = [tuple(v) for v in zip(*(found.m.conditions[c][mine] for c in ("payload_kg", "approach2")), strict=True)]
        assert sorted(set(seen)) == [(kg, side) for kg in (0.0, 4.0, 10.0) for side in (-1.0, 1.0)]
        assert len(seen) == 12
        both = found.m.conditions["approach2"][mine] * found.m.conditions["approach3"][mine]
        assert len(set(both)) == 1  # all joints turn round together
    # A payload is mounted once a pass.
    assert np.count_nonzero(np.diff(found.m.conditions["payload_kg"])) == 5


def test_time_goes_with_the_order(robot) -> None:
    arm = robot.with_effect(FrameDrift(), ThermalGrowth(None, 600.0))
    found = select_poses(arm, None, 30, circumstances=Circumstances(warmup_K=5.0), **QUICK)
    np.testing.assert_allclose(found.m.conditions["progress"], np.arange(30) / 29)
    assert (np.diff(found.m.conditions["warmth_600s"]) > 0).all()
    assert "progress" not in found.table
    two_hours = timeline(["temperature_degC"], np.linspace(0, 1, 9), 240, Circumstances())["temperature_degC"]
    np.testing.assert_allclose(two_hours, 20 + 5 * (1 - np.exp(-np.linspace(0, 120, 9) / 35)), atol=1e-3)


def test_later_poses_have_the_campaigns_values_or_none() -> None:
    rng, warm = np.random.default_rng(0), np.zeros(50, dtype=bool)
    assert set(_later_column("humidity", np.array([1.0, 3.0]), warm, np.zeros(1), rng)) == {1.0, 3.0}
    assert not _later_column("humidity", None, warm, np.zeros(1), rng).any()


def test_six_numbers_of_poses_are_shown_from_the_first_to_the_last() -> None:
    poses = np.arange(10, 41)
    text = plain_text(MeasurementPlan(Forecast(poses, 1e-3 / np.sqrt(poses))).blocks())
    assert re.findall(r"(\d+): 0\.\d{4}", text) == ["10", "16", "22", "28", "34", "40"]


def test_candidates_of_another_arm_or_without_numbers_are_refused(robot) -> None:
    for q in (np.zeros((5, 3)), np.full((5, 6), np.nan), np.zeros((2, 2, 6))):
        with pytest.raises(InputError, match="candidates of shape"):
            _allowed(robot, q, Workspace())


def test_a_column_that_cannot_be_planned_is_named(robot) -> None:
    class Damp(Backlash):
        @property
        def conditions(self):
            return ("humidity",)

    arm = robot.with_effect(Damp(2))
    with pytest.raises(InputError, match="'humidity' is needed by an effect and cannot be planned"):
        candidates_at(arm, readings(arm, 3, 0), Circumstances(), 3, np.random.default_rng(0))


def test_poses_are_chosen_between_limits(robot) -> None:
    lower, upper = np.full(6, -1.0), np.full(6, 1.2)
    found = casadical.select_poses(robot, (lower, upper), 20, **QUICK)
    assert ((found.q >= lower) & (found.q <= upper)).all()
    same = select_poses(robot, Workspace(lower, upper), 20, **QUICK)
    np.testing.assert_array_equal(same.q, found.q)
    with pytest.raises(InputError, match="limits of 3 parts"):
        select_poses(robot, (lower, upper, upper), 20)
    with pytest.raises(InputError, match="chosen among 20; allowed"):
        select_poses(robot, 20, 20)
    with pytest.raises(InputError, match="two workspaces"):
        select_poses(robot, Workspace(), 20, workspace=Workspace())


def test_too_few_poses_are_refused(robot) -> None:
    with pytest.raises(InputError, match=r"5 poses give 15 numbers, but \d+ parameters"):
        select_poses(robot, None, 5, **QUICK)
    with pytest.raises(InputError, match="at least one pose"):
        select_poses(robot, None, 0)
    with pytest.raises(InputError, match=r"candidates of shape \(4, 5\)"):
        select_poses(robot, np.zeros((4, 5)), 20)
    with pytest.raises(InputError, match="none of the 4 candidates is allowed"):
        select_poses(robot, np.full((4, 6), 3.0), 20)


def test_an_order_of_little_travel(robot, chosen) -> None:
    ordered = chosen.ordered()
    assert {tuple(v) for v in ordered.q} == {tuple(v) for v in chosen.q}
    assert travel(robot, ordered.q) < 0.75 * travel(robot, chosen.q)
    assert ordered.accuracy == pytest.approx(chosen.accuracy, rel=1e-9)


def test_travel_is_of_the_joint_that_turns_most(robot) -> None:
    q = np.zeros((3, 6))
    q[1, 2], q[1, 4], q[2, 0] = 0.5, -0.7, 1.0
    assert travel(robot, q) == pytest.approx(0.7 + 1.0)
    np.testing.assert_allclose(travel_distances(robot, q), [[0, 0.7, 1], [0.7, 0, 1], [1, 1, 0]])


def test_a_forecast_begins_with_what_was_measured(robot) -> None:
    before = positions(robot, readings(robot, 20, 3), 0, SIGMA)
    seen = forecast(robot, 40, measured=before, noise=Noise(SIGMA), pool=200)
    assert seen.poses[0] == 20
    assert seen.poses[-1] == 40
    assert (np.diff(seen.error) < 0).all()
    # Its first value: what an identification of the measured poses says of poses like these.
    result = identify(robot, replace(before, sigma=SIGMA), priors=False)
    _, covariance = result.predict(readings(robot, 500, 7))
    now = np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean() / result.variance)
    assert seen.error[0] == pytest.approx(now, rel=0.05)


def test_stopping_rules() -> None:
    poses = np.arange(20, 100)
    seen = Forecast(poses, 1e-4 * np.sqrt(20 / poses))
    assert seen.enough(5e-5) == 80
    assert seen.enough(1e-6) is None
    # sqrt(n / (n + 10)) > 0.9 from n = 42.6 on.
    assert seen.stop() == 43
    assert seen.stop(0.001, 10) is None


@pytest.fixture(scope="module")
def known(robot):
    """The arm as the fleet of its type knows it: 0.05 mm and mrad from robot to robot, compliances by a tenth."""
    own = [p for p in robot.parameters if p.group in ("geometry", "compliance")]
    wide = [0.1 * p.value if p.group == "compliance" else 0.05 * p.scale for p in own]
    block = Covariance(tuple(p.name for p in own), np.diag(np.square(wide)))
    fleet = replace(robot, knowledge=Knowledge((block,), "20 robots of the fleet", robots=20))
    spread = dict(zip((p.name for p in own), wide, strict=True))
    return *carry_over(robot, fleet, ("all",)), spread


@pytest.mark.slow
def test_with_a_prior_few_poses_are_as_good_as_promised(known) -> None:
    robot, prior, spread = known
    found = select_poses(robot, None, 8, noise=Noise(SIGMA), prior=prior, **QUICK)
    assert len(found.names) > 3 * 8 > len(found.names) - len(spread)  # too few numbers without it
    other = expected(robot, readings(robot, 60, 9), {}, "test")
    squares, told, rng = [], [], np.random.default_rng(0)
    for s in range(20):
        built = robot.with_values({n: robot.parameters[n].value + w * rng.normal() for n, w in spread.items()})
        m = replace(positions(built, found.q, s, SIGMA), sigma=SIGMA)
        result = identify(robot, m, prior=prior)
        assert result.variance >= 1
        _, covariance = result.predict(other.q)
        told.append(np.trace(covariance, axis1=1, axis2=2))
        mean = np.sqrt(told[-1] / result.variance)
        np.testing.assert_allclose(found.expected_error(other), mean, rtol=0.05)
        squares.append(np.mean(errors(result.robot, positions(built, other.q, 0, 0.0)) ** 2))
    promised = np.sqrt(np.mean(found.expected_error(other) ** 2))
    assert np.sqrt(np.mean(squares)) == pytest.approx(promised, rel=0.15)
    assert np.sqrt(np.mean(told)) == pytest.approx(promised, rel=0.15)


def test_so_few_poses_do_not_tell_the_noise_beside_a_prior(known) -> None:
    robot, prior, _ = known
    few, many = (readings(robot, n, 3) for n in (8, 60))
    unsure = identify(robot, positions(robot, few, 0, SIGMA), prior=prior)
    assert unsure.noise_is_assumed
    assert unsure.sigmas[0][0] > 0.5 * SIGMA  # not what little the prior leaves
    assert "an upper bound: so few poses do not determine it beyond the prior" in str(fit_quality(unsure))
    declared = identify(robot, replace(positions(robot, few, 0, SIGMA), sigma=SIGMA), prior=prior)
    plenty = identify(robot, positions(robot, many, 0, SIGMA), prior=prior)
    for result in (declared, plenty):
        assert not result.noise_is_assumed
        assert "an upper bound" not in str(fit_quality(result))
    assert plenty.sigmas[0][0] == pytest.approx(SIGMA, rel=0.25)


def test_with_a_prior_fewer_poses_are_enough(known, robot) -> None:
    ready, prior, _ = known
    alone = forecast(robot, 40, noise=Noise(SIGMA), pool=100)
    ahead = forecast(ready, 40, noise=Noise(SIGMA), pool=100, prior=prior)
    few, many = ahead.enough(6e-5), alone.enough(6e-5)
    assert few is not None
    assert many is not None
    assert few < 0.8 * many


@pytest.mark.slow
def test_what_an_instrument_will_read_is_the_error_with_the_noise_of_instrument_and_joints() -> None:
    """Forty campaigns at the chosen poses, each identified and read again with the same noise at other poses."""
    robot, sigma, rho = planar(), 2e-5, 8e-5
    chosen = select_poses(robot, None, n=6, noise=Noise(sigma, rho), seed=0, pool=200)
    rng = np.random.default_rng(0)

    def read(q, seed):
        return replace(positions(robot, q + rho * rng.normal(size=q.shape), seed, sigma), q=q)

    squares = []
    for seed in range(40):
        found = identify(robot, read(chosen.q, seed), chosen.names, priors=False)
        squares.append(np.mean(errors(found.robot, read(chosen.task.q, 100 + seed)) ** 2))
    assert chosen.reading_error is not None
    assert np.sqrt(np.mean(squares)) == pytest.approx(chosen.reading_error, rel=0.06)
    assert chosen.reading_error > 1.3 * chosen.accuracy


def test_a_full_stroke_counts_as_half_a_turn() -> None:
    robot = Robot("slide", (Joint(), Joint(kind="prismatic", lower=0.1, upper=0.6)))
    q = np.array([[0.0, 0.1], [0.5, 0.6], [3.0, 0.35]])
    assert travel_distances(robot, q) == pytest.approx(np.array([[0, np.pi, 3], [np.pi, 0, 2.5], [3, 2.5, 0]]))


def test_one_turn_is_the_nearest_to_zero() -> None:
    far, near, slide = Joint(lower=3.5, upper=10.0), Joint(lower=-8.0, upper=7.0), Joint(kind="prismatic", upper=8.0)
    ranges = [(j.lower, j.upper) for j in one_turn(Robot("arm", (far, near, slide))).joints]
    assert ranges == [pytest.approx((3.5, 3.5 + 2 * np.pi)), (-np.pi, np.pi), (slide.lower, 8.0)]


@pytest.mark.parametrize(("n", "candidates"), [(5, 100), (50, 150)])
def test_the_pool_is_three_times_what_is_chosen_at_least(n: int, candidates: int) -> None:
    with pytest.raises(InputError, match=f"the {candidates} candidates lie too near"):
        select_poses(ROBOT, None, n, pool=100, min_distance=100.0)


def test_poses_stay_in_their_part_of_the_campaign() -> None:
    rng = np.random.default_rng(0)
    progress = np.array([1.0, 0.0, 0.3, 0.9, 0.05, 0.6])
    q = rng.uniform(-1, 1, (6, ROBOT.n))
    m = in_measuring_order(ROBOT, Candidates(q, {"progress": progress[:, None]}), Circumstances(), travel=False)
    order = [int(np.flatnonzero((q == row).all(axis=1))[0]) for row in m.q]
    parts = np.minimum((TIME_PARTS * progress).astype(int), TIME_PARTS - 1)
    assert order == sorted(range(6), key=lambda k: (parts[k], k))


def test_limits_that_leave_one_reading_leave_nothing(tmp_path: Path) -> None:
    low, high = (float(np.rad2deg(v)) for v in (ROBOT.joints[0].lower, ROBOT.joints[0].upper))
    middle = 0.5 * (low + high)
    path = tmp_path / "room.toml"
    path.write_text(f"casadical = 1\n[[joint]]\nnumber = 1\nlimits_deg = [{middle}, {middle}]\n")
    with pytest.raises(InputError, match=r"joint 1: nothing of its range is left"):
        read_workspace(path, ROBOT)
    path.write_text(f"casadical = 1\n[[joint]]\nnumber = 1\nlimits_deg = [{middle}, {middle + 1}]\n")
    assert read_workspace(path, ROBOT).upper[0] == pytest.approx(np.deg2rad(middle + 1))


def test_the_table_for_the_robot_tells_micrometres() -> None:
    found = select_poses(ROBOT, None, 3, pool=12, restarts=1)
    assert found.m.position is not None
    shown = found.table[["nominal_x_mm", "nominal_y_mm", "nominal_z_mm"]].to_numpy()
    assert (np.round(shown, 3) == shown).all()
    np.testing.assert_allclose(shown, 1e3 * found.m.position, rtol=0, atol=5.001e-4)
    assert list(found.table.columns[:3]) == ["pose", "q1_deg", "q2_deg"]


def test_half_of_the_later_poses_lie_within_the_campaigns_ranges() -> None:
    own = expected(ROBOT, np.random.default_rng(0).uniform(0.2, 0.6, (5, ROBOT.n)), {}, "campaign")
    drawn, repeated, _ = later_poses(ROBOT, own, np.ones(5, dtype=bool), (), 400, 0)
    new = drawn.q[repeated < 0]
    within = ((new >= own.q.min(axis=0)) & (new <= own.q.max(axis=0))).all(axis=1)
    assert 200 <= within.sum() < 220


def test_poses_are_planned_for_the_last_session() -> None:
    arm = ROBOT.with_effect(*(Session(None, which=name) for name in "bcd"))
    columns = candidates_at(arm, np.zeros((4, ROBOT.n)), Circumstances(), 4, np.random.default_rng(0)).conditions
    assert {name: set(v.ravel()) for name, v in columns.items()} == {
        "session_b": {0.0}, "session_c": {0.0}, "session_d": {1.0}
    }  # fmt: skip


def test_a_reading_is_measured_in_every_pass_from_both_sides() -> None:
    assert Circumstances(both_approaches=True, repeats=3).size(planar()) == 6

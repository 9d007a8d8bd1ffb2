"""What a result says of itself: optimality, bounds, priors, methods, sigmas, outliers, predictions, repeatability."""

from dataclasses import replace

import arms
import numpy as np
import pytest

from casadical import InputError, identify
from casadical.identification.figures import stiffness
from casadical.identification.least_squares import Linearised
from casadical.identification.pose_errors import ModelErrors, PoseErrors

ARM = arms.six_axis()


@pytest.fixture(scope="module")
def built():
    return arms.planted(ARM, 1, arms.TRACKER)


@pytest.fixture(scope="module")
def result(built):
    return identify(ARM, arms.positions(built, arms.readings(built, 60, 2), 3), ["kinematic"])


def moved(result, k, by):
    """The same result with variable k off by `by` standard errors."""
    v = result.solution.v.copy()
    v[k] += by * result.standard_errors[k] / result.problem.scale[k]
    return replace(result, solution=replace(result.solution, v=v))


def test_a_variable_pushed_onto_its_bound_is_not_optimal(result):
    """At a bound that the cost pushes away from, a step inwards helps."""
    v = result.solution.v.copy()
    k = result.names.index("a2")
    for side in result.problem.bounds:
        v[k] = side[k]
        assert not replace(result, solution=replace(result.solution, v=v.copy())).is_optimal()


def test_robust_solution_is_optimal_and_its_perturbation_is_not(built):
    m = arms.positions(built, arms.readings(built, 80, 4), 5)
    for loss in ("huber", "soft_l1"):
        robust = identify(ARM, m, ["kinematic"], loss=loss)
        assert robust.is_optimal()
        assert not moved(robust, 3, 0.1).is_optimal()


def test_where_no_parameter_is_left_because_nothing_fits_the_message_says_so(built):
    """A joint that counts the other way: not a list of parameters that the poses tell nothing of."""
    m = arms.positions(built, arms.readings(built, 100, 4), 5)
    backwards = replace(m, q=m.q * [1, 1, -1, 1, 1, 1])
    with pytest.raises(InputError, match=r"^table: the model does not fit: \d+ mm .* signs and zeros"):
        identify(ARM, backwards, ["kinematic"], loss="huber")
    assert "THE MODEL DOES NOT FIT" in identify(ARM, backwards, ["kinematic"], loss="linear").verdict


def test_priors_hold_what_the_data_do_not_tell(built):
    """Eight poses cannot tell 27 numbers apart; with priors every one stays within a few of its widths."""
    m = replace(arms.positions(built, arms.readings(built, 8, 8), 9), sigma=arms.NOISE)
    with pytest.raises(InputError, match=r"24 numbers were measured.*unknown.*priors"):
        identify(ARM, m, ["kinematic"])
    held = identify(ARM, m, ["kinematic"], priors=True)
    assert held.is_optimal()
    departures = held.problem.separate(held.solution.v)[0] * np.sqrt(np.diag(held.problem.prior_matrix))
    assert np.abs(departures).max() < 3
    widths = np.array([held.start.parameters[n].prior for n in held.names])
    assert (held.standard_errors < 1.3 * widths).all()


@pytest.mark.parametrize("loss", ["huber", "soft_l1"])
def test_outliers_are_named_and_left_out(built, loss):
    q = arms.readings(built, 100, 12)
    m = arms.positions(built, q, 13)
    wrong = m.position.copy()
    wrong[5::10] += np.array([0.5e-3, -0.3e-3, 0.4e-3])
    robust = identify(ARM, replace(m, position=wrong), ["kinematic"], loss=loss)
    assert robust.outliers == tuple((0, i) for i in range(5, 100, 10))
    clean = identify(ARM, m[np.arange(100) % 10 != 5], ["kinematic"])
    assert arms.model_error(robust.robot, built) < 1.2 * arms.model_error(clean.robot, built)
    assert robust.sigmas[0][0] == pytest.approx(arms.NOISE, rel=0.15)
    assert "left out as outliers: row " in robust.verdict
    assert "and 2 more" in robust.verdict  # eight of the ten are named there, all in `left_out`
    assert len(robust.left_out) == 10
    linear = identify(ARM, replace(m, position=wrong), ["kinematic"], loss="linear").robot
    assert arms.model_error(linear, built) > 4 * arms.NOISE
    by_default = identify(ARM, replace(m, position=wrong), ["kinematic"])
    assert (by_default.loss, by_default.outliers) == ("huber", tuple((0, i) for i in range(5, 100, 10)))


def test_loss_auto_is_huber_where_it_finds_outliers_and_else_linear(built):
    m = arms.positions(built, arms.readings(built, 60, 14), 15)
    plain, auto = (identify(ARM, m, iter(["placement", "a2"]), loss=loss) for loss in ("linear", "auto"))
    assert (auto.loss, auto.outliers, auto.solution.v.tolist()) == ("linear", (), plain.solution.v.tolist())
    wrong = m.position.copy()
    wrong[7] += 0.01
    robust, auto = (
        identify(ARM, replace(m, position=wrong), ["placement", "a2"], loss=loss) for loss in ("huber", "auto")
    )
    assert (auto.loss, auto.outliers) == ("huber", ((0, 7),))
    assert auto.solution.v.tolist() == robust.solution.v.tolist()


def test_a_robust_loss_settles_about_a_linear_fit_where_ipopt_finds_it(built):
    """Residuals are linear in v that near: a robust fit is off by a hundredth of a standard error."""
    m = replace(arms.poses(built, arms.readings(built, 80, 31), 33), sigma=arms.NOISE, sigma_angle=1e-4)
    wrong = m.position + np.where(np.arange(80) % 9 == 0, 4 * arms.NOISE, 0)[:, None]
    wide = replace(m, position=wrong, sigma=2 * arms.NOISE, sigma_angle=3e-4)
    plain = identify(ARM, wide, ["kinematic"], loss="linear")
    about = Linearised.about(plain.problem, plain.solution.v, "huber").with_sigmas(((arms.NOISE, 1e-4),))
    settled = about.settled(plain.solution.v)
    true = replace(plain.problem, loss="huber", sigmas=((arms.NOISE, 1e-4),))
    error = np.sqrt(np.diag(np.linalg.inv(true.information(settled))))
    assert abs((settled - true.solve().v) / error).max() < 0.01
    assert abs((settled - plain.solution.v) / error).max() > 0.1
    assert about.residuals(settled)[0] == pytest.approx(true.residuals(settled)[0], abs=1e-3)


def test_a_weight_of_zero_is_a_pose_left_out(built):
    m = arms.positions(built, arms.readings(built, 60, 14), 15)
    weight = np.ones(60)
    weight[40:] = 0
    wrong = m.position + (weight[:, None] == 0)
    weighted = identify(ARM, replace(m, position=wrong, weight=weight), ["kinematic"])
    alone = identify(ARM, m[:40], ["kinematic"])
    assert arms.model_error(weighted.robot, alone.robot) < 1e-7
    assert weighted.degrees_of_freedom == alone.degrees_of_freedom
    assert weighted.standard_errors == pytest.approx(alone.standard_errors, rel=1e-3)
    robust = identify(ARM, replace(m, position=wrong, weight=weight), ["kinematic"], loss="huber")
    assert robust.sigmas[0][0] == pytest.approx(arms.NOISE, rel=0.2)


def test_correlations_are_listed_the_strongest_first(result):
    pairs = result.correlations(above=0.5)
    strength = pairs["correlation"].abs().to_numpy()
    assert len(pairs) > 0
    assert (strength > 0.5).all()
    assert (np.diff(strength) <= 0).all()
    first = pairs.iloc[0]
    i, j = (result.names.index(first[c]) for c in ("parameter", "with"))
    expected = result.covariance[i, j] / (result.standard_errors[i] * result.standard_errors[j])
    assert first["correlation"] == pytest.approx(expected)


@pytest.mark.parametrize("position", [np.arange(12.0).reshape(4, 3), None])
def test_of_thinned_poses_each_keeps_what_is_its_own(position):
    models = (ModelErrors("KM", np.arange(4.0), np.arange(12.0).reshape(4, 3)),)
    poses = PoseErrors("report", True, np.arange(4) + 2, np.arange(24.0).reshape(4, 6), position, models)
    assert poses.thinned(4) is poses
    some = poses.thinned(2)
    for found, whole in ((some.row, poses.row), (some.q, poses.q), (some.models[0].vector, models[0].vector)):
        np.testing.assert_array_equal(found, whole[[0, 3]])
    assert (some.position is None) == (position is None)
    if position is not None:
        np.testing.assert_array_equal(some.position, position[[0, 3]])


def test_a_stiffness_that_may_be_rigid_is_said_to_be():
    assert stiffness(5.0, 1.0) == "2e+05"
    assert stiffness(5.0, float("nan")) == "2e+05"
    assert stiffness(3.0, 4.9) == "above 7.9e+04 (rigid is possible)"

"""What a result says of itself: optimality, bounds, priors, methods, sigmas, outliers, predictions, repeatability."""

from dataclasses import replace

import arms
import numpy as np
import pytest

from casadical import InputError, identify
from casadical.effects.joint_error_curve import JointErrorCurve
from casadical.identification.figures import correlated, parameter_tables, stiffness
from casadical.identification.least_squares import Linearised

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


def test_twice_the_same_to_the_last_bit(built):
    """From the start: new robots, kernels and problems."""
    runs = []
    for _ in range(2):
        robot = arms.six_axis()
        m = arms.positions(built, arms.readings(robot, 50, 6), 7)
        runs.append(identify(robot, m, ["kinematic"], loss="soft_l1"))
    assert np.array_equal(runs[0].solution.v, runs[1].solution.v)
    assert np.array_equal(runs[0].covariance, runs[1].covariance)
    assert runs[0].solution.history == runs[1].solution.history


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


def test_priors_fade_where_the_data_tell(built):
    m = arms.positions(built, arms.readings(built, 400, 10), 11)
    with_priors, without = (identify(ARM, m, ["kinematic"], priors=p) for p in (True, False))
    assert with_priors.names == without.names
    assert np.abs((with_priors.estimate - without.estimate) / without.standard_errors).max() < 0.1


def test_the_methods_of_the_paper():
    robot = arms.hh800()
    built = arms.planted(robot, 3)
    m = arms.positions(built, arms.readings(robot, 80, 4), 5, sigma=1e-4)
    km, skcm = identify(robot, m, method="KM"), identify(robot, m, method="SKCM")
    assert not any(n.startswith("c") for n in km.names)
    assert not any(j.compliance for j in km.robot.joints)
    assert [n for n in skcm.names if n.startswith("c")] == ["c2", "c3", "c4", "c5"]
    held_out = arms.positions(built, arms.readings(robot, 200, 6), 7, sigma=1e-4)
    assert skcm.accuracy(held_out)["calibrated"].mean < 0.5 * km.accuracy(held_out)["calibrated"].mean
    assert km.verdict.startswith("KM: 29 parameters")
    assert skcm.verdict.startswith("SKCM: 33 parameters")


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


def test_outliers_of_ten_sigma_all_one_way(built):
    """They drag the fit along and widen the spread by which they are judged: one look does not find them."""
    m = arms.positions(built, arms.readings(built, 60, 22), 23)
    wrong = m.position.copy()
    wrong[::10] += np.array([1.2e-4, -1.2e-4, 1.06e-4])
    robust = identify(ARM, replace(m, position=wrong), ["kinematic"], loss="soft_l1")
    assert robust.outliers == tuple((0, i) for i in range(0, 60, 10))
    assert robust.is_optimal()


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


@pytest.mark.slow
@pytest.mark.parametrize(("poses", "known"), [(20, False), (40, False), (60, True)])
def test_loss_auto_finds_the_outliers_that_huber_finds(built, poses, known):
    """Of sizes up to and beyond the bound, of which some are left to the huber loss and some are surely none."""
    m = replace(arms.positions(built, arms.readings(built, poses, 14), 15), sigma=arms.NOISE if known else None)
    counts = set()
    for size in (0, 3, 4, 5, 6, 8, 50):
        wrong = m.position.copy()
        wrong[[7, 11]] += size * arms.NOISE * np.array([[0.6, -0.64, 0.48], [-0.48, 0.6, 0.64]])
        spoilt = replace(m, position=wrong)
        robust, auto = (identify(ARM, spoilt, ["kinematic"], loss=loss) for loss in ("huber", "auto"))
        assert auto.outliers == robust.outliers
        assert auto.loss == ("huber" if robust.outliers else "linear")
        counts.add(len(robust.outliers))
    assert {0, 2} <= counts


def test_loss_auto_solves_once_where_no_pose_is_near_an_outlier(built):
    numbers = []
    m = arms.positions(built, arms.readings(built, 60, 14), 15)
    identify(ARM, m, ["kinematic"], progress=lambda iteration, cost: numbers.append(iteration))
    assert numbers.count(0) == 1
    # Few numbers a variable hide an outlier: the huber loss is asked.
    few = m[:18]
    found = identify(ARM, few, ["kinematic"], progress=lambda iteration, cost: numbers.append(iteration))
    assert found.outliers == ()
    assert numbers.count(0) > 3


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


@pytest.mark.slow
def test_predicted_covariance_is_the_scatter_over_repeated_campaigns(built):
    robot = replace(ARM, base=replace(ARM.base, T=arms.TRACKER))
    q, probe = arms.readings(built, 40, 16), arms.readings(built, 5, 17)
    runs = [identify(robot, arms.positions(built, q, 100 + k), ["kinematic"]) for k in range(20)]
    found = np.array([r.predict(probe)[0] for r in runs])
    claimed = np.mean([r.predict(probe)[1] for r in runs], axis=0)
    miss = found - arms.points(built, probe)
    # Mahalanobis distances squared have mean 3 and, over 20 runs of five dependent probes, spread of about 0.3.
    d2 = np.einsum("rni,nij,rnj->rn", miss, np.linalg.inv(claimed), miss)
    assert d2.mean() == pytest.approx(3, abs=0.9)
    assert np.allclose(found.std(axis=0), np.sqrt(np.diagonal(claimed, axis1=1, axis2=2)), rtol=0.5)


def test_progress_hears_every_iteration(built):
    heard = []
    m = arms.positions(built, arms.readings(built, 40, 18), 19)
    identify(ARM, m, ["kinematic"], loss="linear", progress=lambda k, cost: heard.append((k, cost)))
    assert [k for k, _ in heard] == list(range(len(heard)))
    assert heard[-1][1] < 1e-3 * heard[0][1]


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


def test_a_stiffness_that_may_be_rigid_is_said_to_be() -> None:
    assert stiffness(5.0, 1.0) == "2e+05"
    assert stiffness(5.0, float("nan")) == "2e+05"
    assert stiffness(3.0, 4.9) == "above 7.9e+04 (rigid is possible)"


def test_effects_of_too_many_coefficients_are_summed_up(built):
    robot = ARM.with_effect(JointErrorCurve(None, (2e-5,) * 6, orders=2))
    found = identify(
        robot, arms.positions(built, arms.readings(built, 60, 2), 3), ["kinematic", "joint_error_curve"], priors=True
    )
    table, *words = parameter_tables(found, whole=True)
    assert len(found.parameters) - len(table.rows) == 24
    assert not [row[0] for row in table.rows if row[0].startswith("joint_error_curve")]
    assert any("harmonics of each joint 2" in w.text and "20, 20, 20, 20, 20, 20 urad" in w.text for w in words)
    assert not any("joint_error_curve" in w.text for w in correlated(found))

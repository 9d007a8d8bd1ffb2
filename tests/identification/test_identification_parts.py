"""Limits, thresholds and words of an identification, on arms small enough to see what must come out."""

from dataclasses import replace
from types import SimpleNamespace

import arms
import numpy as np
import pytest
from scipy import optimize

from casadical import Joint, Placement, identify
from casadical.core.basics import InputError
from casadical.core.transforms import frame, from_rpy
from casadical.effects import Law
from casadical.identification import reduction
from casadical.identification.accuracy import predicted
from casadical.identification.identifiability import NO_EFFECT_REASON
from casadical.identification.identification import prepare
from casadical.identification.least_squares import LeastSquares, Linearised
from casadical.identification.plausibility import check_against
from casadical.identification.prediction import _prior_size_factors, steps_without
from casadical.identification.prior import Prior
from casadical.identification.reduction import explained
from casadical.identification.solver import bounded_step
from casadical.robot.robot import Knowledge

PLANAR = arms.planar()


@pytest.fixture(scope="module")
def result():
    """Of an arm whose base and tool are found with its lengths."""
    arm = arms.six_axis()
    q = arms.readings(arm, 40, 1)
    return identify(arm, arms.positions(arms.planted_in(arm, ["a2", "theta2"], 2), q, 3), ["placement", "a2", "theta2"])


@pytest.mark.parametrize(("beyond", "refused"), [(-1e-3, False), (1.9e-3, False), (2.1e-3, True), (0.3, True)])
@pytest.mark.parametrize("end", [-2.0, 2.0])
def test_readings_end_two_milliradians_beyond_the_limits(end: float, beyond: float, refused: bool) -> None:
    q = np.tile([0.1, 0.2], (5, 1))
    q[3, 1] = end + np.sign(end) * beyond
    if not refused:
        check_against(PLANAR, arms.positions(PLANAR, q, 0))
        return
    with pytest.raises(
        InputError, match=rf"'q2': {np.rad2deg(q[3, 1]):.6g} deg is outside .*\[-114.592, 114.592\] deg"
    ):
        check_against(PLANAR, arms.positions(PLANAR, q, 0))


@pytest.mark.parametrize("unknown", ["position", "none"])
def test_a_tool_turns_as_orientations_show_unless_it_is_known(unknown: str) -> None:
    arm = arms.six_axis()
    turned = frame(from_rpy(np.array([0.5, -0.3, 1.0])), arm.tool.T[:3, 3])
    built = replace(arm, base=replace(arm.base, T=arms.TRACKER), tool=replace(arm.tool, T=turned))
    m = arms.poses(built, arms.readings(built, 30, 2), 3)
    tool = prepare(replace(arm, tool=replace(arm.tool, unknown=unknown)), m, tool_turns=True).robot.tool
    assert tool.unknown == ("pose" if unknown == "position" else "none")
    np.testing.assert_allclose(tool.T[:3, :3], turned[:3, :3] if unknown == "position" else np.eye(3), atol=1e-3)


def test_an_optimum_is_what_a_step_improves_by_less_than_a_ten_thousandth(result) -> None:
    """Chi-squared grows with the square of the way from the optimum."""
    problem, v = result.problem, result.solution.v
    assert result.is_optimal()
    way = np.random.default_rng(0).normal(size=v.size)
    gain = np.sqrt(problem.decrement(v + 1e-4 * way) / 1e-8)
    for tolerance, optimal in ((0.9e-4, True), (1.15e-4, False)):
        moved = v + way / gain * np.sqrt(tolerance * result.variance)
        assert problem.decrement(moved) == pytest.approx(tolerance * result.variance, rel=0.05)
        assert replace(result, solution=replace(result.solution, v=moved)).is_optimal() is optimal


def test_a_step_is_that_of_bounded_least_squares(result) -> None:
    """At points where several variables would leave their bounds, beside SciPy; what it gains is never negative."""
    problem, v = result.problem, result.solution.v
    rng, hits = np.random.default_rng(1), 0
    for _ in range(40):
        far = v + 1e-3 * rng.normal(size=v.size)
        narrow = replace(problem)
        # Nearer than 1e-5 counts as at a bound.
        lower, upper = far - 2e-5 - 2e-3 * rng.random(v.size), far + 2e-5 + 2e-3 * rng.random(v.size)
        narrow.__dict__["bounds"] = lower, upper
        g, H = narrow.gradient(far)
        L = np.linalg.cholesky(H)
        expected = optimize.lsq_linear(L.T, -np.linalg.solve(L, g), (lower - far, upper - far), tol=1e-14).x
        step = narrow.step(far)
        gain, most = (-(g + 0.5 * H @ x) @ x for x in (step, expected))
        assert gain == pytest.approx(most, rel=1e-6)
        assert narrow.decrement(far) == pytest.approx(gain)
        hits += int(((step == lower - far) | (step == upper - far)).sum())
    assert hits > 80


@pytest.mark.parametrize("common", [0.0, 2.0])
def test_a_bounded_step_meets_the_conditions_of_an_optimum(common: float) -> None:
    """Of variables half of which begin at a bound; with a common part they are strongly correlated."""
    rng = np.random.default_rng(0)
    for _ in range(100):
        A, b = rng.normal(size=(7, 6)) + common * rng.normal(size=(7, 1)), rng.normal(size=7)
        at, below = rng.random(6) < 0.5, rng.random(6) < 0.5
        lower, upper = -np.where(at & below, 0.0, rng.random(6)), np.where(at & ~below, 0.0, rng.random(6))
        step = bounded_step(A.T @ b, A.T @ A, lower, upper, at)
        slope = A.T @ (A @ step + b)
        assert ((lower <= step) & (step <= upper)).all()
        assert (slope[step > lower] < 1e-9).all()
        assert (slope[step < upper] > -1e-9).all()


def test_a_choice_of_ones_own_is_no_method_of_the_paper(result) -> None:
    assert result.method == "identify"
    fitted = identify(arms.six_axis(), result.measurements[0], method="KM")
    assert fitted.method == "KM"


@pytest.mark.parametrize("lengths", [(), (2.0,), (2.0, 3.0)])
def test_parameters_that_show_themselves_at_the_optimum_are_added_alone(lengths, monkeypatch) -> None:
    """Of a and b, which had no effect at the start, beside c: those whose column has a length."""
    added: list[set[str]] = []
    seen = np.diag(np.square([*[*lengths, 0.0, 0.0][:2], 5.0]))
    wider = SimpleNamespace(names=("a", "b", "c"), information=lambda v: seen, decrement=lambda v: 0.0)
    wider.cost = lambda v: 1.0
    monkeypatch.setattr(reduction, "_with_added_parameters", lambda p, v, more, order: added.append(more) or (wider, v))
    monkeypatch.setattr(reduction, "_poorly_determined", lambda *_: {})
    unseen = dict.fromkeys("ab", NO_EFFECT_REASON)
    problem, names = SimpleNamespace(robot=None, weighed=False, variance=lambda v: 1.0), ("a", "b", "c")
    found = reduction._with_visible(problem, np.zeros(3), SimpleNamespace(unidentifiable=unseen), names)
    assert (found is None) is (not lengths)
    assert added == [{"a", "b"}, {"a"}][: 2 if len(lengths) == 1 else 1]
    assert reduction._with_visible(problem, np.zeros(3), SimpleNamespace(unidentifiable={}), names) is None


def test_the_data_say_how_many_times_greater_errors_are_than_their_priors() -> None:
    arm = arms.six_axis()
    built = arms.planted(arm, 3, size=30.0)
    result = identify(arm, arms.positions(built, arms.readings(arm, 80, 1), 2), ["kinematic"])
    own = [arm.parameters[name] for name in result.problem.names]
    factors = _prior_size_factors(result.problem, result.solution.v, result.variance, arm)
    places = [k for k, p in enumerate(own) if p.group == "geometry"]
    off = [(built.parameters[own[k].name].value - own[k].value) / own[k].prior for k in places]
    assert np.ptp(factors[places]) == 0
    assert factors[places[0]] == pytest.approx(np.sqrt(np.mean(np.square(off))), rel=0.25)


@pytest.mark.parametrize(("steps", "done"), [(4, 4), (50, 10)])
def test_an_optimum_without_bounds_is_approached_in_ten_steps_at_most(steps: int, done: int) -> None:
    """Every step gains half a unit of cost until `steps` were made, and nothing from then on."""
    problem, calls = SimpleNamespace(), []
    problem.gradient = lambda v: calls.append(v) or (np.full(1, float(len(calls) < steps)), np.eye(1))
    v = Linearised.settled(problem, np.zeros(1))
    assert (len(calls), v.tolist()) == (done, [-float(min(steps - 1, done))])


def test_poses_without_outliers_are_all_explained() -> None:
    arm = arms.six_axis()
    result = identify(arm, arms.positions(arm, arms.readings(arm, 300, 1), 2), ["placement", "a2", "theta2"])
    (found,) = explained(result.problem, (result.problem, result.solution, None))
    assert found.tolist() == [*range(300)]


def test_a_pose_that_was_not_fitted_is_an_outlier_by_its_turn_alone() -> None:
    arm = arms.six_axis()
    m = arms.poses(arm, arms.readings(arm, 60, 1), 2)
    fitted, later = m[np.arange(40)], m[np.arange(40, 60)]
    result = identify(arm, fitted, ["placement", "a2", "theta2"])
    turned = later.orientation.copy()
    turned[7] = turned[7] @ from_rpy(np.array([0.0, 3e-3, 0.0]))
    kept, out = result.without_outliers(replace(later, orientation=turned))
    assert [row.row for row in out] == [later.row[7]]
    assert kept.row.tolist() == np.delete(later.row, 7).tolist()


def test_poses_that_were_not_fitted_are_outliers_by_their_positions() -> None:
    arm = arms.six_axis()
    m = arms.positions(arm, arms.readings(arm, 60, 1), 2)
    result = identify(arm, m[np.arange(40)], ["placement", "a2", "theta2"])
    later = m[np.arange(40, 60)]
    for sigmas, count in ((1, 0), (12, 3)):
        off = predicted(result.robot, later)[0] + sigmas * arms.NOISE * np.eye(20, 3)
        assert len(result.without_outliers(replace(later, position=off))[1]) == count


def test_round_off_takes_no_value_beyond_its_bounds(result) -> None:
    """A compliance of -2e-21 was refused by the robot that it was put into."""
    problem = result.problem
    for end, bound in zip(("lower", "upper"), problem.bounds, strict=True):
        values = problem.values(bound * (1 + 1e-15) + np.where(end == "lower", -1e-15, 1e-15))
        assert values == {n: getattr(problem.robot.parameters[n], end) for n in problem.names}


@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_steps_without_rows_are_those_of_problems_without_them(loss: str) -> None:
    """Of positions, and of spheres at a known distance; what one group alone tells of, point A, stays."""
    arm = arms.six_axis()
    q = arms.readings(arm, 40, 1)
    first = arms.positions(arms.planted_in(arm, ["a2"], 2), q, 3)
    label = np.repeat(["A", "B"], 20)
    touched = replace(first, kind="sphere", position=None, label=label, distance=np.full(40, 0.1))
    sets = (first, touched.with_separations([("A", "B", 0.4)]))
    problem = LeastSquares(arm, sets, ("a2", "theta2"), loss, True, ((2e-5, 1e-4), (2e-5, 1e-4)))
    v = 0.1 * np.random.default_rng(0).normal(size=problem.size)
    groups = [np.arange(40) % 3, np.where(label == "A", 2, np.arange(40) % 2)]
    steps = steps_without(problem, v, groups)
    for k, step in enumerate(steps[:2]):
        weights = [np.where(own == k, 0.0, 1.0) for own in groups]
        others = replace(problem, sets=tuple(replace(m, weight=w) for m, w in zip(sets, weights, strict=True)))
        np.testing.assert_allclose(step, others.from_points(problem.points).step(v), rtol=1e-5, atol=1e-9)
    assert np.isfinite(steps[2]).all()


def test_a_prior_knows_the_measurements_that_it_was_learnt_from() -> None:
    q = np.array([[0.1, -0.7], [0.5, 0.2], [0.3, 1.1]])
    m = replace(arms.positions(PLANAR, q, 0), source="a.csv")
    prior = Prior(knowledge=Knowledge(campaign="a.csv", readings=np.array([[0.1, 0.5], [-0.7, 1.1]])))
    assert prior.learnt_from([m])
    assert not prior.learnt_from([replace(m, q=q + 0.01)])
    assert not prior.learnt_from([replace(m, source="b.csv")])


def test_a_model_that_does_not_fit_is_told_by_a_two_hundredth_of_the_reach() -> None:
    """Three poses with 8 mm of scatter do not determine a length; whether the model is to blame tells the reach."""
    for length, word in ((0.2, "does not fit: [0-9.]+ mm"), (2.0, "determine none")):
        joints = (Joint(), replace(PLANAR.joints[1], a=length))
        arm = replace(PLANAR, joints=joints, tool=Placement(frame(np.eye(3), np.array([length, 0, 0]))))
        m = arms.positions(arm, np.array([[0.3, 0.8], [-0.5, 0.1], [1.0, -1.0]]), 3, sigma=8e-3)
        with pytest.raises(InputError, match=word):
            identify(arm, m, ["a1"])


def test_a_row_where_an_effect_has_no_finite_slope_is_named() -> None:
    law = Law(1, "joint", "sqrt(a**2*q1**2)", (("a", 1e-5),))
    arm = PLANAR.with_effect(law).with_values({law.parameters()[0].name: 1e-5})
    q = np.random.default_rng(0).uniform(0.2, 1.5, (12, 2))
    m = arms.positions(PLANAR, q, 0)
    check_against(arm, m)
    q[[4, 7], 0] = 0.0
    told = r"row 4: the model with law .* no finite number there \(2 such rows\); change"
    with pytest.raises(InputError, match=told):
        identify(arm, replace(m, q=q), ["placement", law.label])

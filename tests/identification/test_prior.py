"""What one campaign told of a robot as the prior of the next: fewer poses, messages, the learnt ranges."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from arms import NOISE, TRACKER, model_error, planted, positions, readings, six_axis

from casadical import InputError, identify
from casadical.core.transforms import frame, from_rpy
from casadical.effects import JointErrorCurve, JointScale
from casadical.identification.prior import Prior, carry_over
from casadical.robot.robot import Covariance, Knowledge
from casadical.robot.robot_file import robot_from, to_toml

ARM = six_axis()
CURVE = JointErrorCurve(None, (0.0, 2e-4, 2e-4, 0.0, 0.0, 0.0), 5, 17)
ELSEWHERE = frame(from_rpy(np.array([0.3, 0.5, -2.0])), np.array([-1.1, 2.4, 0.2]))
BASE = ("kinematic",)


def parse(text):
    return robot_from(tomllib.loads(text), "other.toml")


@pytest.fixture(scope="module")
def built():
    """An arm with curves in joints 2 and 3."""
    rng = np.random.default_rng(5)
    arm = planted(ARM, 5).with_effect(CURVE)
    return arm.with_values({p.name: 2e-4 * rng.normal() for p in CURVE.parameters()})


@pytest.fixture(scope="module")
def first(built):
    """The robot as a long campaign found it, in front of one tracker."""
    m = positions(replace(built, base=replace(built.base, T=TRACKER)), readings(ARM, 150, 1), 1)
    found = identify(ARM.with_effect(CURVE), replace(m, source="first.csv"), (*BASE, CURVE.label), priors=True)
    return parse(to_toml(found.robot))


@pytest.fixture(scope="module")
def moved(built):
    """The same arm in front of another tracker."""
    return replace(built, base=replace(built.base, T=ELSEWHERE))


@pytest.fixture(scope="module")
def few(moved):
    return replace(positions(moved, 0.7 * readings(ARM, 14, 2), 2), source="second.csv")


def test_a_prior_saves_poses(first, few, moved):
    """Fourteen poses settle the frames; curves and their size come from the first campaign."""
    alone = identify(ARM.with_effect(CURVE), few, (*BASE, CURVE.label), priors=True)
    with_prior = identify(ARM, few, BASE, prior=first)
    assert with_prior.robot.effects == (CURVE,)
    assert {p.name for p in CURVE.parameters()} <= set(with_prior.names)
    assert model_error(with_prior.robot, moved) < 0.5 * model_error(alone.robot, moved)
    assert with_prior.is_optimal()
    assert "Prior from first.csv: joint_error_curve" in carry_over(ARM, first)[1].in_words([few])


def test_data_outvote_a_prior_that_no_longer_holds(first, built):
    """Joint 3 got another gear: many new poses show it, whatever the first campaign said."""
    changed = built.with_values({p.name: -1e-4 for p in CURVE.parameters() if p.name.endswith("q3")})
    there = replace(changed, base=replace(changed.base, T=ELSEWHERE))
    found = identify(ARM, positions(there, readings(ARM, 150, 3), 3), BASE, prior=first)
    assert model_error(found.robot, there) < NOISE


def test_the_covariance_is_that_of_both_campaigns(first, few):
    """As the formula for two Gaussian sources: never wider than the prior, and the block is kept whole."""
    found = identify(ARM, few, BASE, prior=first)
    _, prior = carry_over(ARM, first)
    k = [found.names.index(name) for name in prior.covariances[0][0]]
    ratio = np.linalg.eigvals(np.linalg.solve(prior.covariances[0][1], found.covariance[np.ix_(k, k)] / found.variance))
    assert ratio.real.max() < 1 + 1e-6
    again = found.robot.knowledge
    assert again.campaign == "first.csv, second.csv"
    assert again.poses == 164
    assert (again.readings[:, 0] == first.knowledge.readings[:, 0]).all()


def test_frozen_holds_the_values_inside_the_ranges(first, few):
    model, prior = carry_over(ARM, first, frozen=True)
    held = identify(model, few, BASE, prior=prior)
    assert not any(name.startswith(CURVE.label) for name in held.names)
    assert held.robot.effect_values == first.effect_values
    assert held.robot.knowledge.readings.tolist() == first.knowledge.readings.tolist()


def test_frozen_is_refused_outside_of_the_ranges(first, few):
    q = few.q.copy()
    q[:7, 3] += 4.0
    model, prior = carry_over(ARM, first, frozen=True)
    with pytest.raises(InputError, match=r"frozen: .*first\.csv covers: q4 \d+.*use them as a prior"):
        identify(model, replace(few, q=q), BASE, prior=prior)
    model, prior = carry_over(ARM, replace(first, knowledge=None), frozen=True)
    with pytest.raises(InputError, match=r"learnt\.readings"):
        identify(model, few, BASE, prior=prior)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: replace(r, joints=r.joints[:5], effects=(), knowledge=None), "has 5 joints, robot 'elbow' has 6"),
        (lambda r: r.with_values({"a2": 0.6}), "a2 is 600 mm, of robot 'elbow' 500; they may differ by 30"),
        (lambda r: r.with_values({n: 1e-3 * r.parameters[n].value for n in ("a1", "a2", "a3", "d4", "d6")}), "units"),
        (lambda r: r.with_values({"alpha1": 0.0}), "convention"),
        (lambda r: replace(r, knowledge=None), "covariance: nothing says how well joint_error_curve is known"),
        (lambda r: r.with_only(()), "has no effects that last"),
    ],
)
def test_another_robot_is_refused(first, few, change, message):
    with pytest.raises(InputError, match=message):
        identify(ARM, few, BASE, prior=change(first))


def test_what_nothing_is_known_of_has_mean_zero_and_no_correlation():
    C = np.array([[4.0, 1.0, 2.0], [1.0, 9.0, 3.0], [2.0, 3.0, 16.0]])
    prior = Prior(means=dict.fromkeys("abc", (0.5, 1.0)), covariances=((tuple("abc"), C),))
    found = prior.widened({"b": 7.0})
    assert found.means == {"a": (0.5, 1.0), "b": (0.0, 7.0), "c": (0.5, 1.0)}
    ((names, block),) = found.covariances
    assert (names, block.tolist()) == (("a", "c"), [[4.0, 2.0], [2.0, 16.0]])


def test_names_and_variances_are_checked(first):
    with pytest.raises(InputError, match=r"joint_error_curve\.s3_q2 is nan; it must be a finite number"):
        carry_over(ARM, first.with_values({"joint_error_curve.s3_q2": np.nan}))
    with pytest.raises(InputError, match="no effect 'backlash'; allowed: effects, all, joint_error_curve"):
        carry_over(ARM, first, ("backlash",))
    block = first.knowledge.covariance[0]
    matrix = block.matrix.copy()
    k = block.names.index("joint_error_curve.s1_q2")
    matrix[k, :] = matrix[:, k] = 0.0
    zero = replace(first, knowledge=Knowledge((Covariance(block.names, matrix),)))
    with pytest.raises(InputError, match=r"covariance: the variance of joint_error_curve\.s1_q2 is zero"):
        carry_over(ARM, zero)


def test_poses_outside_of_the_learnt_ranges_are_said_and_nothing_is_lost(first, few):
    q = few.q.copy()
    q[:7, 3] = 4.0
    beyond = replace(few, q=q)
    _, prior = carry_over(ARM, first)
    assert "Poses outside of the ranges that it covers: q4 50 %." in prior.in_words([beyond])
    assert prior.to_json([beyond])["uncovered"]["q4"] == 0.5
    assert prior.to_json([few])["uncovered"]["q4"] == 0
    assert set(prior.means) == {p.name for p in CURVE.parameters()}


def test_an_effect_that_the_robot_has_is_replaced(first, few):
    model, prior = carry_over(ARM.with_effect(JointScale(1), CURVE), first)
    assert [e.label for e in model.effects] == ["joint_scale@1", CURVE.label]
    assert model.effect_values[f"{CURVE.label}.s1_q2"] == first.effect_values[f"{CURVE.label}.s1_q2"]
    assert prior.labels == (CURVE.label,)


def test_what_robots_of_one_type_have_in_common_is_a_prior_as_it_is():
    """Its covariance is how robots differ, so that it is not widened; a campaign of the robot itself is."""
    block = (Covariance(("a1", "a2"), np.diag([9e-10, 4e-10])),)
    told = {n: replace(ARM, knowledge=Knowledge(block, "elsewhere", robots=n)) for n in (0, 12)}
    assert parse(to_toml(told[12])).knowledge.robots == 12
    assert "robots" not in to_toml(told[0])
    (_, own), (_, type_) = (carry_over(ARM, robot, ("all",)) for robot in told.values())
    assert type_.means["a1"][1] == pytest.approx(3e-5)
    assert own.means["a1"][1] == pytest.approx(np.sqrt(1.5 * 9e-10 + 1e-8))
    assert "as far as 12 robots of the type differ" in type_.in_words([])
    assert "variances widened 1.5 times" in own.in_words([])

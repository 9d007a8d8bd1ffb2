"""Joint error curves: named where joints have them, sized by the data, judged as the normal distribution says."""

from dataclasses import replace

import numpy as np
import pytest
from cases import case, diagnose, planar, plant, robot, simulated, small_problem
from planted import campaign
from scipy.stats import multivariate_normal

from casadical import InputError
from casadical.blind_check.mujoco_physics import perturb
from casadical.core.linear_gaussian.sums import MAX_NARROW_GROUP_COLUMNS
from casadical.diagnosis.cross_validation import Noise
from casadical.diagnosis.details import Details
from casadical.diagnosis.evidence import KAPPA_GRID, RHO_GRID, SIGMA_GRID_M, Evidence
from casadical.diagnosis.joint_curves import joint_curves
from casadical.diagnosis.settings_search import learnt_sizes
from casadical.diagnosis.text import PAGE_WIDTH, as_json, page_of
from casadical.effects import JointErrorCurve, TransmissionRipple
from casadical.effects.joint_error_curve import DEFAULT_ORDERS, EXTENDED_ORDERS, TYPICAL_HARMONIC_RAD
from casadical.identification.accuracy import errors
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import from_table


def true_errors(seed: int, q: np.ndarray) -> np.ndarray:
    """Errors of six joints at their readings, 30 harmonics of 30 urad each, shape (k, 6) [rad]."""
    a, b = 30e-6 * np.random.default_rng(seed).normal(size=(2, 6, 30))
    waves = q[:, :, None] * np.arange(1, 31)
    return (a * np.sin(waves) + b * np.cos(waves)).sum(axis=2)


def with_curves(seed: int, n: int) -> Measurements:
    """A campaign whose joints each read a periodic function of their own angle wrong."""
    m = simulated("ur10e", seed, n=n)
    q = m.q
    for _ in range(5):  # the reading at which reading and error together are the true angle
        q = m.q - true_errors(seed, q)
    return replace(m, q=q)


@pytest.fixture(scope="module")
def found():
    """A diagnosis of 120 poses of a robot whose joints all err with their own angle, and 60 poses never seen."""
    m = with_curves(21, 180)
    return diagnose(robot("ur10e"), m[:120]), m[120:]


def test_curves_of_all_joints_are_named_and_predict(found) -> None:
    d, unseen = found
    assert d.verdict == "explained"
    assert d.causes[0].effect == "joint_error_curve"
    assert d.causes[0].confidence > 0.92
    before, after = errors(d.identification.robot, unseen).mean(), errors(d.apply(), unseen).mean()
    assert after < 0.5 * before
    assert after == pytest.approx(d.gap.after, rel=0.3)


def test_curves_lie_within_their_bands_and_share_what_they_explain(found) -> None:
    d, _ = found
    curves = joint_curves(d)
    assert sum(c.share for c in curves) == pytest.approx(1)
    for c in curves:
        truth = true_errors(21, np.tile(c.angle[:, None], 6))[:, c.joint - 1]
        if c.seen:
            assert (np.abs(c.value - truth) < 1.96 * c.error)[c.covered].mean() > 0.85
        if not c.covered.all():
            assert c.error[~c.covered].mean() > c.error[c.covered].mean()
    assert sum(c.seen for c in curves) >= 3
    answer = as_json(d, "curved", Details(curves=curves))
    assert answer["causes"][0]["parameters"] == {}
    assert answer["curves"]["harmonics"] == 60
    for c, told in zip(curves, answer["curves"]["joints"], strict=True):
        q = (np.rad2deg(d.case.m.q[:, c.joint - 1]) + 180) % 360 - 180
        inside = [(low <= q) & (q <= high) for low, high in told["covered_deg"]]
        assert np.any(inside, axis=0).mean() > 0.95
    page = page_of(d, Details(curves=curves))
    assert max(map(len, page.splitlines())) <= PAGE_WIDTH
    assert "harmonics of each joint 60" in page
    lines = page.splitlines()
    start = next(k for k, line in enumerate(lines) if line.split()[:2] == ["joint", "rms"])
    rows = [line.split() for line in lines[start + 1 : start + 7]]
    assert [int(row[0]) for row in rows] == [c.joint for c in sorted(curves, key=lambda c: -c.share)]


def test_a_diagnosis_without_curves_has_none_to_show() -> None:
    with pytest.raises(InputError, match="no joint error curve was found"):
        joint_curves(planar())


def test_the_refit_keeps_the_learnt_sizes(found) -> None:
    d, _ = found
    (effect,) = d.causes[0].effects
    priors = {p.name: p.prior for p in effect.parameters()}
    for joint, spread in enumerate(effect.spread, 1):
        assert priors[f"joint_error_curve.s1_q{joint}"] == pytest.approx(spread)
        assert priors[f"joint_error_curve.c34_q{joint}"] == pytest.approx(spread / 2)
    values = d.refit().robot.effect_values
    assert max(abs(v) / priors[name] for name, v in values.items() if name in priors) < 6


def test_what_a_curve_holds_is_no_cause_beside_it(found) -> None:
    d, _ = found
    assert len(d.rankings) > 1
    beside = {label.split("@")[0] for label in d.rankings[1].probability}
    assert not beside & {"gear_eccentricity", "transmission_ripple"}
    assert not beside & {f"any function of q{j} in joint {j}" for j in range(1, 7)}
    assert "any function of q1 in joint 2" in beside
    assert "backlash" in beside


def wide_problem(n: int) -> Evidence:
    """Many columns, of which all do something."""
    e, rng = small_problem(n=n), np.random.default_rng(5)
    E = 4e-5 * rng.normal(size=(n, 3, MAX_NARROW_GROUP_COLUMNS + 5))
    return replace(e, E=E, cause_prior=None, r=e.r + E @ rng.normal(size=MAX_NARROW_GROUP_COLUMNS + 5))


@pytest.mark.parametrize("n", [9, 30], ids=["judged on the rows", "judged on the columns"])
@pytest.mark.parametrize("chosen", [[], [MAX_NARROW_GROUP_COLUMNS + 4]], ids=["first", "after one"])
def test_a_wide_group_is_the_normal_density(n: int, chosen: list[int]) -> None:
    e, also, group = wide_problem(n), np.array(chosen, dtype=np.int64), np.arange(MAX_NARROW_GROUP_COLUMNS + 1)
    grid, base = e.log_grids([group], also)[0], e.log_base(also)
    J, E = e.J.reshape(3 * n, -1), e.take(np.arange(e.width)).reshape(3 * n, -1)
    for rho, sigma, kappa in ((0, 12, 0), (3, 17, 2), (5, 25, 4)):
        C = np.zeros((3 * n, 3 * n))
        for k, Jq in enumerate(e.Jq):
            own = slice(3 * k, 3 * k + 3)
            C[own, own] = SIGMA_GRID_M[sigma] ** 2 * (np.eye(3) + RHO_GRID[rho] ** 2 * Jq @ Jq.T)
        share = SIGMA_GRID_M[sigma] / e.reference
        C += share**2 * (J * e.prior**2) @ J.T + (share * 8.0) ** 2 * E[:, also] @ E[:, also].T
        logs = [
            multivariate_normal(J @ e.delta0, C + size**2 * E[:, group] @ E[:, group].T).logpdf(e.r.ravel())
            for size in (0.0, KAPPA_GRID[kappa])
        ]
        gain = grid[rho, sigma, kappa] - base[rho, sigma]
        # With more columns than rows, what the base model takes up does not count for finer noise.
        finer = np.log(SIGMA_GRID_M[np.argmax(base[rho])] / SIGMA_GRID_M[sigma]) if 3 * n < len(group) else 0.0
        taken = np.trace(J @ np.linalg.solve(J.T @ J + np.diag((e.reference / e.prior) ** 2), J.T))
        assert gain == pytest.approx(logs[1] - logs[0] - taken * max(finer, 0.0), abs=1e-5)


def test_few_poses_of_a_robot_close_to_its_drawing_show_no_curve() -> None:
    """More parameters than numbers can take up all noise: the log Bayes factor was 14."""
    built = perturb(plant(robot("ur10e")), 6, length_mm=0.03, angle_mrad=0.03)
    d = diagnose(robot("ur10e"), from_table(campaign(built, 30, 6, noise_mm=0.02), 6), ["joint_error_curve"])
    assert d.verdict == "none"
    assert d.rankings[0].log_factor["joint_error_curve"] < -5


def test_sizes_are_learnt_by_part() -> None:
    """Three parts of 60 columns whose parameters were drawn 0.5, 1 and 4 sizes wide, and a part that shows nothing."""
    rng = np.random.default_rng(7)
    e = small_problem(n=400)
    E = 4e-5 * rng.normal(size=(400, 3, 200))
    E[:, :, 180:] = 0.0
    true = np.repeat([0.5, 1.0, 4.0, 1.0], [60, 60, 60, 20])
    r = e.J @ e.delta0 + E @ (true * rng.normal(size=200)) + 2e-5 * rng.normal(size=(400, 3))
    parts = {1: np.arange(60), 2: np.arange(60, 120), 3: np.arange(120, 180), 4: np.arange(180, 200)}
    held = np.ones(200)
    factors, noise = learnt_sizes(
        replace(e, r=r, E=E, cause_prior=held), np.arange(200), parts, np.zeros(0, dtype=np.int64), Noise(4e-5, 0.0)
    )
    assert [factors[k] for k in (1, 2, 3)] == pytest.approx([0.5, 1.0, 4.0], rel=0.25)
    assert factors[4] == 1.0
    assert noise.sigma == pytest.approx(2e-5, rel=0.1)


def test_learnt_sizes_stay_where_other_causes_get_further_settings() -> None:
    known = case("ur10e-P03", "joint_error_curve", "transmission_ripple")
    curve = next(c for c in known.candidates if c.label == "joint_error_curve").variants[0][0]
    sized, effect = known.with_sizes(curve, dict.fromkeys(curve.parts, 0.5), Noise(2e-5, 0.0))
    own = sized.columns[effect]
    before = sized.whole.cause_prior_sigmas[own]
    assert before == pytest.approx(0.5 * known.whole.cause_prior_sigmas[own])
    more = sized.with_variants({(TransmissionRipple(2, cycles=9.3),): "transmission_ripple@2"})
    assert more.whole.width > sized.whole.width
    for problem in (more.whole, more.evidence):
        assert problem.cause_prior_sigmas[own] == pytest.approx(before)
        assert len(problem.cause_prior_sigmas) == problem.width


def test_many_poses_have_more_harmonics() -> None:
    curve = JointErrorCurve(None, (TYPICAL_HARMONIC_RAD, 0.0, TYPICAL_HARMONIC_RAD))
    assert curve.for_poses(100) is curve
    assert curve.for_poses(1000).orders == EXTENDED_ORDERS
    # Seven angles of joint 1 in 36 poses determine three of its harmonics; 30 of 36 are no repeated ones.
    assert [*curve.for_poses(36, [7, 36, 30]).parts] == [3]
    assert len(curve.sizes()) == 2 * 2 * DEFAULT_ORDERS
    assert [*curve.parts] == [1, 3]
    assert {name.split("_")[1] for k, name in enumerate(curve.sizes()) if k in curve.parts[3]} == {"q3"}
    with pytest.raises(InputError, match="spread"):
        JointErrorCurve.from_dict({"settings": {"spread": "wide"}})

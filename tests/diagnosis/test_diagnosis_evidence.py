"""Marginal likelihoods against the normal distribution that they are, written out in full."""

from dataclasses import replace

import numpy as np
import pytest
from cases import case, diagnose, practice, robot, small_problem, with_none
from scipy.stats import multivariate_normal

from casadical import InputError
from casadical.core.basics import Array
from casadical.diagnosis import bootstrap
from casadical.diagnosis.evidence import KAPPA_GRID, RHO_GRID, SIGMA_GRID_M, WIDE_SIGMA_GRID_M, BaseParameters, Evidence
from casadical.diagnosis.noise_evidence import WHITE_FORM, Problem
from casadical.diagnosis.noise_floor import noise_floor, outlier_probability, scatter_of_coordinate
from casadical.diagnosis.posterior import rank
from casadical.measurements.measurements import Noise


@pytest.mark.parametrize("off", [0.0, 1.0, 6.0])
def test_noise_is_the_same_however_far_a_robot_departs_from_its_priors(off: float) -> None:
    """Priors of what the data determine tell nothing of the noise: what is left does, over its degrees of freedom."""
    rng = np.random.default_rng(4)
    J, prior, white = rng.normal(size=(20, 3, 12)), np.full(12, 1e-3), 5e-6 * rng.normal(size=(20, 3))
    e = Evidence(J @ (off * prior) + white, J, np.zeros(12), prior, np.zeros((20, 3, 1)), Jq=np.zeros((20, 3, 1)))
    share = np.exp(BaseParameters.restricted(e)[0].log_base()[0])
    rest = white.ravel() - J.reshape(60, 12) @ np.linalg.lstsq(J.reshape(60, 12), white.ravel(), rcond=None)[0]
    left = np.sqrt((rest**2).sum() / (60 - 12))
    assert np.exp((share * np.log(SIGMA_GRID_M)).sum() / share.sum()) == pytest.approx(left, rel=0.03)


def test_what_moves_nothing_is_not_in_the_model_and_changes_no_evidence() -> None:
    """Parameters of a curve at angles that no pose has: many of them, with a prior mean of their own."""
    rng = np.random.default_rng(5)
    e = small_problem()
    still = np.zeros((*e.r.shape, 40))
    mixed = np.linalg.qr(rng.normal(size=(e.J.shape[2] + 40,) * 2))[0]
    J, prior = np.concatenate([e.J * e.prior, still], axis=2) @ mixed, np.full(len(mixed), 1.0)
    mean = mixed.T @ np.append(e.delta0 / e.prior, rng.normal(size=40))
    wide, base = BaseParameters.restricted(replace(e, J=J, prior=prior, delta0=mean))
    own, groups = BaseParameters.restricted(e)[0], [np.array([0]), np.array([1, 2])]
    assert wide.J.shape[2] == own.J.shape[2]
    np.testing.assert_allclose(wide.log_grids(groups), own.log_grids(groups), rtol=1e-7, atol=1e-6)
    every, units = base.with_all_combinations(wide, np.arange(len(e.r)))
    assert every.J.shape[2] == units.shape[1] == len(mixed)
    np.testing.assert_allclose(every.J @ every.delta0, wide.J @ wide.delta0, atol=1e-12)
    more = wide.with_base(np.array([3]))
    np.testing.assert_allclose(more.log_base(), own.with_base(np.array([3])).log_base(), rtol=1e-7, atol=1e-6)


def test_wider_noise_grid_holds_the_usual_one() -> None:
    e = small_problem()
    wide, groups = replace(e, sigmas=WIDE_SIGMA_GRID_M), [np.array([0]), np.array([1, 2])]
    usual = slice(8, 8 + len(SIGMA_GRID_M))
    np.testing.assert_allclose(WIDE_SIGMA_GRID_M[usual], SIGMA_GRID_M, rtol=1e-12)
    np.testing.assert_allclose(wide.log_base()[:, usual], e.log_base(), rtol=1e-9)
    np.testing.assert_allclose(wide.log_grids(groups)[:, :, usual], e.log_grids(groups), rtol=1e-9)


def test_column_inside_the_base_says_nothing() -> None:
    """A cause that a freely known base parameter reproduces gains no evidence, however large its columns."""
    e = small_problem()
    E = np.concatenate([e.take(np.arange(e.width)), 1e-2 * e.J[:, :, [3]]], axis=2)
    known = Evidence(e.r, e.J, e.delta0, np.full(5, 1e3), E, Jq=e.Jq)
    grids = known.log_grids([np.array([4])])
    gain = grids[0] - known.log_base()[:, :, None]
    assert np.abs(gain[np.isfinite(gain)]).max() < 1e-3


@pytest.mark.parametrize("noise", [Noise(2e-5, 0.0), Noise(1e-8, 2e-5)], ids=["instrument", "joints"])
def test_the_floor_grows_with_the_noise_that_something_else_says(noise: Noise) -> None:
    e = small_problem(n=20)
    told = scatter_of_coordinate(e, noise)
    assert noise_floor(e, noise, told, seed=0) == pytest.approx(noise_floor(e, noise, 0.0, seed=0))
    assert noise_floor(e, noise, 2 * told, seed=0) == pytest.approx(2 * noise_floor(e, noise, told, seed=0), rel=0.2)


def test_outliers_have_the_probability_of_their_distance() -> None:
    """Certain far out, hardly any where noise reaches; between them by the densities of both."""
    assert outlier_probability(np.array([200.0])) > 0.999
    assert outlier_probability(np.array([3.0])) < 0.02
    k = np.geomspace(3.0, 300.0, 9)
    wide = np.mean([multivariate_normal(cov=t**2 * np.eye(3)).pdf([4.0, 0, 0]) for t in k])
    usual = multivariate_normal(cov=np.eye(3)).pdf([4.0, 0, 0])
    one = 0.01 * wide / (0.01 * wide + 0.99 * usual)
    assert outlier_probability(np.array([16.0])) == pytest.approx(one)
    assert outlier_probability(np.array([16.0, 16.0])) == pytest.approx(1 - (1 - one) ** 2)


# A table of few numbers beside a larger one: the first poses, of 30 numbers, and the other 90.
FEW_POSES, SIGMA = 10, 16


def two_tables(times: float) -> Evidence:
    """Noise of the few poses is so many times what it is taken for, by its rms; a base that its prior holds."""
    rng = np.random.default_rng(6)
    J, Jq, E = rng.normal(size=(40, 3, 2)), 0.3 * rng.normal(size=(40, 3, 2)), 2e-5 * rng.normal(size=(40, 3, 2))
    r = rng.normal(size=(40, 3))
    r[:FEW_POSES] *= times / np.sqrt(np.mean(r[:FEW_POSES] ** 2))
    few = np.repeat(np.arange(40) < FEW_POSES, 3).reshape(40, 3)
    r *= SIGMA_GRID_M[SIGMA]
    return Evidence(r, J, np.zeros(2), np.full(2, 1e-5), E, Jq=Jq, unsure=(few,))


def densities(e: Evidence, rho: int, column: int | None, logs: Array) -> Array:
    """Log density of the residuals by their whole covariance, where the few numbers are as noisy as these logs say."""
    few, J = e.unsure[0].ravel(), e.J.reshape(e.r.size, -1) * e.prior / e.reference
    known = SIGMA_GRID_M[SIGMA] ** 2 * J @ J.T
    if column is not None:
        own = e.take(np.array([column])).ravel()
        known += KAPPA_GRID[2] ** 2 * np.outer(own, own)
    for k, Jq in enumerate(e.Jq):
        known[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += (SIGMA_GRID_M[SIGMA] * RHO_GRID[rho]) ** 2 * Jq @ Jq.T
    white = [np.diag(np.where(few, np.exp(2 * t), 1.0)) for t in logs]
    return np.array(
        [multivariate_normal(cov=known + SIGMA_GRID_M[SIGMA] ** 2 * own).logpdf(e.r.ravel()) for own in white]
    )


@pytest.mark.parametrize("times", [0.85, 1.0, 1.2])
@pytest.mark.parametrize("rho", [0, 3])
def test_evidence_is_averaged_over_what_the_noise_of_few_numbers_may_be(times: float, rho: int) -> None:
    """One sigma of the logarithm of these numbers' noise is .13; against an integral over all that it may be."""
    e, logs = two_tables(times), np.linspace(-1.2, 1.2, 97)
    spread = 1 / np.sqrt(2 * 3 * FEW_POSES)
    weight = np.log((logs[1] - logs[0]) / (spread * np.sqrt(2 * np.pi)))
    groups = [np.array([0]), np.array([1])]
    sure = replace(e, unsure=())
    for column in (None, 0, 1):
        (of_sure, of_all) = (
            problem.log_base()[rho, SIGMA] if column is None else problem.log_grids(groups)[column, rho, SIGMA, 2]
            for problem in (sure, e)
        )
        gained = (
            float(np.logaddexp.reduce(densities(e, rho, column, logs), axis=None) + weight)
            - densities(e, rho, column, np.zeros(1))[0]
        )
        assert of_all - of_sure == pytest.approx(gained, abs=0.1)


def test_two_tables_of_few_numbers_are_averaged_over_both() -> None:
    """Against an integral over a plane; the second one has 45 numbers."""
    e = two_tables(1.1)
    (few,) = e.unsure
    other = np.repeat((np.arange(40) >= FEW_POSES) & (np.arange(40) < FEW_POSES + 15), 3).reshape(40, 3)
    both, logs = replace(e, unsure=(few, other)), np.linspace(-0.6, 0.6, 16)
    total = []
    for t in logs:
        times = np.where(other, np.exp(t), 1.0)
        moved = replace(e, r=e.r / times, J=e.J / times[:, :, None], Jq=e.Jq / times[:, :, None])
        total.append(densities(moved, 0, None, logs) - np.log(times).sum())
    weight = sum(np.log((logs[1] - logs[0]) * np.sqrt(2 * m.sum() / (2 * np.pi))) for m in (few, other))
    gained = float(np.logaddexp.reduce(np.array(total), axis=None) + weight) - densities(e, 0, None, np.zeros(1))[0]
    alone = replace(e, unsure=()).log_base()[0, SIGMA]
    assert both.log_base()[0, SIGMA] - alone == pytest.approx(gained, abs=0.1)


def test_what_the_base_absorbs_makes_the_noise_of_few_numbers_less_sure() -> None:
    """Of 120 numbers the base takes 60: the 30 tell as much as 15."""
    e = replace(two_tables(1.0), absorbed=60.0)
    few = e.unsure[0]
    (_, finer), (_, noisier) = e.at_other_ratios
    assert noisier.r[few] == pytest.approx(e.r[few] / np.exp(np.sqrt(3) / np.sqrt(2 * 15)))
    assert finer.r[few] == pytest.approx(e.r[few] * np.exp(np.sqrt(3) / np.sqrt(2 * 15)))
    assert "at_other_ratios" in vars(e)
    e.forget()
    assert "at_other_ratios" not in vars(e)


def test_forms_of_noise_are_averaged_as_the_plain_one_is() -> None:
    e = two_tables(1.2)
    chosen = np.array([1])
    found = Problem(e, chosen, np.random.default_rng(0).permutation(40)).log_likelihood(WHITE_FORM)
    np.testing.assert_allclose(found, e.log_base(chosen), rtol=1e-9)


NOTHING = np.zeros(0, dtype=np.int64)
FEW = ("backlash@2", "friction_windup@2", "gear_eccentricity@3")


def odds_in_full(c, r: np.ndarray) -> float:
    """Log odds of some cause by the judgement that a diagnosis makes, for another residual."""
    e = replace(c.evidence, r=r, delta0=np.zeros_like(c.evidence.delta0))
    none = rank(replace(c, whole=e, inliers=np.ones(len(r), dtype=bool)), NOTHING).none
    return float(np.log1p(-none) - np.log(none))


def test_odds_of_noise_are_those_of_the_full_judgement() -> None:
    """But for sizes of noise that the data exclude, which are left out."""
    c = case("kr210-P08", *FEW)
    share = np.exp(c.evidence.log_base() - np.logaddexp.reduce(c.evidence.log_base(), axis=None))
    drawn = bootstrap.noise_alone(c.evidence, share, 6, np.random.default_rng(3))
    (odds,) = bootstrap.noise_odds(c, 6, np.random.default_rng(3))
    assert odds == pytest.approx([odds_in_full(c, r) for r in np.moveaxis(drawn, 2, 0)], abs=0.2)


def test_p_value_counts_draws_beyond_the_data() -> None:
    c = case("kr210-P08", *FEW)
    ranking = rank(c, NOTHING)
    heard: list[str] = []
    p = bootstrap.p_value(c, ranking, 700, 0, heard.append)
    assert p == bootstrap.p_value(c, ranking, 700, 0, heard.append)
    assert 0.05 < p <= 1
    assert len(heard) == 4
    assert bootstrap.p_value(c, with_none(ranking, 1e-12), 100, 0, heard.append) == pytest.approx(1 / 101)


@pytest.mark.slow
def test_diagnosis_with_a_bootstrap() -> None:
    d = diagnose(robot("ur10e"), practice("ur10e-P06"), ["friction_windup", "backlash"], bootstrap=200)
    assert d.p_nothing == pytest.approx(1 / 201)
    assert d.verdict == "explained"
    d = diagnose(robot("kr210"), practice("kr210-P08"), list(FEW), bootstrap=200)
    assert d.p_nothing > 0.01
    assert d.verdict == "none"


def test_negative_number_of_draws_is_refused() -> None:
    with pytest.raises(InputError, match="bootstrap is -1"):
        diagnose(robot("kr210"), practice("kr210-P08"), list(FEW), bootstrap=-1)

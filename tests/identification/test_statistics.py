"""Covariances, knees, outliers, bounds and correlations against their textbook formulas, written out here."""

from dataclasses import replace

import arms
import numpy as np
import pytest
from scipy import stats

from casadical import identify
from casadical.core.parameters import Parameter
from casadical.identification.identifiability import drop_poor
from casadical.identification.reduction import outlier_masks
from casadical.identification.residuals import loss_and_slope

ARM = arms.six_axis()
KINDS = {"distance": 1, "position": 3, "pose": 6}
FREE = ["placement", "theta2", "theta3", "a2"]


@pytest.fixture(scope="module")
def built():
    return arms.planted_in(ARM, ARM.parameters.select(FREE), 4)


def heavy_tailed(built, kind):
    """Poses of one kind, every fourth far out."""
    q = arms.readings(built, 80, 31)
    wide = np.where(np.arange(80) % 4 == 0, 8.0, 1.0)[:, None]
    rng = np.random.default_rng(32)
    if kind == "distance":
        m = arms.distances(built, q, np.array([2.0, 1.0, 0.5]), 33, known=True)
        return replace(
            m, sigma=arms.NOISE, distance=m.distance + arms.NOISE * (wide * rng.normal(size=(80, 1))).ravel()
        )
    m = arms.positions(built, q, 33) if kind == "position" else arms.poses(built, q, 33)
    wrong = m.position + arms.NOISE * wide * rng.normal(size=(80, 3))
    return replace(m, position=wrong, sigma=arms.NOISE, sigma_angle=1e-4 if kind == "pose" else None)


@pytest.mark.parametrize("kind", KINDS)
def test_a_robust_covariance_is_the_sandwich_of_hubers_weights(built, kind) -> None:
    """H^-1 (J' W^2 J) H^-1, weight 1 up to the 95 % quantile of chi-squared and root(quantile / square) beyond."""
    result = identify(ARM, heavy_tailed(built, kind), FREE, loss="huber", screen=False)
    residuals, J = result.problem.evaluate(result.solution.v)
    square = (residuals[0] ** 2).sum(axis=1)
    knee = stats.chi2.ppf(0.95, KINDS[kind])
    assert 5 < (square > knee).sum() < 40
    W = np.repeat(np.minimum(1, np.sqrt(knee / square)), KINDS[kind])[:, None]
    inverse = np.linalg.inv(J.T @ (W * J))
    sandwich = inverse @ (J.T @ (W**2 * J)) @ inverse
    scale = result.problem.scale
    found = result.covariance / np.outer(scale, scale) / result.variance
    assert np.diag(found) == pytest.approx(np.diag(sandwich), rel=0.003)
    assert abs(np.diag(inverse) / np.diag(sandwich) - 1).max() > 0.02  # the plain inverse is another


def test_soft_l1_leaves_the_parabola_at_the_same_knee(built) -> None:
    """Its weight is 1 / root(1 + square / knee)."""
    result = identify(ARM, heavy_tailed(built, "position"), FREE, loss="soft_l1", screen=False)
    (residuals,) = result.problem.residuals(result.solution.v)
    weights = 1 / np.sqrt(1 + (residuals**2).sum(axis=1) / stats.chi2.ppf(0.95, 3))
    assert loss_and_slope("soft_l1", residuals)[1] == pytest.approx(weights, rel=1e-3)


def test_outliers_are_judged_by_what_the_fit_left_of_them(built) -> None:
    """A residual has the share 1 - leverage of its own variance: few poses leave little of an outlier."""
    q, found, plain = arms.readings(built, 18, 41), [], []
    m = replace(arms.positions(built, q, 42), sigma=arms.NOISE)
    for size in (6, 7, 8, 9, 10, 11, 12):
        wrong = m.position.copy()
        wrong[3] += size * arms.NOISE * np.array([0.6, -0.64, 0.48])
        result = identify(ARM, replace(m, position=wrong), ["kinematic"], loss="huber", screen=False)
        residuals, J = result.problem.evaluate(result.solution.v)
        square = (residuals[0] ** 2).sum(axis=1)
        W = np.repeat(np.minimum(1, np.sqrt(stats.chi2.ppf(0.95, 3) / square)), 3)
        left = 1 - W * np.einsum("ij,ij->i", J @ np.linalg.pinv(J.T @ (W[:, None] * J)), J)
        far = beyond(residuals[0] / np.sqrt(np.maximum(left, 0.1)).reshape(-1, 3))
        found.append(outlier_masks(result.problem, result.solution)[0].tolist())
        assert found[-1] == far.tolist()
        plain.append(beyond(residuals[0]).tolist())
    assert any(mask[3] for mask in found)
    assert found != plain


def beyond(z):
    """Poses whose square noise would exceed once in 100 000, by the spread of all numbers."""
    spread = np.median(np.abs(z)) / stats.norm.ppf(0.75)
    return (z**2).sum(axis=1) > stats.chi2.isf(1e-5, 3) * spread**2


def test_only_what_touches_its_bound_is_at_it(built) -> None:
    result = identify(ARM, arms.positions(built, arms.readings(built, 30, 51), 52), ["theta2", "a2"])
    lower, upper = result.problem.bounds
    width = upper - lower
    for share, stopped in ((0.0, True), (1e-4, False), (2e-3, False)):
        assert result.problem.at_bounds(upper - share * width).tolist() == [stopped, stopped]
        assert result.problem.at_bounds(lower + share * width).tolist() == [stopped, stopped]


def test_partners_are_those_correlated_by_nine_tenths_whatever_the_units() -> None:
    """Two parameters by -0.98 and a third that hardly hangs with them, all with standard errors far below one."""
    parameters = [Parameter(name, "geometry", "m", 0.0, 1e-3, -1.0, 1.0, prior) for name, prior in
                  (("worst", 1e-5), ("partner", 1.0), ("other", 1.0))]  # fmt: skip
    errors = np.array([0.02, 0.05, 0.03])
    C = np.array([[1, -0.98, 0.3], [-0.98, 1, -0.3], [0.3, -0.3, 1]]) * np.outer(errors, errors)
    kept, poor, covariance = drop_poor(parameters, np.linalg.inv(C))
    assert kept == [1, 2]
    assert [*poor] == ["worst"]
    assert poor["worst"].endswith("it moves the measured points nearly as partner does")
    assert np.diag(covariance) == pytest.approx(np.diag(np.linalg.inv(np.linalg.inv(C)[1:, 1:])))

"""Noise, estimates, predictions of what was left out, roots of normal matrices: against dense solves."""

from dataclasses import replace

import numpy as np
import pytest
from models import FALLING, RATIOS, noise_of, small_model, without_last_rows

from casadical.core.linear_gaussian import normal_equations
from casadical.core.linear_gaussian.fit import Fit
from casadical.core.linear_gaussian.model import LinearModel, MemoryLimits
from casadical.core.linear_gaussian.noise import axes_of, covariance_of, whitening_of
from casadical.core.linear_gaussian.normal_equations import joined, marginalised, normal_sums, root_of_inverse

SIGMA, POINT, COLUMNS = 0.1, 1, np.array([0, 2, 5])


def dense(model: LinearModel, blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Estimate from some blocks and its covariance, by one solve of the normal equations."""
    n, m = model.r.shape
    rows = (m * blocks[:, None] + np.arange(m)).ravel()
    A = np.concatenate([model.J, model.E.take(COLUMNS)], axis=2).reshape(n * m, -1)[rows]
    W = np.linalg.inv(noise_of(model, POINT, SIGMA)[np.ix_(rows, rows)])
    P = np.diag(np.concatenate([model.prior, model.cause_prior_sigmas[COLUMNS]]) ** -2.0)
    mean = np.concatenate([model.delta0, np.zeros(len(COLUMNS))])
    covariance = np.linalg.inv(A.T @ W @ A + P)
    return covariance @ (A.T @ W @ model.r.ravel()[rows] + P @ mean), covariance


def fitted(model: LinearModel) -> Fit:
    return Fit(model, COLUMNS, SIGMA, float(model.ratios[POINT]))


MODELS = {
    "ratios that rise": small_model(RATIOS, n=12),
    "ratios that fall": small_model(FALLING, n=12),
    "blocks of different sizes": without_last_rows(small_model(FALLING, n=12), np.array([3])),
}


@pytest.mark.parametrize("name", MODELS)
def test_estimates_are_those_of_a_dense_solve(name: str) -> None:
    model = MODELS[name]
    fit = fitted(model)
    x, covariance = dense(model, np.arange(12))
    np.testing.assert_allclose(fit.x, x, rtol=1e-9)
    np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-8, atol=1e-12)
    value, error = fit.causes
    np.testing.assert_allclose(value, x[4:], rtol=1e-9)
    np.testing.assert_allclose(error, np.sqrt(np.diag(covariance))[4:], rtol=1e-9)


MEMORY = {
    "among observations": MemoryLimits(),
    "among parameters": MemoryLimits(max_observation_rows=0),
    "columns made again": MemoryLimits(cache_bytes=0),
}


@pytest.mark.parametrize("memory", MEMORY)
@pytest.mark.parametrize("name", MODELS)
def test_blocks_left_out_are_predicted_by_the_others(name: str, memory: str) -> None:
    model = replace(MODELS[name], memory=MEMORY[memory])
    fit = fitted(model)
    A = np.concatenate([model.J, model.E.take(COLUMNS)], axis=2)
    for out in (np.array([3]), np.array([0, 5, 11]), np.arange(7)):
        x, _ = dense(model, np.setdiff1d(np.arange(12), out))
        np.testing.assert_allclose(fit.residual_without(out), (model.r - A @ x)[out], rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(fit.estimate_from(np.setdiff1d(np.arange(12), out)), x, rtol=1e-7)
    alone = [model.r[k] - A[k] @ dense(model, np.setdiff1d(np.arange(12), [k]))[0] for k in range(12)]
    np.testing.assert_allclose(fit.leave_one_out_residuals(), alone, rtol=1e-7, atol=1e-9)


def test_noise_is_made_white_by_its_covariance() -> None:
    """With a ratio for each source, and in axes as by a triangle."""
    Jq, each = np.random.default_rng(0).normal(size=(5, 3, 4)), np.array([0.1, 0.0, 2.0, 0.5])
    for A, C in zip(Jq * each, covariance_of(Jq, each, 1.5), strict=True):
        np.testing.assert_allclose(C, 1.5**2 * np.eye(3) + A @ A.T)
    ratios = np.array([0.3, 0.0])
    axes = axes_of(Jq, ratios)
    for k, ratio in enumerate(ratios):
        C = covariance_of(Jq, ratio)
        W, log_det = whitening_of(C)
        np.testing.assert_allclose(W @ C @ W.transpose(0, 2, 1), np.tile(np.eye(3), (5, 1, 1)), atol=1e-12)
        assert log_det == pytest.approx(np.linalg.slogdet(C)[1].sum())
        assert axes.log_det[k] == pytest.approx(log_det)
        by_axes = axes.rotation * axes.precision[k][:, None] @ axes.rotation.transpose(0, 2, 1)
        np.testing.assert_allclose(by_axes, np.linalg.inv(C), atol=1e-12)


def test_a_root_of_the_inverse_holds_for_columns_of_very_unlike_length() -> None:
    A = np.random.default_rng(1).standard_normal((300, 120)) * np.geomspace(1e-9, 1e9, 120)
    normal = A.T @ A
    root = root_of_inverse(normal)
    assert root @ normal @ root.T == pytest.approx(np.eye(120), abs=1e-8)


def test_what_is_not_positive_definite_is_refused() -> None:
    for of in (root_of_inverse, lambda m: joined(m, np.ones(2), 0.0, 0.0)):
        with pytest.raises(np.linalg.LinAlgError):
            of(np.array([[1.0, 2.0], [2.0, 1.0]]))


def test_what_round_off_takes_from_a_normal_matrix_stops_nothing() -> None:
    """Two columns alike to the last digits: the scaled matrix is singular, and may be below zero by round-off."""
    J = np.random.default_rng(0).normal(size=(40, 30)) * 10.0 ** np.linspace(-6, 6, 30)
    J[:, 1] = J[:, 0] * 3
    normal = J.T @ J
    normal[0, 1] = normal[1, 0] = np.sqrt(normal[0, 0] * normal[1, 1]) * (1 + 1e-14)
    root = root_of_inverse(normal)
    right = J.T @ (J @ np.ones(30))
    np.testing.assert_allclose(J @ (root.T @ (root @ right)), J @ np.ones(30), rtol=1e-5, atol=1e-3)


def test_what_the_base_takes_is_right_beside_a_direction_that_is_hardly_held() -> None:
    """Its square has more digits than numbers have: what is computed from squares alone loses the others."""
    model, rng, size = small_model(RATIOS, n=12), np.random.default_rng(0), np.array([1e10, 2.0, 1.0, 0.1])
    rows, turn = np.linalg.qr(rng.normal(size=(36, 4)))[0], np.linalg.qr(rng.normal(size=(4, 4)))[0]
    wide = replace(model, J=((rows * size) @ turn.T).reshape(12, 3, 4), prior=np.full(4, model.reference))
    assert wide.absorbed_by_base == pytest.approx((size**2 / (1 + size**2)).sum(), rel=1e-5)


def test_sums_are_added_taken_off_and_moved() -> None:
    rng = np.random.default_rng(0)
    y, A, x = rng.normal(size=(6, 3)), rng.normal(size=(6, 3, 4)), rng.normal(size=4)
    whole, part = normal_sums(y, A), normal_sums(y[:2], A[:2])
    for found, expected in (
        (whole.less(part), normal_sums(y[2:], A[2:])),
        (whole.less(part).plus(part), whole),
        (whole.moved(x), normal_sums(y + A @ x, A)),
    ):
        np.testing.assert_allclose(found.H, expected.H, atol=1e-12)
        np.testing.assert_allclose(found.g, expected.g, atol=1e-12)
        assert found.square == pytest.approx(expected.square)
        assert found.count == expected.count


def test_parameters_not_asked_for_are_integrated() -> None:
    A = np.random.default_rng(0).normal(size=(20, 5))
    H, g, kept, rest = A.T @ A, A.T @ np.arange(20.0), np.array([3, 0]), np.array([1, 2, 4])
    P = np.diag([4.0, 1.0, 0.5])
    own, score = marginalised(H, g, kept, np.linalg.inv(H[np.ix_(rest, rest)] + P))
    whole = H.copy()
    whole[np.ix_(rest, rest)] += P
    covariance = np.linalg.inv(whole)
    np.testing.assert_allclose(np.linalg.inv(own), covariance[np.ix_(kept, kept)])
    np.testing.assert_allclose(np.linalg.solve(own, score), (covariance @ g)[kept])


@pytest.mark.parametrize("weak", [1.0, 1e-3, 1e-5])
def test_a_step_is_that_of_the_least_squares_problem(weak: float) -> None:
    """Columns are in units eight decades apart, and the last one is nearly that before it."""
    A = np.random.default_rng(3).normal(size=(30, 6))
    A[:, 5] = A[:, 4] + weak * A[:, 5]
    J, r = A * 10.0 ** np.arange(-4, 5)[[0, 2, 4, 6, 8, 8]], A @ np.ones(6)
    assert np.linalg.norm(J @ normal_equations.scaled_solution(J.T @ J, J.T @ r) - r) < 1e-5 * np.linalg.norm(r)

"""Held-out errors, estimates and intervals against naive refits and known cases."""

from dataclasses import replace

import numpy as np
import pytest
from cases import small_problem
from scipy.optimize import lsq_linear

from casadical.core.linear_gaussian.model import MemoryLimits
from casadical.diagnosis.cross_validation import (
    errors_and_distances,
    fit_of,
    fold_errors,
    held_out_errors,
    likely_noise,
    new_fit,
    random_folds,
    shrink_interval,
)
from casadical.diagnosis.evidence import RHO_GRID, SIGMA_GRID_M, WIDE_SIGMA_GRID_M, Evidence
from casadical.effects.base import CAUSE_PRIOR_SIGMA
from casadical.measurements.measurements import Noise

NOISE = Noise(2e-5, 8e-6)


def refit(e: Evidence, columns: np.ndarray, use: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parameters and their covariance, from one tall least-squares problem with the priors as rows."""
    A, b = [], []
    for k in np.flatnonzero(use):
        W = np.linalg.inv(np.linalg.cholesky(NOISE.sigma**2 * np.eye(3) + NOISE.repeatability**2 * e.Jq[k] @ e.Jq[k].T))
        A.append(W @ np.hstack([e.J[k], e.take(np.arange(e.width))[k][:, columns]]))
        b.append(W @ e.r[k])
    prior = np.concatenate([e.prior, np.full(len(columns), CAUSE_PRIOR_SIGMA)])
    mean = np.concatenate([e.delta0, np.zeros(len(columns))])
    A, b = np.vstack([*A, np.diag(1 / prior)]), np.concatenate([*b, mean / prior])
    scale = np.linalg.norm(A, axis=0)
    x = lsq_linear(A / scale, b, tol=1e-14, lsq_solver="exact").x / scale
    return x, np.linalg.inv((A / scale).T @ (A / scale)) / np.outer(scale, scale)


@pytest.mark.parametrize("folds", [random_folds(14, 3), np.arange(14)], ids=["fifths", "each pose"])
def test_held_out_errors_are_those_of_refits(folds: np.ndarray) -> None:
    e, columns = small_problem(n=14), np.array([0, 2])
    expected = np.empty(14)
    for fold in np.unique(folds):
        x, _ = refit(e, columns, folds != fold)
        for k in np.flatnonzero(folds == fold):
            expected[k] = np.linalg.norm(e.r[k] - np.hstack([e.J[k], e.take(np.arange(e.width))[k][:, columns]]) @ x)
    np.testing.assert_allclose(held_out_errors(e, columns, NOISE, folds), expected, rtol=1e-7)


def test_estimates_and_remainders_are_those_of_a_refit() -> None:
    e, columns = small_problem(n=14), np.array([0, 2])
    x, cov = refit(e, columns, np.ones(14, dtype=bool))
    value, error = fit_of(e, columns, NOISE).causes
    np.testing.assert_allclose(value, x[5:], rtol=1e-7)
    np.testing.assert_allclose(error, np.sqrt(np.diag(cov))[5:], rtol=1e-7)
    kept = np.arange(14) != 4
    x, _ = refit(e, columns, kept)
    length, distance = errors_and_distances(e, columns, NOISE, kept)
    for k in (4, 7):  # one that was left out anyway, and one that is now
        A = np.hstack([e.J[k], e.take(np.arange(e.width))[k][:, columns]])
        assert length[k] == pytest.approx(np.linalg.norm(e.r[k] - A @ x))
        alone, cov = refit(e, columns, kept & (np.arange(14) != k))
        left, spread = e.r[k] - A @ alone, e.covariance(NOISE)[k] + A @ cov @ A.T
        assert distance[k] == pytest.approx(left @ np.linalg.solve(spread, left))


def test_many_poses_and_few_are_left_out_alike() -> None:
    """The three ways of leaving poses out, among observations, in a second form, by refitting, agree."""
    e, columns = small_problem(n=40), np.array([0, 2])
    folds, alone = random_folds(40, 3), np.arange(40)
    expected = held_out_errors(e, columns, NOISE, folds), held_out_errors(e, columns, NOISE, alone)
    for memory in (MemoryLimits(max_observation_rows=0), MemoryLimits(cache_bytes=0)):
        own = replace(e, memory=memory)
        assert own.memory is memory
        fit = new_fit(own, columns, NOISE)
        np.testing.assert_allclose(fold_errors(e, fit, folds), expected[0], rtol=1e-7)
        np.testing.assert_allclose(fold_errors(e, fit, alone), expected[1], rtol=1e-7)


def test_folds_are_even_and_seeded() -> None:
    folds = random_folds(23, 1)
    assert sorted(np.bincount(folds)) == [4, 4, 5, 5, 5]
    np.testing.assert_array_equal(folds, random_folds(23, 1))
    assert (folds != random_folds(23, 2)).any()


def test_most_likely_noise_is_the_grids_top() -> None:
    grid = np.full((len(RHO_GRID), len(SIGMA_GRID_M), 2), -5.0)
    grid[2, 11, 1] = 0.0
    assert likely_noise(grid) == Noise(SIGMA_GRID_M[11], RHO_GRID[2] * SIGMA_GRID_M[11])
    wide = np.full((len(RHO_GRID), len(WIDE_SIGMA_GRID_M), 2), -5.0)
    wide[2, 19, 1] = 0.0
    assert likely_noise(wide, WIDE_SIGMA_GRID_M).sigma == pytest.approx(SIGMA_GRID_M[11], rel=1e-12)
    assert WIDE_SIGMA_GRID_M[0] < 1e-6 < 1e-2 < WIDE_SIGMA_GRID_M[-1]


def test_poses_of_one_stop_are_held_out_together() -> None:
    stop = np.random.default_rng(1).permutation(np.repeat(np.arange(20), 3))
    folds = random_folds(60, 0, stop=stop)
    assert [len({*folds[stop == k]}) for k in range(20)] == [1] * 20
    assert [len({*stop[folds == fold]}) for fold in range(5)] == [4] * 5


@pytest.mark.parametrize("targets", [1, 3])
def test_shrink_interval_covers(targets: int) -> None:
    """Of 200 campaigns of 60 stops, whose targets share an error, 95 % hold the true ratio of means."""
    rng, hits, stop = np.random.default_rng(0), 0, np.repeat(np.arange(60), targets)
    for seed in range(200):
        before = np.repeat(rng.gamma(3.0, 1.0, 60), targets)
        after = 0.5 * before * np.repeat(rng.gamma(8.0, 1 / 8.0, 60), targets)
        low, high = shrink_interval(before, after, seed, stop if targets > 1 else None)
        hits += low <= 0.5 <= high
    assert 182 <= hits <= 198

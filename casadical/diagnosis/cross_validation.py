"""The gap on poses that the fit never saw: before and after causes are added, next to the noise floor.

Each fold is fitted in closed form from the residual, base model and causes together, with the priors that the
evidence uses; the errors are those of the poses left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadical.core.transforms import Array
from casadical.diagnosis.evidence import RHOS, SIGMAS, Evidence
from casadical.diagnosis.thresholds import PARTITIONS

FOLDS = 5


@dataclass(frozen=True)
class Noise:
    """Instrument [m a coordinate] and joint repeatability [rad]."""

    sigma: float
    repeatability: float


def likely_noise(log_grid: Array) -> Noise:
    """The most probable noise of a log likelihood over (rhos, sigmas, ...)."""
    grid = log_grid.reshape(len(RHOS), len(SIGMAS), -1).max(axis=2)
    rho, sigma = np.unravel_index(int(np.argmax(grid)), grid.shape)
    return Noise(float(SIGMAS[sigma]), float(RHOS[rho] * SIGMAS[sigma]))


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations of base model and causes together, pose by pose."""

    A: Array
    H: Array
    g: Array
    prior: Array
    mean: Array

    def solve(self, use: Array) -> Array:
        """The fit to the poses in a mask."""
        return self.solution(self.H[use].sum(axis=0), self.g[use].sum(axis=0))

    def solution(self, H: Array, g: Array) -> Array:
        """The fit to poses whose normal equations sum to these."""
        normal = H + np.diag(self.prior**-2)
        scale = np.sqrt(np.diag(normal))
        right = g + self.mean / self.prior**2
        return np.asarray(np.linalg.solve(normal / np.outer(scale, scale), right / scale) / scale)


def _normal(e: Evidence, columns: Array, noise: Noise) -> _Normal:
    A = np.concatenate([e.J, e.take(columns)], axis=2)
    AW = np.einsum("nip,nij->npj", A, np.linalg.inv(covariance(e, noise)))
    return _Normal(
        A,
        AW @ A,
        np.einsum("npj,nj->np", AW, e.r),
        np.concatenate([e.prior, e.width_in_model(columns)]),
        np.concatenate([e.delta0, np.zeros(len(columns))]),
    )


def covariance(e: Evidence, noise: Noise) -> Array:
    """Of the noise of each measured position, shape (n, 3, 3) [m^2]."""
    return noise.sigma**2 * np.eye(3) + noise.repeatability**2 * e.Jq @ e.Jq.transpose(0, 2, 1)


def held_out_errors(e: Evidence, columns: Array, noise: Noise, folds: Array) -> Array:
    """Position error of each pose, shape (n,) [m], by a fit to the poses of the other folds.

    columns : of the causes in the model; folds : number of the fold of each pose, shape (n,)
    """
    problem = _normal(e, columns, noise)
    H, g = problem.H.sum(axis=0), problem.g.sum(axis=0)
    errors = np.empty(len(e.r))
    for fold in np.unique(folds):
        test = folds == fold
        x = problem.solution(H - problem.H[test].sum(axis=0), g - problem.g[test].sum(axis=0))
        errors[test] = np.linalg.norm(e.r[test] - problem.A[test] @ x, axis=1)
    return errors


def partitions(n: int, seed: int) -> list[Array]:
    """Several partitions of n poses into folds."""
    return [random_folds(n, seed + k) for k in range(PARTITIONS)]


def partitioned_errors(e: Evidence, columns: Array, noise: Noise, seed: int) -> Array:
    """Held-out error of each pose, shape (n,) [m], averaged over partitions."""
    runs = [held_out_errors(e, columns, noise, folds) for folds in partitions(len(e.r), seed)]
    return np.asarray(np.mean(runs, axis=0))


def fitted_without(e: Evidence, columns: Array, noise: Noise, test: Array) -> Array:
    """What a fit to the poses outside of a mask leaves at every pose, shape (n, 3) [m]."""
    problem = _normal(e, columns, noise)
    return np.asarray(e.r - problem.A @ problem.solve(~test))


def remainders(e: Evidence, columns: Array, noise: Noise, kept: Array) -> tuple[Array, Array]:
    """What a fit to the kept poses leaves at every pose: length [m] and squared Mahalanobis distance, shapes (n,)."""
    problem = _normal(e, columns, noise)
    left = e.r - problem.A @ problem.solve(kept)
    distance = np.einsum("ni,nij,nj->n", left, np.linalg.inv(covariance(e, noise)), left)
    return np.linalg.norm(left, axis=1), distance


def estimates(e: Evidence, columns: Array, noise: Noise) -> tuple[Array, Array]:
    """Values and standard errors of the causes' parameters, in sizes, shapes (len(columns),)."""
    problem = _normal(e, columns, noise)
    everyone = np.ones(len(e.r), dtype=bool)
    normal = problem.H.sum(axis=0) + np.diag(problem.prior**-2)
    scale = np.sqrt(np.diag(normal))
    inverse = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    first = e.J.shape[2]
    return problem.solve(everyone)[first:], np.sqrt(np.diag(inverse))[first:]


def random_folds(n: int, seed: int, count: int = FOLDS) -> Array:
    """A fold number for each pose; sizes differ by one at most."""
    return np.random.default_rng(seed).permutation(np.arange(n) % count)


def shrink_interval(before: Array, after: Array, seed: int, draws: int = 2000) -> tuple[float, float]:
    """95 % interval of 1 - mean(after)/mean(before), by bootstrap over poses."""
    pick = np.random.default_rng(seed).integers(0, len(before), (draws, len(before)))
    shrink = 1 - after[pick].mean(axis=1) / before[pick].mean(axis=1)
    low, high = np.quantile(shrink, [0.025, 0.975])
    return float(low), float(high)

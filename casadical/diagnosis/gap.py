"""The gap on poses that the fit never saw: before and after causes are added, next to the noise floor.

Each fold is fitted in closed form from the residual, base model and causes together, with the priors that the
evidence uses; the errors are those of the poses left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..transforms import Array
from .evidence import RHOS, SIGMAS, Evidence

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


def held_out_errors(e: Evidence, columns: Array, noise: Noise, folds: Array, kappa: float = 4.0) -> Array:
    """Position error of each pose, shape (n,) [m], by a fit to the poses of the other folds.

    columns : of the causes in the model; folds : number of the fold of each pose, shape (n,)
    """
    A = np.concatenate([e.J, e.E[:, :, columns]], axis=2)
    prior = np.concatenate([e.prior, np.full(len(columns), kappa)])
    mean = np.concatenate([e.delta0, np.zeros(len(columns))])
    C = noise.sigma**2 * np.eye(3) + noise.repeatability**2 * e.Jq @ e.Jq.transpose(0, 2, 1)
    W = np.linalg.inv(C)
    AW = np.einsum("nip,nij->npj", A, W)
    H = np.einsum("npj,njq->npq", AW, A) if len(A) * A.shape[2] ** 2 < 5e7 else None
    g = np.einsum("npj,nj->np", AW, e.r)
    errors = np.empty(len(A))
    for fold in np.unique(folds):
        train, test = folds != fold, folds == fold
        normal = H[train].sum(axis=0) if H is not None else np.einsum("npj,njq->pq", AW[train], A[train])
        normal = normal + np.diag(prior**-2)
        scale = np.sqrt(np.diag(normal))
        right = g[train].sum(axis=0) + mean / prior**2
        x = np.linalg.solve(normal / np.outer(scale, scale), right / scale) / scale
        errors[test] = np.linalg.norm(e.r[test] - A[test] @ x, axis=1)
    return errors


def random_folds(n: int, seed: int, count: int = FOLDS) -> Array:
    """A fold number for each pose; sizes differ by one at most."""
    return np.random.default_rng(seed).permutation(np.arange(n) % count)


def shrink_interval(before: Array, after: Array, seed: int, draws: int = 2000) -> tuple[float, float]:
    """95 % interval of 1 - mean(after)/mean(before), by bootstrap over poses."""
    pick = np.random.default_rng(seed).integers(0, len(before), (draws, len(before)))
    shrink = 1 - after[pick].mean(axis=1) / before[pick].mean(axis=1)
    low, high = np.quantile(shrink, [0.025, 0.975])
    return float(low), float(high)

"""The gap on poses that the fit never saw: before and after causes are added, next to the noise floor.

Each fold is fitted in closed form from the residual, base model and causes together, with the priors that the
evidence uses; the errors are those of the poses left out.
"""

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import WHOLE_AXIS
from casadical.core.linear_gaussian.fit import Fit
from casadical.core.statistics import first_of_best
from casadical.diagnosis.evidence import REPEATABILITY, RHO_GRID, SIGMA_GRID_M, Evidence
from casadical.diagnosis.settings import SETTINGS
from casadical.measurements.measurements import Noise

FOLDS = 5


def likely_noise(log_grid: Array, sigmas: Array = SIGMA_GRID_M) -> Noise:
    """The most probable noise of a log likelihood over (rhos, sigmas, ...)."""
    grid = log_grid.reshape(len(RHO_GRID), len(sigmas), -1).max(axis=2)
    rho, sigma = np.unravel_index(first_of_best(grid, logs=True), grid.shape)
    return Noise(float(sigmas[sigma]), float(RHO_GRID[rho] * sigmas[sigma]))


def new_fit(e: Evidence, columns: Array, noise: Noise, *, combined: bool = True) -> Fit:
    """Base model and causes fitted together; columns : of the causes, in rising order."""
    return Fit(e, columns, noise.sigma, {REPEATABILITY: noise.repeatability / noise.sigma}, combined=combined)


def fit_of(e: Evidence, columns: Array, noise: Noise) -> Fit:
    """The same, kept with the problem: several questions are asked of the same few."""
    fits, key = e.cache.setdefault("fits", {}), (columns.tobytes(), noise)
    if key not in fits:
        # Fits that are kept with a problem.
        if len(fits) == 3:
            fits.pop(next(iter(fits)))
        fits[key] = new_fit(e, columns, noise)
    known: Fit = fits[key]
    return known


def lengths(e: Evidence, left: Array, poses: Array | slice = WHOLE_AXIS) -> Array:
    """The reported error of what is left at some poses, shape (poses,) [m]."""
    return np.asarray(np.linalg.norm(left if e.size is None else left * e.size[poses], axis=1))


def noise_square(e: Evidence, noise: Noise) -> Array:
    """Mean square of each pose's reported error by noise alone, shape (n,) [m^2]."""
    C = e.covariance(noise)
    if e.size is None:
        return np.asarray(np.trace(C, axis1=1, axis2=2))
    return np.asarray((np.diagonal(C, axis1=1, axis2=2) * e.size**2).sum(axis=1))


def held_out_errors(e: Evidence, columns: Array, noise: Noise, folds: Array) -> Array:
    """Position error of each pose, shape (n,) [m], by a fit to the poses of the other folds.

    columns : of the causes in the model; folds : number of the fold of each pose, shape (n,)
    """
    return fold_errors(e, fit_of(e, columns, noise), folds)


def fold_errors(e: Evidence, fit: Fit, folds: Array) -> Array:
    """The same for a fit that was made."""
    if len(np.unique(folds)) == len(folds):
        return lengths(e, fit.leave_one_out_residuals())
    errors = np.empty(len(folds))
    for fold in np.unique(folds):
        test = np.flatnonzero(folds == fold)
        errors[test] = lengths(e, fit.residual_without(test), test)
    return errors


def partitions(e: Evidence, seed: int) -> list[Array]:
    """Several partitions of the poses into folds; one of many poses, whose mean hardly depends on it."""
    n = len(e.r)
    # Poses from which on one partition is enough.
    return [random_folds(n, seed + k, alike=e.alike) for k in range(SETTINGS.partitions if n < 400 else 1)]


def partitioned_errors(e: Evidence, columns: Array, noise: Noise, seed: int) -> Array:
    """Held-out error of each pose, shape (n,) [m], averaged over partitions."""
    fit = fit_of(e, columns, noise)
    runs = [fold_errors(e, fit, folds) for folds in partitions(e, seed)]
    return np.asarray(np.mean(runs, axis=0))


def fitted_without(e: Evidence, columns: Array, noise: Noise, test: Array) -> Array:
    """What a fit to the poses outside of a mask leaves at every pose, shape (n, 3) [m]."""
    fit = fit_of(e, columns, noise)
    return fit.residual(fit.estimate_from(np.flatnonzero(~test)))


def remainders(e: Evidence, columns: Array, noise: Noise, kept: Array) -> tuple[Array, Array]:
    """What a fit to the kept poses leaves at every pose: length [m] and squared Mahalanobis distance, shapes (n,).

    The distance of a kept pose is from a fit without it, in units of what that fit can predict: a flexible model
    follows an outlier that it was fitted to.
    """
    fit = new_fit(e, columns, noise)
    x, pull = fit.estimate_from(np.flatnonzero(kept)), fit.leverage(np.flatnonzero(kept))
    spread = np.eye(fit.rows_per_block) + np.where(kept[:, None, None], -pull, pull)
    return lengths(e, fit.residual(x)), fit.mahalanobis_squared(x, spread)


def random_folds(n: int, seed: int, alike: Array | None = None) -> Array:
    """A fold number for each pose; sizes differ by one at most.

    alike : number of the unknown that each pose shares with others, shape (n,): its poses are spread over the folds
    """
    folds = np.random.default_rng(seed).permutation(np.arange(n) % FOLDS)
    if alike is None:
        return folds
    spread = np.empty(n, dtype=folds.dtype)
    spread[np.lexsort((folds, alike))] = np.arange(n) % FOLDS
    return spread


def shrink_interval(before: Array, after: Array, seed: int, draws: int = 2000) -> tuple[float, float]:
    """95 % interval of 1 - mean(after)/mean(before), by bootstrap over poses."""
    means = resampled_means(np.stack([before, after]), seed, draws)
    low, high = np.quantile(1 - means[1] / means[0], [0.025, 0.975])
    return float(low), float(high)


def resampled_means(values: Array, seed: int, draws: int) -> Array:
    """Means over poses that are drawn with replacement, the same of all values; shape (k, n) -> (k, draws)."""
    rng, n, means = np.random.default_rng(seed), values.shape[1], np.empty((len(values), draws))
    # Poses that a bootstrap draws at a time.
    step = max(1, 1_000_000 // n)
    for start in range(0, draws, step):
        pick = rng.integers(0, n, (min(step, draws - start), n))
        for own, some in zip(means, values, strict=True):
            own[start : start + len(pick)] = some[pick].mean(axis=1)
    return means

"""Cross-validation of the linear model: errors on held-out poses before and after causes are added.

For each fold, base model and causes are fitted together in closed form to the other folds, with the
priors of the linear model; the errors are those of the held-out poses.
"""

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import WHOLE_AXIS
from casadical.core.linear_gaussian.fit import Fit
from casadical.core.statistics import first_of_best
from casadical.diagnosis.evidence import RHO_GRID, SIGMA_GRID_M, Evidence
from casadical.diagnosis.settings import SETTINGS
from casadical.measurements.measurements import Noise


def likely_noise(log_grid: Array, sigmas: Array = SIGMA_GRID_M) -> Noise:
    """Return the noise (sigma [m], repeatability [rad]) at the maximum of a grid.

    log_grid : log likelihood, shape (rhos, sigmas, ...), maximised over further axes
    sigmas : the grid's standard deviations of the instrument [m]
    """
    grid = log_grid.reshape(len(RHO_GRID), len(sigmas), -1).max(axis=2)
    rho, sigma = np.unravel_index(first_of_best(grid, logs=True), grid.shape)
    return Noise(float(sigmas[sigma]), float(RHO_GRID[rho] * sigmas[sigma]))


def new_fit(e: Evidence, columns: Array, noise: Noise, *, combined: bool = True) -> Fit:
    """Return the joint fit of base model and causes to all poses of the evidence e.

    columns : indices of the causes' columns, rising, shape (k,); noise : assumed by the fit
    combined : whether the columns of a complete part are replaced by combinations (see `Combined`)
    """
    return Fit(e, columns, noise.sigma, noise.repeatability / noise.sigma, combined=combined)


def fit_of(e: Evidence, columns: Array, noise: Noise) -> Fit:
    """Return the result of `new_fit`, from the model's cache if it is there; a new one is added."""
    fits, key = e.cache.setdefault("fits", {}), (columns.tobytes(), noise)
    if key not in fits:
        # At most three fits are cached with a model.
        if len(fits) == 3:
            fits.pop(next(iter(fits)))
        fits[key] = new_fit(e, columns, noise)
    cached: Fit = fits[key]
    return cached


def lengths(e: Evidence, residual: Array, poses: Array | slice = WHOLE_AXIS) -> Array:
    """Return the reported error of poses, the norm of their length residuals, shape (poses,) [m].

    residual : residuals at these poses, scaled to equal noise, shape (poses, numbers)
    poses : indices of these poses
    """
    return np.asarray(np.linalg.norm(residual if e.size is None else residual * e.size[poses], axis=1))


def noise_mean_square(e: Evidence, noise: Noise) -> Array:
    """Return the expected square of each pose's reported error by noise alone, shape (n,) [m^2]."""
    C = e.covariance(noise)
    if e.size is None:
        return np.asarray(np.trace(C, axis1=1, axis2=2))
    return np.asarray((np.diagonal(C, axis1=1, axis2=2) * e.size**2).sum(axis=1))


def held_out_errors(e: Evidence, columns: Array, noise: Noise, folds: Array) -> Array:
    """Return the reported error of each pose under a fit to the other folds, shape (n,) [m].

    columns : indices of the causes' columns, shape (k,); noise : assumed by the fit
    folds : index of each pose's fold, shape (n,)
    """
    return fold_errors(e, fit_of(e, columns, noise), folds)


def fold_errors(e: Evidence, fit: Fit, folds: Array) -> Array:
    """Return the reported error of each pose under a fit to the other folds, shape (n,) [m].

    fit : fit to all poses, from which those without a fold follow
    folds : index of each pose's fold, shape (n,)
    """
    if len(np.unique(folds)) == len(folds):
        return lengths(e, fit.leave_one_out_residuals())
    errors = np.empty(len(folds))
    for fold in np.unique(folds):
        test = np.flatnonzero(folds == fold)
        errors[test] = lengths(e, fit.residual_without(test), test)
    return errors


def partitions(e: Evidence, seed: int) -> list[Array]:
    """Return partitions, random or by stop, each the fold of every pose, shape (n,).

    There are `Settings.partitions` of them, and one from 400 poses on. Where several targets share
    stops there is one, whose folds are the stops: a fifth of few stops is too many to predict.
    """
    n = len(e.r)
    if e.stop is not None:
        return [e.stop]
    # From 400 poses on the mean hardly depends on the partition, and one is enough.
    return [random_folds(n, seed + k, alike=e.alike, stop=e.stop) for k in range(SETTINGS.partitions if n < 400 else 1)]


def partitioned_errors(e: Evidence, columns: Array, noise: Noise, seed: int) -> Array:
    """Return each pose's held-out reported error, averaged over `partitions`, shape (n,) [m].

    columns : indices of the causes' columns, shape (k,); noise : assumed by the fit
    """
    fit = fit_of(e, columns, noise)
    runs = [fold_errors(e, fit, folds) for folds in partitions(e, seed)]
    return np.asarray(np.mean(runs, axis=0))


def residual_of_fit_without(e: Evidence, columns: Array, noise: Noise, test: Array) -> Array:
    """Return the residual at every pose of a fit to some of them, shape (n, 3) [m].

    columns : indices of the causes' columns, shape (k,)
    test : mask of the poses that are not fitted, shape (n,)
    """
    fit = fit_of(e, columns, noise)
    return fit.residual(fit.estimate_from(np.flatnonzero(~test)))


def errors_and_distances(e: Evidence, columns: Array, noise: Noise, inliers: Array) -> tuple[Array, Array]:
    """Return reported error [m] and squared Mahalanobis distance of every pose, shapes (n,).

    The fit is to the inliers. The distance of an inlier is from a fit without it, relative to the
    covariance of that prediction: a flexible model would follow an outlier to which it was fitted.
    columns : indices of the causes' columns, shape (k,); inliers : mask of the inliers, shape (n,)
    """
    fit = new_fit(e, columns, noise)
    x, pull = fit.estimate_from(np.flatnonzero(inliers)), fit.leverage(np.flatnonzero(inliers))
    spread = np.eye(fit.rows_per_block) + np.where(inliers[:, None, None], -pull, pull)
    return lengths(e, fit.residual(x)), fit.mahalanobis_squared(x, spread)


def random_folds(n: int, seed: int, alike: Array | None = None, stop: Array | None = None) -> Array:
    """Return the index of a random fold for each of n poses, shape (n,).

    There are `Settings.folds` folds; their numbers of poses (or stops) differ by at most one.
    alike : index of the unknown point of each pose, shape (n,); poses with the same point are
        distributed over the folds
    stop : index of the stop of each pose; poses of one stop are in one fold
    """
    if stop is not None:
        _, first, of_pose = np.unique(stop, return_index=True, return_inverse=True)
        return random_folds(len(first), seed, None if alike is None else alike[first])[of_pose]
    folds = np.random.default_rng(seed).permutation(np.arange(n) % SETTINGS.folds)
    if alike is None:
        return folds
    spread = np.empty(n, dtype=folds.dtype)
    spread[np.lexsort((folds, alike))] = np.arange(n) % SETTINGS.folds
    return spread


def shrink_interval(before: Array, after: Array, seed: int, stop: Array | None = None) -> tuple[float, float]:
    """Return (low, high), the 95 % interval of 1 - mean(after) / mean(before), by bootstrap.

    before, after : errors at the same poses, shape (n,); poses are drawn together
    stop : as of `resampled_means`
    """
    means = resampled_means(np.stack([before, after]), seed, 2000, stop)
    low, high = np.quantile(1 - means[1] / means[0], [0.025, 0.975])
    return float(low), float(high)


def resampled_means(values: Array, seed: int, draws: int, stop: Array | None = None) -> Array:
    """Return the means over bootstrap samples of poses of each row of values, shape (k, draws).

    values : shape (k, n) for n poses; every row uses the same samples
    stop : index of the stop of each pose, shape (n,); whole stops are drawn. None: poses are
    """
    count: Array = np.ones(values.shape[1])
    if stop is not None:
        places = np.unique(stop, return_inverse=True)[1]
        count, values = np.bincount(places, count), np.stack([np.bincount(places, own) for own in values])
    rng, n, means = np.random.default_rng(seed), values.shape[1], np.empty((len(values), draws))
    # Indices are drawn in blocks of about a million, which bounds memory.
    step = max(1, 1_000_000 // n)
    for start in range(0, draws, step):
        pick = rng.integers(0, n, (min(step, draws - start), n))
        for own, some in zip(means, values, strict=True):
            own[start : start + len(pick)] = some[pick].sum(axis=1) / count[pick].sum(axis=1)
    return means

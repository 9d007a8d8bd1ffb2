"""The gap on poses that the fit never saw: before and after causes are added, next to the noise floor.

Each fold is fitted in closed form from the residual, base model and causes together, with the priors that the
evidence uses; the errors are those of the poses left out.
"""

from functools import cached_property

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.evidence import RHOS, SIGMAS, Evidence
from casadical.diagnosis.thresholds import PARTITIONS
from casadical.measurements.noise import Noise

FOLDS = 5
# Parts in which the poses are gone through one by one.
BLOCKS = 20
# Poses from which on one partition is enough.
MANY = 400
# Up to so many numbers, leaving some out is worked out among the observations instead of the parameters.
MOST_ROWS = 1500
# Up to so many bytes, columns are kept in a second form that leaves some poses out at little cost.
MOST_BYTES = 250_000_000


def likely_noise(log_grid: Array, sigmas: Array = SIGMAS) -> Noise:
    """The most probable noise of a log likelihood over (rhos, sigmas, ...)."""
    grid = log_grid.reshape(len(RHOS), len(sigmas), -1).max(axis=2)
    rho, sigma = np.unravel_index(int(np.argmax(grid)), grid.shape)
    return Noise(float(sigmas[sigma]), float(RHOS[rho] * sigmas[sigma]))


class Fit:
    """Base model and causes fitted together to the poses, and to all but some of them.

    A : columns made white, shape (3 n, p); y : residual made white, shape (3 n,); prior, mean : of every parameter
    W : what makes each pose's columns white, shape (n, 3, 3)
    """

    def __init__(self, e: Evidence, columns: Array, noise: Noise) -> None:
        self.W = np.linalg.inv(np.linalg.cholesky(covariance(e, noise)))
        whole = np.concatenate([e.J, e.take(columns)], axis=2)
        for some in np.array_split(np.arange(len(whole)), BLOCKS):  # in place: there may be many columns
            whole[some] = self.W[some] @ whole[some]
        self.A = whole.reshape(e.r.size, -1)
        self.y = (self.W @ e.r[:, :, None]).ravel()
        self.prior = np.concatenate([e.prior, e.width_in_model(columns)])
        self.mean = np.concatenate([e.delta0, np.zeros(len(columns))])

    @cached_property
    def H(self) -> Array:
        """Products of the columns, shape (p, p)."""
        return np.asarray(self.A.T @ self.A)

    @cached_property
    def g(self) -> Array:
        """Products of the columns with the residual, shape (p,)."""
        return np.asarray(self.A.T @ self.y)

    def _rows(self, poses: Array) -> Array:
        return (3 * poses[:, None] + np.arange(3)).ravel()

    def _normal(self, H: Array) -> tuple[Array, Array]:
        """Root of the inverse of the normal matrix, and the scale that was taken off first."""
        normal = H + np.diag(self.prior**-2)
        scale = np.sqrt(np.diag(normal))
        return np.linalg.inv(np.linalg.cholesky(normal / np.outer(scale, scale))), scale

    def _solution(self, H: Array, g: Array) -> Array:
        normal = H + np.diag(self.prior**-2)
        scale = np.sqrt(np.diag(normal))
        right = (g + self.mean / self.prior**2) / scale
        return np.asarray(np.linalg.solve(normal / np.outer(scale, scale), right) / scale)

    @cached_property
    def _pulled(self) -> Array:
        """Columns in which the inverse of the normal matrix is one, shape (3 n, p)."""
        root, scale = self._normal(self.H)
        return np.asarray(self.A / scale @ root.T)

    @cached_property
    def x(self) -> Array:
        """Fit to all poses, shape (p,)."""
        return self._solution(self.H, self.g)

    @cached_property
    def covariance(self) -> Array:
        """Of the fit to all poses, shape (p, p)."""
        root, scale = self._normal(self.H)
        return np.asarray(root.T @ root / np.outer(scale, scale))

    def to(self, poses: Array) -> Array:
        """Fit to some poses alone, given by their numbers, shape (p,)."""
        if len(poses) == len(self.W):
            return self.x
        A, y = self.A[self._rows(poses)], self.y[self._rows(poses)]
        return self._solution(A.T @ A, A.T @ y)

    def left(self, x: Array) -> Array:
        """What a fit leaves at every pose, shape (n, 3) [m]; x : its parameters, shape (p,)."""
        white = (self.y - self.A @ x).reshape(-1, 3, 1)
        return np.asarray(np.linalg.solve(self.W, white)[:, :, 0])

    def pull(self, poses: Array) -> Array:
        """Covariance of the fit to some poses at each pose, in units of its noise, shape (n, 3, 3)."""
        A = self.A[self._rows(poses)]
        root, scale = self._normal(self.H if len(poses) == len(self.W) else A.T @ A)
        parts = np.array_split(self.A.reshape(-1, 3, len(scale)), BLOCKS)
        return np.concatenate([_blocks(part / scale @ root.T) for part in parts])

    @cached_property
    def _left_of(self) -> Array | None:
        """What takes observations to what a fit to all leaves of them, shape (3 n, 3 n); None for too many poses."""
        rows, p = self.A.shape
        if rows > MOST_ROWS:
            return None
        if rows > p:
            return np.asarray(np.eye(rows) - self._pulled @ self._pulled.T)
        wide = self.A * self.prior
        return np.linalg.inv(np.eye(rows) + wide @ wide.T)

    def without(self, poses: Array) -> Array:
        """What is left at some poses by a fit to all others, shape (len(poses), 3) [m]."""
        rows = self._rows(poses)
        whole = self._left_of
        if whole is not None:  # what all poses leave, freed of these poses' own pull on the fit
            left = np.linalg.solve(whole[np.ix_(rows, rows)], whole[rows] @ (self.y - self.A @ self.mean))
        elif len(rows) < len(self.prior) and self.A.nbytes < MOST_BYTES:
            B = self._pulled[rows]
            left = np.linalg.solve(np.eye(len(rows)) - B @ B.T, self.y[rows] - self.A[rows] @ self.x)
        else:
            A, y = self.A[rows], self.y[rows]
            left = y - A @ self._solution(self.H - A.T @ A, self.g - A.T @ y)
        return np.asarray(np.linalg.solve(self.W[poses], left.reshape(-1, 3, 1))[:, :, 0])

    def alone(self) -> Array:
        """What is left at each pose by a fit to all others, shape (n, 3) [m]."""
        if self._left_of is not None:
            return np.concatenate([self.without(np.array([k])) for k in range(len(self.W))])
        pull = self.pull(np.arange(len(self.W)))
        left = np.linalg.solve(np.eye(3) - pull, (self.y - self.A @ self.x).reshape(-1, 3, 1))
        return np.asarray(np.linalg.solve(self.W, left)[:, :, 0])


def _blocks(B: Array) -> Array:
    """Each pose's own block of B B', shape (n, 3, 3); B : shape (n, 3, p)."""
    return np.asarray(B @ B.transpose(0, 2, 1))


def covariance(e: Evidence, noise: Noise) -> Array:
    """Of the noise of each measured position, shape (n, 3, 3) [m^2]."""
    return noise.sigma**2 * np.eye(3) + noise.repeatability**2 * e.Jq @ e.Jq.transpose(0, 2, 1)


def held_out_errors(e: Evidence, columns: Array, noise: Noise, folds: Array) -> Array:
    """Position error of each pose, shape (n,) [m], by a fit to the poses of the other folds.

    columns : of the causes in the model; folds : number of the fold of each pose, shape (n,)
    """
    return fold_errors(Fit(e, columns, noise), folds)


def fold_errors(fit: Fit, folds: Array) -> Array:
    """The same for a fit that was made."""
    if len(np.unique(folds)) == len(folds):
        return np.asarray(np.linalg.norm(fit.alone(), axis=1))
    errors = np.empty(len(folds))
    for fold in np.unique(folds):
        test = np.flatnonzero(folds == fold)
        errors[test] = np.linalg.norm(fit.without(test), axis=1)
    return errors


def partitions(n: int, seed: int) -> list[Array]:
    """Several partitions of n poses into folds; one of many poses, whose mean hardly depends on it."""
    return [random_folds(n, seed + k) for k in range(PARTITIONS if n < MANY else 1)]


def partitioned_errors(e: Evidence, columns: Array, noise: Noise, seed: int) -> Array:
    """Held-out error of each pose, shape (n,) [m], averaged over partitions."""
    fit = Fit(e, columns, noise)
    runs = [fold_errors(fit, folds) for folds in partitions(len(e.r), seed)]
    return np.asarray(np.mean(runs, axis=0))


def fitted_without(e: Evidence, columns: Array, noise: Noise, test: Array) -> Array:
    """What a fit to the poses outside of a mask leaves at every pose, shape (n, 3) [m]."""
    fit = Fit(e, columns, noise)
    return fit.left(fit.to(np.flatnonzero(~test)))


def remainders(e: Evidence, columns: Array, noise: Noise, kept: Array) -> tuple[Array, Array]:
    """What a fit to the kept poses leaves at every pose: length [m] and squared Mahalanobis distance, shapes (n,).

    The distance of a kept pose is from a fit without it, in units of what that fit can predict: a flexible model
    follows an outlier that it was fitted to.
    """
    fit = Fit(e, columns, noise)
    x, pull = fit.to(np.flatnonzero(kept)), fit.pull(np.flatnonzero(kept))
    white = (fit.y - fit.A @ x).reshape(-1, 3, 1)
    spread = np.eye(3) + np.where(kept[:, None, None], -pull, pull)
    square = (white * np.linalg.solve(spread, white)).sum(axis=(1, 2))
    return np.linalg.norm(fit.left(x), axis=1), square


def estimates(e: Evidence, columns: Array, noise: Noise) -> tuple[Array, Array]:
    """Values and standard errors of the causes' parameters, in sizes, shapes (len(columns),)."""
    fit = Fit(e, columns, noise)
    first = e.J.shape[2]
    return fit.x[first:], np.sqrt(np.diag(fit.covariance))[first:]


def random_folds(n: int, seed: int, count: int = FOLDS) -> Array:
    """A fold number for each pose; sizes differ by one at most."""
    return np.random.default_rng(seed).permutation(np.arange(n) % count)


def shrink_interval(before: Array, after: Array, seed: int, draws: int = 2000) -> tuple[float, float]:
    """95 % interval of 1 - mean(after)/mean(before), by bootstrap over poses."""
    pick = np.random.default_rng(seed).integers(0, len(before), (draws, len(before)))
    shrink = 1 - after[pick].mean(axis=1) / before[pick].mean(axis=1)
    low, high = np.quantile(shrink, [0.025, 0.975])
    return float(low), float(high)

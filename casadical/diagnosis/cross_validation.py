"""The gap on poses that the fit never saw: before and after causes are added, next to the noise floor.

Each fold is fitted in closed form from the residual, base model and causes together, with the priors that the
evidence uses; the errors are those of the poses left out.
"""

from functools import cached_property

import numpy as np

from casadical.core.arrays import Array
from casadical.core.normal_matrices import root_of_inverse
from casadical.diagnosis.combinations import Combined
from casadical.diagnosis.evidence import RHOS, SIGMAS, Evidence
from casadical.diagnosis.linearisation import EVERY
from casadical.diagnosis.sums import taken
from casadical.diagnosis.thresholds import PARTITIONS
from casadical.measurements.noise import Noise

FOLDS = 5
# Poses from which on one partition is enough.
MANY = 400
# Up to so many numbers, leaving some out is worked out among the observations instead of the parameters.
MOST_ROWS = 1500
# Up to so many bytes the white columns are kept, twice; else they are made again, so many bytes at a time.
MOST_BYTES, PART_BYTES = 60_000_000, 32_000_000
# Fits that are kept with a problem.
MOST_FITS = 3


def likely_noise(log_grid: Array, sigmas: Array = SIGMAS) -> Noise:
    """The most probable noise of a log likelihood over (rhos, sigmas, ...)."""
    grid = log_grid.reshape(len(RHOS), len(sigmas), -1).max(axis=2)
    rho, sigma = np.unravel_index(int(np.argmax(grid)), grid.shape)
    return Noise(float(sigmas[sigma]), float(RHOS[rho] * sigmas[sigma]))


class Fit:
    """Base model and causes fitted together to the poses, and to all but some of them.

    e : the problem; columns : of the causes, in rising order; combined : with combinations for those of parts of
        effects (see `combinations`)
    y : residual made white, shape (3 n,); prior, mean : of every parameter or combination, shape (p,)
    W : what makes each pose's columns white, shape (n, 3, 3)
    H, g : products of the white columns among themselves and with y, shapes (p, p) and (p,)
    """

    def __init__(self, e: Evidence, columns: Array, noise: Noise, *, combined: bool = True) -> None:
        self._J, self._E, self._columns = e.J, e.E, columns
        self.numbers, self.size = e.r.shape[1], e.size
        self.combined = e.combined(columns) if combined else Combined(((0, len(columns), None),))
        self.W = np.linalg.inv(np.linalg.cholesky(covariance(e, noise)))
        self.y = (self.W @ e.r[:, :, None]).ravel()
        self._widths = e.width_in_model(columns)
        self.prior = np.concatenate([e.prior, self.combined.one_of_each(self._widths)])
        self.mean = np.concatenate([e.delta0, np.zeros(self.combined.width)])
        p = len(self.prior)
        self._kept = np.empty((len(self.y), p)) if 8 * len(self.y) * p <= MOST_BYTES else None
        self.H, self.g = np.zeros((p, p)), np.zeros(p)
        for some in self._parts():
            A = self._white(some)
            if self._kept is not None:
                self._kept[self._rows_of(some)] = A
            self.H += A.T @ A
            self.g += A.T @ self.y[self._rows_of(some)]

    def _rows(self, poses: Array) -> Array:
        """Rows of some poses."""
        return np.asarray((self.numbers * poses[:, None] + np.arange(self.numbers)).ravel())

    def _rows_of(self, poses: slice) -> slice:
        return slice(self.numbers * poses.start, self.numbers * poses.stop)

    def _by_pose(self, rows: Array) -> Array:
        """Rows as columns of numbers, shape (poses, numbers, 1)."""
        return rows.reshape(-1, self.numbers, 1)

    def _parts(self) -> list[slice]:
        """The poses in parts whose columns take little memory."""
        step = max(64, PART_BYTES // (24 * len(self.prior)))
        return [slice(k, min(k + step, len(self.W))) for k in range(0, len(self.W), step)]

    def _white(self, poses: Array | slice) -> Array:
        """Columns of some poses made white, shape (3 poses, p)."""
        causes = taken(self._E, self._columns, poses, self.combined)
        A = np.concatenate([self._J[poses], causes], axis=2)
        return np.asarray((self.W[poses] @ A).reshape(-1, A.shape[2]))

    def _of(self, poses: Array | slice) -> Array:
        """The same, as kept where they are."""
        if self._kept is None:
            return self._white(poses)
        if isinstance(poses, slice):
            return np.asarray(self._kept[self._rows_of(poses)])
        return np.asarray(self._kept[self._rows(poses)])

    @property
    def A(self) -> Array:
        """The white columns of all poses, shape (3 n, p)."""
        return self._white(EVERY) if self._kept is None else self._kept

    def _products(self, poses: Array) -> tuple[Array, Array]:
        """H and g of some poses alone: theirs, or those of all less the others', whichever are fewer."""
        out = np.setdiff1d(np.arange(len(self.W)), poses)
        fewer = out if len(out) < len(poses) else poses
        H, g = np.zeros_like(self.H), np.zeros_like(self.g)
        for some in np.array_split(fewer, 1 + len(fewer) // len(self.prior)):
            A = self._of(some)
            H += A.T @ A
            g += A.T @ self.y[self._rows(some)]
        return (self.H - H, self.g - g) if fewer is out else (H, g)

    def _solution(self, H: Array, g: Array) -> Array:
        normal = H + np.diag(self.prior**-2)
        scale = np.sqrt(np.diag(normal))
        right = (g + self.mean / self.prior**2) / scale
        return np.asarray(np.linalg.solve(normal / np.outer(scale, scale), right) / scale)

    @cached_property
    def _root(self) -> Array:
        """Root of the inverse of the normal matrix, shape (p, p)."""
        return root_of_inverse(self.H + np.diag(self.prior**-2))

    @cached_property
    def _pulled(self) -> Array | None:
        """Columns in which the inverse of the normal matrix is one, shape (3 n, p); None if they are not kept."""
        return None if self._kept is None else np.asarray(self._kept @ self._root.T)

    @cached_property
    def x(self) -> Array:
        """Fit to all poses, shape (p,)."""
        return self._solution(self.H, self.g)

    @cached_property
    def covariance(self) -> Array:
        """Of the fit to all poses, shape (p, p)."""
        return np.asarray(self._root.T @ self._root)

    @property
    def causes(self) -> tuple[Array, Array]:
        """Values and standard errors of the causes' parameters, in sizes, shapes (columns,)."""
        first = len(self.prior) - self.combined.width
        known = self.combined.values(np.eye(self.combined.width))
        variance = ((known @ self._root.T[first:]) ** 2).sum(axis=1) + self._widths**2 * (1 - (known**2).sum(axis=1))
        return self.combined.values(self.x[first:]), np.sqrt(variance)

    def to(self, poses: Array) -> Array:
        """Fit to some poses alone, given by their numbers, shape (p,)."""
        return self.x if len(poses) == len(self.W) else self._solution(*self._products(poses))

    def _left(self, x: Array) -> Array:
        """What a fit leaves, white, shape (3 n,)."""
        return np.asarray(self.y - np.concatenate([self._of(some) @ x for some in self._parts()]))

    def left(self, x: Array) -> Array:
        """What a fit leaves at every pose, shape (n, 3) [m]; x : its parameters, shape (p,)."""
        return np.asarray(np.linalg.solve(self.W, self._by_pose(self._left(x)))[:, :, 0])

    def lengths(self, left: Array, poses: Array | slice = EVERY) -> Array:
        """The reported error of what is left at some poses, shape (poses,) [m]."""
        return np.asarray(np.linalg.norm(left if self.size is None else left * self.size[poses], axis=1))

    def distance(self, x: Array, spread: Array) -> Array:
        """Squared Mahalanobis distance of what a fit leaves at each pose, shape (n,); spread : shape (n, 3, 3)."""
        white = self._by_pose(self._left(x))
        return np.asarray((white * np.linalg.solve(spread, white)).sum(axis=(1, 2)))

    def pull(self, poses: Array) -> Array:
        """Covariance of the fit to some poses at each pose, in units of its noise, shape (n, 3, 3)."""
        if len(poses) == len(self.W):
            if self._pulled is not None:
                return _blocks(self._pulled.reshape(len(self.W), self.numbers, -1))
            root = self._root
        else:
            root = root_of_inverse(self._products(poses)[0] + np.diag(self.prior**-2))
        return np.concatenate(
            [_blocks((self._of(s) @ root.T).reshape(-1, self.numbers, len(root))) for s in self._parts()]
        )

    @cached_property
    def _left_of(self) -> Array | None:
        """What takes observations to what a fit to all leaves of them, shape (3 n, 3 n); None for too many poses."""
        rows, p = len(self.y), len(self.prior)
        if rows > MOST_ROWS or self._kept is None:
            return None
        if rows > p and self._pulled is not None:
            return np.asarray(np.eye(rows) - self._pulled @ self._pulled.T)
        wide = self._kept * self.prior
        return np.linalg.inv(np.eye(rows) + wide @ wide.T)

    @cached_property
    def _missed(self) -> Array:
        """What the priors' mean leaves, white, shape (3 n,)."""
        return self._left(self.mean)

    @cached_property
    def rest(self) -> Array:
        """What the fit to all poses leaves, white, shape (3 n,)."""
        return self._left(self.x)

    def without(self, poses: Array) -> Array:
        """What is left at some poses by a fit to all others, shape (len(poses), 3) [m]."""
        rows = self._rows(poses)
        whole = self._left_of
        if whole is not None:  # what all poses leave, freed of these poses' own pull on the fit
            left = np.linalg.solve(whole[np.ix_(rows, rows)], whole[rows] @ self._missed)
        elif len(rows) < len(self.prior) and self._pulled is not None:
            B = self._pulled[rows]
            left = np.linalg.solve(np.eye(len(rows)) - B @ B.T, self.rest[rows])
        else:
            A, y = self._of(poses), self.y[rows]
            left = y - A @ self._solution(self.H - A.T @ A, self.g - A.T @ y)
        return np.asarray(np.linalg.solve(self.W[poses], self._by_pose(left))[:, :, 0])

    def alone(self) -> Array:
        """What is left at each pose by a fit to all others, shape (n, 3) [m]."""
        if self._left_of is not None:
            return np.concatenate([self.without(np.array([k])) for k in range(len(self.W))])
        pull = self.pull(np.arange(len(self.W)))
        left = np.linalg.solve(np.eye(self.numbers) - pull, self._by_pose(self.rest))
        return np.asarray(np.linalg.solve(self.W, left)[:, :, 0])


def fit_of(e: Evidence, columns: Array, noise: Noise) -> Fit:
    """The fit of these columns, kept with the problem: several questions are asked of the same few."""
    fits: dict[tuple[bytes, Noise], Fit] = e.__dict__.setdefault("fits", {})
    key = columns.tobytes(), noise
    if key not in fits:
        if len(fits) == MOST_FITS:
            fits.pop(next(iter(fits)))
        fits[key] = Fit(e, columns, noise)
    return fits[key]


def _blocks(B: Array) -> Array:
    """Each pose's own block of B B', shape (n, 3, 3); B : shape (n, 3, p)."""
    return np.asarray(B @ B.transpose(0, 2, 1))


def covariance(e: Evidence, noise: Noise) -> Array:
    """Of the noise of each measured position, shape (n, 3, 3) [m^2]."""
    return noise.sigma**2 * np.eye(e.r.shape[1]) + noise.repeatability**2 * e.Jq @ e.Jq.transpose(0, 2, 1)


def noise_square(e: Evidence, noise: Noise) -> Array:
    """Mean square of each pose's reported error by noise alone, shape (n,) [m^2]."""
    C = covariance(e, noise)
    if e.size is None:
        return np.asarray(np.trace(C, axis1=1, axis2=2))
    return np.asarray((np.diagonal(C, axis1=1, axis2=2) * e.size**2).sum(axis=1))


def held_out_errors(e: Evidence, columns: Array, noise: Noise, folds: Array) -> Array:
    """Position error of each pose, shape (n,) [m], by a fit to the poses of the other folds.

    columns : of the causes in the model; folds : number of the fold of each pose, shape (n,)
    """
    return fold_errors(fit_of(e, columns, noise), folds)


def fold_errors(fit: Fit, folds: Array) -> Array:
    """The same for a fit that was made."""
    if len(np.unique(folds)) == len(folds):
        return fit.lengths(fit.alone())
    errors = np.empty(len(folds))
    for fold in np.unique(folds):
        test = np.flatnonzero(folds == fold)
        errors[test] = fit.lengths(fit.without(test), test)
    return errors


def partitions(e: Evidence, seed: int) -> list[Array]:
    """Several partitions of the poses into folds; one of many poses, whose mean hardly depends on it."""
    n = len(e.r)
    return [random_folds(n, seed + k, alike=e.alike) for k in range(PARTITIONS if n < MANY else 1)]


def partitioned_errors(e: Evidence, columns: Array, noise: Noise, seed: int) -> Array:
    """Held-out error of each pose, shape (n,) [m], averaged over partitions."""
    fit = fit_of(e, columns, noise)
    runs = [fold_errors(fit, folds) for folds in partitions(e, seed)]
    return np.asarray(np.mean(runs, axis=0))


def fitted_without(e: Evidence, columns: Array, noise: Noise, test: Array) -> Array:
    """What a fit to the poses outside of a mask leaves at every pose, shape (n, 3) [m]."""
    fit = fit_of(e, columns, noise)
    return fit.left(fit.to(np.flatnonzero(~test)))


def remainders(e: Evidence, columns: Array, noise: Noise, kept: Array) -> tuple[Array, Array]:
    """What a fit to the kept poses leaves at every pose: length [m] and squared Mahalanobis distance, shapes (n,).

    The distance of a kept pose is from a fit without it, in units of what that fit can predict: a flexible model
    follows an outlier that it was fitted to.
    """
    fit = Fit(e, columns, noise)
    x, pull = fit.to(np.flatnonzero(kept)), fit.pull(np.flatnonzero(kept))
    spread = np.eye(fit.numbers) + np.where(kept[:, None, None], -pull, pull)
    return fit.lengths(fit.left(x)), fit.distance(x, spread)


def estimates(e: Evidence, columns: Array, noise: Noise) -> tuple[Array, Array]:
    """Values and standard errors of the causes' parameters, in sizes, shapes (len(columns),)."""
    return fit_of(e, columns, noise).causes


def random_folds(n: int, seed: int, count: int = FOLDS, alike: Array | None = None) -> Array:
    """A fold number for each pose; sizes differ by one at most.

    alike : number of the unknown that each pose shares with others, shape (n,): its poses are spread over the folds
    """
    folds = np.random.default_rng(seed).permutation(np.arange(n) % count)
    if alike is None:
        return folds
    spread = np.empty(n, dtype=folds.dtype)
    spread[np.lexsort((folds, alike))] = np.arange(n) % count
    return spread


def shrink_interval(before: Array, after: Array, seed: int, draws: int = 2000) -> tuple[float, float]:
    """95 % interval of 1 - mean(after)/mean(before), by bootstrap over poses."""
    pick = np.random.default_rng(seed).integers(0, len(before), (draws, len(before)))
    shrink = 1 - after[pick].mean(axis=1) / before[pick].mean(axis=1)
    low, high = np.quantile(shrink, [0.025, 0.975])
    return float(low), float(high)

"""Inflation of an identification's covariance where residuals are not independent noise.

The fit is repeated in one linear step with all parameters and the first harmonics of each revolute
joint's error, which no base model has. The residuals may still be correlated between consecutive or
similar poses: gear errors of higher order, slow drifts. The misfit factor says by how much their
variance exceeds that of independent noise in the direction of the parameters.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, reduce

import numpy as np

from casadical.core.basics import M_PER_MM, Array, InputError
from casadical.core.linear_gaussian.noise import covariance_of, whitening_of
from casadical.core.linear_gaussian.normal_equations import NormalSums, normal_sums, scaled_inverse
from casadical.core.statistics import first_of_best
from casadical.identification.remaining_errors import (
    EM_ITERATIONS,
    UncertainParameters,
    posterior_of,
    uncertain_parameters_of,
)
from casadical.identification.residuals import make_block
from casadical.identification.result import Identification
from casadical.measurements.kinds.registry import find_kind
from casadical.robot.robot import Robot, with_joint_harmonics

# Highest harmonic of each joint's error that a fleet compares between campaigns.
MAX_COMPARED_HARMONIC = 2
# Highest harmonic of each joint's error in the fit; those not compared only widen the uncertainty.
MAX_FITTED_HARMONIC = 6
# Grid of the ratio of a joint's repeatability [rad] to the noise of a measured coordinate [m].
REPEATABILITY_RATIOS = (0.0, 0.3, 0.5, 0.8, 1.3, 2.0)


# Residuals and Jacobians of some poses at the fitted values; each pose has as many rows as the kind
# with the most of them. Lengths are in mm; residuals whose accuracy is not that of the lengths of
# the first set are scaled to the same noise: residuals, (n, numbers) [mm]; Jacobians by the
# parameters in units of their scale, (n, numbers, k) [mm], by the zero of each revolute joint,
# (n, numbers, joints) [mm/mrad], and by the unknown points, (n, numbers, 3 points) [mm/mm].
_Rows = tuple[Array, Array, Array, Array]


class _Poses:
    """Residuals and Jacobians of all poses that an identification used, iterated over in parts.

    q : joint variables, shape (n, joints) [rad or m]; joints : number of revolute joints
    count : number of measured values minus the coordinates of unknown points
    """

    def __init__(self, found: Identification, robot: Robot, names: tuple[str, ...], max_cached: int) -> None:
        """Prepare the poses of an identification, evaluated at once if at most `max_cached`."""
        self.q = np.concatenate([m.q for m in found.used])
        self.joints = sum(name.startswith("theta") for name in names)
        self.count = sum(m.q.shape[0] * find_kind(m.kind).numbers for m in found.used) - 3 * len(found.unknown_points)
        self._made = partial(_rows, found, robot, names)
        self._cached = list(self._made()) if len(self) <= max_cached else []

    def __len__(self) -> int:
        return len(self.q)

    def __iter__(self) -> Iterator[_Rows]:
        return iter(self._cached or self._made())


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """Linear fit of all uncertain parameters at a given joint repeatability (a ratio per joint).

    log_likelihood : of the residuals at the fitted s2 and prior variances, without a constant
    sums : normal equations over the whitened poses, at the values of the identification
    s2 : noise variance of a coordinate, without the part of joint repeatability [mm^2]
    variance : prior variance of each parameter in units of its scale, shape (k,); that of the
        harmonics is estimated from the residuals
    """

    log_likelihood: float
    sums: NormalSums
    s2: float
    variance: Array


@dataclass(frozen=True, eq=False)
class WideFit:
    """Linear fit of all uncertain parameters and joint harmonics to an identification's residuals.

    robot : calibrated, with harmonics of zero size
    doubts : parameters with their priors; poses : to which they are fitted
    best : fit with the most probable of REPEATABILITY_RATIOS, equal for all joints
    misfit : factor by which the variance of correlated residuals exceeds that of independent noise
        along the parameters, at least 1
    coordinate_sigma : standard deviation of the residuals of a coordinate [m]
    freedom : degrees of freedom of `coordinate_sigma`
    """

    robot: Robot
    doubts: UncertainParameters
    poses: _Poses
    best: NoiseFit
    misfit: float
    coordinate_sigma: float
    freedom: float
    _tried: dict[tuple[float, ...], float] = field(default_factory=dict, repr=False)
    _last: dict[tuple[float, ...], NoiseFit] = field(default_factory=dict, repr=False)

    @property
    def joints(self) -> int:
        """Number of revolute joints."""
        return self.poses.joints

    def at(self, rhos: tuple[float, ...]) -> NoiseFit:
        """Return the fit of all parameters with joint repeatability `rhos` times coordinate noise.

        rhos : a ratio for each revolute joint [rad/m]; the last fit is cached
        """
        if rhos not in self._last:
            self._last.clear()
            self._last[rhos] = _fit_at(rhos, self.poses, self.doubts)[0]
        return self._last[rhos]

    def log_likelihood(self, rhos: tuple[float, ...]) -> float:
        """Return the log likelihood (without a constant) of one repeatability ratio per joint.

        rhos : a ratio for each revolute joint [rad/m]; prior variances start at those of `best`
        """
        if rhos not in self._tried:
            doubts = replace(self.doubts, sigma=np.sqrt(self.best.variance))
            # Four iterations suffice from the variances of another fit.
            self._tried[rhos] = _fit_at(rhos, self.poses, doubts, 4)[0].log_likelihood
        return self._tried[rhos]


def wide_fit(found: Identification, max_cached: int = 10_000) -> WideFit:
    """Return the fit of all uncertain parameters and harmonics to an identification's used poses.

    max_cached : maximum number of poses whose residuals and Jacobians are cached; those of larger
        sets are evaluated again in each pass
    Raises InputError for given distances between touched points.
    """
    robot = with_joint_harmonics(found.robot, MAX_FITTED_HARMONIC)
    doubts = uncertain_parameters_of(robot, found.names)
    low = [joint[: 2 * MAX_COMPARED_HARMONIC] for joint in doubts.joints]
    doubts = replace(doubts, joints=(*low, *(joint[2 * MAX_COMPARED_HARMONIC :] for joint in doubts.joints)))
    poses = _Poses(found, robot, doubts.names, max_cached)
    rhos, best, mean = _most_probable(poses, doubts)
    n = len(poses)
    # Correlation is sought among consecutive poses (twelve parts) and among poses of one region of
    # the joint space.
    parts = [_normal_equations(rhos, poses, part)[0] for part in (np.arange(n) * min(12, n) // n, _by_region(poses.q))]
    times = _misfit_factor(parts, mean, best.s2, best.variance)
    # A parameter with a prior counts by the share that the data determine (Hastie 1990). It is
    # computed again, for with few poses the last iteration of `posterior_of` still changed s2.
    M = scaled_inverse(best.sums.H / best.s2 + np.diag(1 / best.variance)) @ best.sums.H / best.s2
    fitted = float(2 * np.trace(M) - np.sum(M * M.T))
    plain = _normal_equations((0.0,) * poses.joints, poses)[0][0].moved(mean)
    freedom = max(1.0, poses.count - fitted)
    return WideFit(robot, doubts, poses, best, times, M_PER_MM * float(np.sqrt(plain.square / freedom)), freedom)


def _rows(found: Identification, robot: Robot, names: tuple[str, ...]) -> Iterator[_Rows]:
    """Yield residuals and Jacobians of the used poses, some at a time, at the identified values.

    Where points are unknown, all poses come at once, for several of them may share a point.
    """
    sets = [m.positions_alone() if m.kind == "position_covariance" else m for m in found.used]
    if any(m.separations for m in sets):
        raise InputError(
            f"{sets[0].source}: known distances between touched points cannot be compared yet; leave them out"
        )
    where = found.unknown_points
    number = {name: k for k, name in enumerate(where)}
    points = np.array([*where.values()]).reshape(-1, 3)
    zeros = [k for k, name in enumerate(names) if name.startswith("theta")]
    width = max(find_kind(m.kind).numbers for m in sets)
    (first, _) = found.problem.sigmas[0]
    together: list[_Rows] = []
    for k, (m, sigmas) in enumerate(zip(sets, found.problem.sigmas, strict=True)):
        at = np.array([number[f"{k}/{name}"] for name in find_kind(m.kind).point_names(m.arrays)], dtype=int)
        length, angle = (M_PER_MM * sigma / first for sigma in sigmas)
        group = at if at.size else np.zeros(len(m), dtype=int)
        block = make_block(robot, m, names, length, angle, points, group)
        for some, r, J in block.parts(np.zeros(len(names)), np.zeros_like(points)):
            U = np.zeros((*r.shape, points.size))
            for i, point in enumerate(at[some]):
                U[i, :, 3 * point : 3 * point + 3] = J[i, :, len(names) :]
            out = [(0, 0), (0, width - r.shape[1])]
            r, J, U = (np.pad(value, [*out, (0, 0)][: value.ndim]) for value in (r, J[:, :, : len(names)], U))
            if not points.size:
                yield r, J, J[:, :, zeros], U
            else:
                together.append((r, J, J[:, :, zeros], U))
    if together:
        r, J, Jq, U = map(np.concatenate, zip(*together, strict=True))
        yield r, J, Jq, U


def _without_points(r: Array, J: Array, U: Array) -> tuple[Array, Array, float]:
    """Return residuals, Jacobian and log of the product of U's singular values, points removed.

    Residuals and Jacobian are projected on the complement of the columns of U. Singular values that
    count as zero are not in the product; without points the logarithm is 0.

    r, J, U : residuals (n, m), Jacobians by parameters (n, m, k) and by unknown points (n, m, u)
    """
    if not U.shape[2]:
        return r, J, 0.0
    Q, seen, _ = np.linalg.svd(U.reshape(-1, U.shape[2]), full_matrices=False)
    # Singular values of the Jacobian by the unknown points below this share of the largest one
    # count as zero: the poses do not determine such a direction of the points.
    Q, seen = Q[:, seen > 1e-9 * seen[0]], seen[seen > 1e-9 * seen[0]]
    both = np.concatenate([r[:, :, None], J], axis=2)
    flat = both.reshape(-1, both.shape[2])
    both = (flat - Q @ (Q.T @ flat)).reshape(both.shape)
    return both[:, :, 0], both[:, :, 1:], float(np.log(seen).sum())


# Ratio of repeatability to coordinate noise of each revolute joint [rad/m], the fit with it, and
# the posterior mean of the parameters in units of their scale, shape (k,).
_Fit = tuple[tuple[float, ...], NoiseFit, Array]


def _most_probable(poses: _Poses, doubts: UncertainParameters) -> _Fit:
    """Return ratios, fit and posterior mean at the most probable of REPEATABILITY_RATIOS.

    All joints have the same ratio. The search walks along the grid from its middle to the first
    ratio that is more probable than both neighbours.
    """
    tried: dict[int, _Fit] = {}
    best, at = -1, len(REPEATABILITY_RATIOS) // 2
    while best != at:
        best = at
        near = range(max(0, best - 1), min(len(REPEATABILITY_RATIOS), best + 2))
        rhos = {k: (REPEATABILITY_RATIOS[k],) * poses.joints for k in near if k not in tried}
        tried |= {k: (each, *_fit_at(each, poses, doubts)) for k, each in rhos.items()}
        at = near[first_of_best([tried[k][1].log_likelihood for k in near], logs=True)]
    return tried[best]


def _fit_at(
    rhos: tuple[float, ...], poses: _Poses, doubts: UncertainParameters, rounds: int = EM_ITERATIONS
) -> tuple[NoiseFit, Array]:
    """Return the fit with noise s2 (I + Jq Jq') and the posterior mean of the parameters (k,).

    Jq is the Jacobian by each joint's zero times its ratio.

    rhos : ratio of each revolute joint [rad/m]; rounds : iterations of expectation maximisation
    """
    (sums,), spread = _normal_equations(rhos, poses)
    sums = replace(sums, count=poses.count)
    s2, mean, S, variance = posterior_of(sums, doubts, rounds)
    root = np.sqrt(np.diag(S))
    log_det = float(np.log(variance).sum() - 2 * np.log(root).sum() - np.linalg.slogdet(S / np.outer(root, root))[1])
    square = float(sums.moved(mean).square / s2 + np.sum(mean**2 / variance))
    log_likelihood = -0.5 * (sums.count * np.log(s2) + square + log_det) - spread
    return NoiseFit(log_likelihood, sums, s2, variance), mean


def _normal_equations(
    rhos: tuple[float, ...], poses: _Poses, part: Array | None = None
) -> tuple[list[NormalSums], float]:
    """Return normal equations of each part of the whitened poses, and a term of the likelihood.

    Poses are whitened by the noise I + Jq Jq', with Jq the Jacobian by each joint's zero times its
    ratio. The term is half the log determinant of that noise, plus the log of the product of the
    singular values of the unknown points.

    rhos : ratio of each revolute joint [rad/m]; part : number of each pose's part, shape (n,);
        None: all poses are one part
    """
    sums_of: dict[int, NormalSums] = {}
    spread, done = 0.0, 0
    for r, J, Jq, U in poses:
        W, log_det = whitening_of(covariance_of(Jq, np.array(rhos)))
        white, Jw, seen = _without_points((W @ r[:, :, None])[:, :, 0], W @ J, W @ U)
        spread += 0.5 * log_det + seen
        own = np.zeros(len(white), dtype=int) if part is None else part[done : done + len(white)]
        done += len(white)
        for k in np.unique(own).tolist():
            sums = normal_sums(white[own == k], Jw[own == k])
            sums_of[k] = sums_of[k].plus(sums) if k in sums_of else sums
    return list(sums_of.values()), spread


def misfit_of(found: Identification) -> float:
    """Return the factor by which an identification's variances are to be multiplied, at least 1.

    It is the harmonic mean, over the directions of the identified parameters not at a bound, of the
    ratio of the variance by `wide_fit`, times its misfit, to the stated variance. It is 1 where
    that fit is impossible.
    """
    try:
        fit = wide_fit(found)
    except InputError:
        return 1.0
    determined = np.flatnonzero(np.isfinite(np.diag(found.covariance)))  # a parameter at its bound has no variance
    at = fit.doubts.solved[determined]
    scale = np.array([fit.robot.parameters[fit.doubts.names[k]].scale for k in at])
    own = found.covariance[np.ix_(determined, determined)] / np.outer(scale, scale)
    here = fit.best.sums.H[np.ix_(at, at)] / (fit.best.s2 * fit.misfit)
    return float(max(1.0, len(at) / np.sum(own * here)))


def _misfit_factor(of_parts: Sequence[Sequence[NormalSums]], mean: Array, s2: float, variance: Array) -> float:
    """Return the variance factor of residuals of similar poses over independent noise, at least 1.

    The scores J'e over parts of the poses, with the residuals e of the fit, are compared with what
    independent noise of variance s2 would give. The largest factor of all partitions is taken, less
    two standard deviations of chance.

    mean, variance : posterior mean and prior variance of the parameters, (k,); s2 : [mm^2]
    """
    whole = reduce(NormalSums.plus, of_parts[0])
    inverse = scaled_inverse(whole.H + s2 * np.diag(1 / variance))
    freedom = max(1.0, whole.count - float(np.sum(inverse * whole.H)))
    # Two standard deviations of the factor are attributed to chance.
    chance = 2.0 * np.sqrt(2 / freedom)
    factor = 1.0
    for parts in of_parts:
        pushed = usual = 0.0
        for sums in parts:
            push, seen = sums.moved(mean).g, inverse @ sums.H
            pushed += float(push @ inverse @ push) / s2
            usual += float(np.trace(seen) - np.sum(seen * seen.T))
        if usual > 0:
            factor = max(factor, pushed / usual - chance)
    return factor


def _by_region(q: Array) -> Array:
    """Return the number (0 to 11) of each pose's region of joint space, shape (n,).

    Regions are cells of about equal count along the two principal directions of q, scaled.

    q : joint variables, shape (n, joints) [rad or m]
    """
    centred = (q - q.mean(axis=0)) / np.maximum(q.std(axis=0), 1e-9)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][:2].T
    rank = along.argsort(axis=0).argsort(axis=0) / len(q)
    across = rank[:, 1] if rank.shape[1] > 1 else np.zeros(len(q))
    return np.asarray((4 * rank[:, 0]).astype(int) * 3 + (3 * across).astype(int))

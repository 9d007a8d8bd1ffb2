"""Statistics of a fit at its optimum: covariance, residual variance and redundancy.

v, shape (size,), are the scaled variables of the problem (see `least_squares`).
"""

from collections.abc import Iterator, Sequence

import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import robust_std
from casadical.identification.identifiability import scaled_inverse
from casadical.identification.least_squares import LeastSquares
from casadical.identification.residuals import loss_and_slope
from casadical.identification.solver import bounded_step


def covariance(problem: LeastSquares, v: Array, variance: float) -> Array:
    """Return the covariance of the free parameters, shape (p, p) [SI], points marginalised.

    Rows and columns of parameters at a bound are NaN. With a robust loss it is the sandwich H^-1
    (J' W^2 J + P) H^-1 of M-estimators (Huber and Ronchetti 2009, ch. 7), P the prior precision.

    v : the optimum, shape (size,); variance : of a residual in units of sigma squared, one if the
        sigmas are right
    """
    free = np.flatnonzero(~problem.at_bounds(v))
    inverse = scaled_inverse(problem.gradient(v)[1][np.ix_(free, free)])
    if problem.loss != "linear":
        squared = problem.prior_matrix + sum((J * w[:, None] ** 2).T @ J for w, J in _weighted(problem, v))
        inverse = inverse @ squared[np.ix_(free, free)] @ inverse
    whole = np.full((problem.size, problem.size), np.nan)
    whole[np.ix_(free, free)] = variance * inverse
    p = len(problem.names)
    return np.asarray(whole[:p, :p] * np.outer(problem.scale, problem.scale))


def variance(problem: LeastSquares, v: Array, *, trimmed: bool = False) -> float:
    """Return the variance of a residual at v in units of sigma^2: square sum by degrees of freedom.

    Informative priors are in both. With a robust loss, unless outliers were excluded (`trimmed`),
    it comes from the median of the sets' robust variances instead. With a correlated prior it is at
    least one: small residuals are no sign that prior or instrument is better than stated.
    """
    least = 1.0 if problem.correlated else 0.0
    freedom = max(1, problem.degrees_of_freedom)
    if problem.loss != "linear" and not trimmed:
        typical = float(np.median([robust_std(r) ** 2 for r in problem.residuals(v)]))
        return max(least, typical * problem.residual_count / freedom)
    return max(least, (problem.square(v) + problem.prior_square(v, counted=True)) / freedom)


def redundancies(problem: LeastSquares, v: Array) -> Array:
    """Return the redundancy number (1 minus leverage) of each residual, shape (residuals,).

    Their sum is the fit's effective number of degrees of freedom, if no pose has the weight zero:
    its redundancy is 1. Those of all sets follow each other, then those of given distances.

    v : the optimum, shape (size,)
    """

    def computed(v: Array) -> Array:
        """Return the redundancy numbers at v, shape (residuals,), computed part by part."""
        inverse = scaled_inverse(problem.gradient(v)[1])
        return np.concatenate([1 - w * np.einsum("ij,ij->i", J @ inverse, J) for w, J in _weighted(problem, v)])

    shares: Array = problem.cache.redundancies(v, computed)
    return shares


def _weighted(problem: LeastSquares, v: Array) -> Iterator[tuple[Array, Array]]:
    """Yield the loss weights, shape (rows,), and the Jacobian, (rows, size), of some residuals."""
    for k, r, J in problem.parts(v):
        yield np.repeat(loss_and_slope(problem.loss_of(k), r)[1], r.shape[1]), J


def steps_without(problem: LeastSquares, v: Array, groups: Sequence[Array]) -> Array:
    """Return the bounded Gauss-Newton steps from v without each group of poses, (groups, size).

    Step k is that of the problem without the poses of group k. A variable on which the omitted
    group alone has information keeps its value.

    groups : for every set the number of each pose's group, from 0, shape (n,)
    """
    count = 1 + max(int(own.max()) for own in groups)
    lost = [(np.zeros(problem.size), np.zeros((problem.size, problem.size))) for _ in range(count)]
    first = [0] * len(problem.sets)
    for k, r, J in problem.parts(v):
        if k == len(problem.sets):  # given distances between points belong to no row
            continue
        at = np.repeat(groups[k][first[k] : first[k] + len(r)], r.shape[1])
        first[k] += len(r)
        rows, y = problem.through_loss(k, r, J)
        for group, (gradient, information) in enumerate(lost):
            own = rows[at == group]
            gradient += own.T @ y[at == group]
            information += own.T @ own
    g, H = problem.gradient(v)
    lower, upper = problem.bounds
    near = lower - v, upper - v, problem.at_bounds(v)
    # Below this share of a variable's information, the difference is only rounding error.
    alone = [np.diag(H - information) > 1e-9 * np.diag(H) for _, information in lost]
    without = zip(lost, alone, strict=True)
    return np.stack([bounded_step(g - of[0], H - of[1], *near, some) for of, some in without])

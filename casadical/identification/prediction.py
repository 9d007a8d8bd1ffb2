"""Statistics of a fit at its optimum, and the covariance of all parameters, identified or not.

v, shape (size,), are the scaled variables of the problem (see `least_squares`).

Parameters that were not identified stay at their nominal values, off by an unknown amount e with
covariance S: from the robot's file or a prior, or else from their own priors. Through the fit they
move the identified ones by -A e, with A = (J' W J + P)^-1 J' W J_e, the least squares regression of
their columns J_e on those of the identified ones. Where the data do not distinguish them but the
predicted pose does, J_e - J A is not zero, and the prediction is uncertain by its share of S.
Source: the propagation of "consider parameters"; Tapley, Schutz and Born, Statistical Orbit
Determination (2004), section 6.2.

A robot may be built ten times better than its priors say, or half as well, which the data reveal:
all departures of arm parameters from the drawing have the standard deviation of their priors times
one unknown factor (size), those of base and tool, which a user placed, from the robot file by
another. A size is log-normal about one, its posterior follows from the
likelihood of the data with all parameters integrated out, and S is multiplied by the mean of its
square: a hierarchical model; Gelman et al., Bayesian Data Analysis (2013), chapter 5. Covariances
from other campaigns are not scaled.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.noise import log_gain_by_size
from casadical.core.linear_gaussian.normal_equations import joined, scaled_inverse
from casadical.identification.least_squares import FRAME_GROUPS, LeastSquares
from casadical.identification.solver import bounded_step
from casadical.robot.robot import Covariance, Robot


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
        weighted = ((J, problem.loss_weights(k, r)) for k, r, J in problem.parts(v))
        squared = problem.prior_matrix + sum((J * w[:, None] ** 2).T @ J for J, w in weighted)
        inverse = inverse @ squared[np.ix_(free, free)] @ inverse
    whole = np.full((problem.size, problem.size), np.nan)
    whole[np.ix_(free, free)] = variance * inverse
    p = len(problem.names)
    return np.asarray(whole[:p, :p] * np.outer(problem.scale, problem.scale))


def redundancies(problem: LeastSquares, v: Array) -> Array:
    """Return the redundancy number (1 minus leverage) of each residual, shape (residuals,).

    Their sum is the fit's effective number of degrees of freedom, if no pose has the weight zero:
    its redundancy is 1. Those of all sets follow each other, then those of given distances.

    v : the optimum, shape (size,)
    """

    def computed(v: Array) -> Array:
        """Return the redundancy numbers at v, shape (residuals,), computed part by part."""
        inverse = scaled_inverse(problem.gradient(v)[1])
        weighted = ((J, problem.loss_weights(k, r)) for k, r, J in problem.parts(v))
        return np.concatenate([1 - w * np.einsum("ij,ij->i", J @ inverse, J) for J, w in weighted])

    shares: Array = problem.cache.redundancies(v, computed)
    return shares


def steps_without(problem: LeastSquares, v: Array, groups: Sequence[Array]) -> Array:
    """Return the bounded Gauss-Newton steps from v without each group of poses, (groups, size).

    Step k is that of the problem without the poses of group k. A variable on which the omitted
    group alone has information keeps its value.

    groups : for every set the number of each pose's group, from 0, shape (n,)
    """
    count = 1 + max(int(own.max()) for own in groups)
    g, H = problem.gradient(v)
    without = [(g.copy(), H.copy()) for _ in range(count)]
    first = [0] * len(problem.sets)
    for k, r, J in problem.parts(v):
        if k == len(problem.sets):  # given distances between points belong to no row
            continue
        at = np.repeat(groups[k][first[k] : first[k] + len(r)], r.shape[1])
        first[k] += len(r)
        rows, y = problem.through_loss(k, r, J)
        for group, (gradient, information) in enumerate(without):
            own = rows[at == group]
            gradient -= own.T @ y[at == group]
            information -= own.T @ own
    lower, upper = problem.bounds
    near = lower - v, upper - v, problem.at_bounds(v)
    # Below this share of a variable's information, the difference is only rounding error.
    some = [np.diag(information) > 1e-9 * np.diag(H) for _, information in without]
    return np.stack([bounded_step(*without.pop(0), *near, own) for own in some])


def covariance_of_all(
    problem: LeastSquares, v: Array, variance: float, given: Robot
) -> tuple[LeastSquares, Array, Array]:
    """Return problem, departures (k,) and covariance (k, k) [SI] of all uncertain parameters.

    These are the k parameters that were identified, or have a prior width; those at a bound count
    as not identified. The problem is the solved one with their names, which give the order;
    departures are from nominal in units of scale.

    problem : as it was solved; v : its optimum; variance : of a residual in units of sigma squared
    given : the robot as its file has it, with base and tool where they were assumed to be
    """
    solved = ~problem.at_bounds(v)
    free = [n for n, is_solved in zip(problem.names, solved, strict=False) if is_solved]
    own = covariance(problem, v, variance)
    fixed = [p.name for p in problem.robot.parameters if p.name not in free and p.prior > 0]
    whole = problem.with_names([*free, *fixed])
    values = problem.values(v)
    start = [(values.get(n, p.value) - p.value) / p.scale for n in whole.names for p in [problem.robot.parameters[n]]]
    at_optimum = np.concatenate([start, v[len(problem.names) :]])
    H = whole.information(at_optimum)
    f, e = len(free), len(fixed)
    fitted = [*range(f), *range(f + e, len(H))]
    inside = np.flatnonzero(solved)
    P = problem.prior_matrix[np.ix_(inside, inside)]
    A = scaled_inverse(H[np.ix_(fitted, fitted)] + P) @ H[fitted, f : f + e]
    scale = whole.scale
    A = A[:f] * np.outer(scale[:f], 1 / scale[f:])
    sizes = _prior_size_factors(whole, at_optimum, variance, given)[f : f + e]
    S = _prior_covariance(problem, fixed) * np.outer(sizes, sizes)
    at = inside[inside < len(problem.names)]
    C = np.block([[own[np.ix_(at, at)] + A @ S @ A.T, -A @ S], [-S @ A.T, S]])
    return whole, np.array(start), C


def _prior_size_factors(whole: LeastSquares, v: Array, variance: float, given: Robot) -> Array:
    """Return the factor on each variable's prior width that the data suggest, shape as v.

    It is the root of the posterior mean square of the unknown size: one value for all arm
    parameters, another for base and tool. It is 1 where a covariance from another campaign applies,
    for effects, and for unknown points.

    variance : of a residual in units of sigma squared
    """
    own = [whole.robot.parameters[n] for n in whole.names]
    effects = {p.name for e in whole.robot.effects for p in e.parameters()}
    elsewhere = {n for block in _prior_covariances(whole) for n in block.names} | effects | whole.given.keys()
    frame, free = np.array([(p.group in FRAME_GROUPS, p.name not in elsewhere) for p in own]).T
    frames, arm = (np.flatnonzero(free & which) for which in (frame, ~frame))
    # Unknown points have one sigma of 1000 of their units, 1 m.
    unit = np.concatenate(
        [np.sqrt(np.diag(_prior_covariance(whole, whole.names))) / whole.scale, [1e3] * (len(v) - len(own))]
    )
    mean = whole.prior_mean / unit
    filed = dict(zip(whole.robot.parameters.names, whole.robot.values_of(given), strict=True))
    mean[frames] = [(filed[own[k].name] - own[k].value) / own[k].prior for k in frames]
    # The lower limit of the variance is for data without noise.
    M, c = _data_information(whole, v, max(variance, 1e-12), unit)
    grid = np.geomspace(1 / 50, 50, 61)
    # Prior standard deviations of the logarithms of the size of base and tool, and of the arm's.
    likely = np.add.outer(*(-0.5 * (np.log(grid) / spread) ** 2 for spread in (1.5, 1.0)))
    rest = np.setdiff1d(np.arange(len(v)), arm)
    for k, size in enumerate(grid):
        d = np.ones(len(v))
        d[frames] = size**-2
        normal = M[np.ix_(rest, rest)] + np.diag(d[rest])
        others = joined(normal, c[rest] + d[rest] * mean[rest], float(mean @ (d * mean)), 0.0)
        along = others.root @ M[np.ix_(rest, arm)]
        information, score = M[np.ix_(arm, arm)] - along.T @ along, c[arm] - along.T @ others.z
        likely[k] += others.log_norm - 0.5 * others.square + 0.5 * np.log(d).sum()
        likely[k] += log_gain_by_size(information[None], score[None], grid)[0]
    weight = np.exp(likely - likely.max())
    sizes = np.ones(len(v))
    for kind, axis in ((frames, 1), (arm, 0)):
        sizes[kind] = np.sqrt(weight.sum(axis=axis) @ grid**2 / weight.sum())
    return sizes


def _data_information(whole: LeastSquares, v: Array, variance: float, unit: Array) -> tuple[Array, Array]:
    """Return the data's information matrix M (size, size), and M times the estimate, (size,).

    Both are without the priors, of all variables in units of `unit`.

    variance : of a residual in units of sigma squared
    unit : of each variable, as a multiple of the problem's own unit, shape (size,)
    """
    g, H = whole.gradient(v)
    product = (H @ v - g - whole.prior_matrix @ whole.prior_mean) * unit / variance
    value, V = np.linalg.eigh((H - whole.prior_matrix) * np.outer(unit, unit) / variance)
    seen = value > len(v) * np.finfo(float).eps * value[-1]
    # Information relative to the prior is limited, so that squares keep their digits.
    V, information = V[:, seen], np.minimum(value[seen], 1e8)
    return (V * information) @ V.T, V @ (information / value[seen] * (V.T @ product))


def _prior_covariances(problem: LeastSquares) -> Iterator[Covariance]:
    """Yield the covariances from the robot file or another campaign."""
    yield from problem.robot.knowledge.covariance if problem.robot.knowledge else ()
    yield from (Covariance(*block) for block in problem.correlated)


def _prior_covariance(problem: LeastSquares, names: Sequence[str]) -> Array:
    """Return the prior covariance of parameters, shape (names, names) [SI].

    It is that of the problem or the robot file, or else diagonal with the parameters' own priors.
    """
    robot = problem.robot
    S = np.diag([problem.given.get(n, (0.0, robot.parameters[n].prior))[1] ** 2 for n in names])
    for block in _prior_covariances(problem):
        own = block.only(names)
        at = [list(names).index(n) for n in own.names]
        S[np.ix_(at, at)] = own.matrix
    return S

"""Covariance of all parameters, identified or not, for predictions at any pose.

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
another. A size is log-normal about one (`SIZE_LOG_SIGMAS`), its posterior follows from the
likelihood of the data with all parameters integrated out, and S is multiplied by the mean of its
square: a hierarchical model; Gelman et al., Bayesian Data Analysis (2013), chapter 5. Covariances
from other campaigns are not scaled.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.noise import gain
from casadical.core.linear_gaussian.normal_equations import joined
from casadical.identification.fit_statistics import covariance
from casadical.identification.identifiability import scaled_inverse
from casadical.identification.least_squares import FRAME_GROUPS, LeastSquares
from casadical.robot.robot import Covariance, Robot

# Prior standard deviations of the logarithm of the unknown factor on prior widths ("size"): that of
# the arm's parameters, and that of base and tool.
SIZE_LOG_SIGMAS = (1.0, 1.5)
# Largest factor on prior widths that is evaluated; the smallest one is its inverse.
MAX_SIZE = 50.0
# Number of factors on prior widths that are evaluated, in geometric progression.
SIZE_GRID_POINTS = 61


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

    whole : problem with all uncertain parameters; v : its variables at the optimum
    variance : of a residual in units of sigma squared; given : the robot as its file has it
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
    grid = np.geomspace(1 / MAX_SIZE, MAX_SIZE, SIZE_GRID_POINTS)
    likely = np.add.outer(*(-0.5 * (np.log(grid) / spread) ** 2 for spread in SIZE_LOG_SIGMAS[::-1]))
    rest = np.setdiff1d(np.arange(len(v)), arm)
    for k, size in enumerate(grid):
        d = np.ones(len(v))
        d[frames] = size**-2
        normal = M[np.ix_(rest, rest)] + np.diag(d[rest])
        others = joined(normal, c[rest] + d[rest] * mean[rest], float(mean @ (d * mean)), 0.0)
        along = others.root @ M[np.ix_(rest, arm)]
        value, V = np.linalg.eigh(M[np.ix_(arm, arm)] - along.T @ along)
        score = V.T @ (c[arm] - along.T @ others.z)
        likely[k] += others.log_norm - 0.5 * others.square + 0.5 * np.log(d).sum()
        likely[k] += gain(grid**-2, 1.0, np.maximum(value, 0)[None], score[None] ** 2)[0]
    weight = np.exp(likely - likely.max())
    sizes = np.ones(len(v))
    for kind, axis in ((frames, 1), (arm, 0)):
        sizes[kind] = np.sqrt(weight.sum(axis=axis) @ grid**2 / weight.sum())
    return sizes


def _data_information(whole: LeastSquares, v: Array, variance: float, unit: Array) -> tuple[Array, Array]:
    """Return the data's information matrix M (size, size), and M times the estimate, (size,).

    Both are without the priors, of all variables in units of `unit`.

    v : variables at which the problem is linearised; variance : of a residual in units of sigma
        squared
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

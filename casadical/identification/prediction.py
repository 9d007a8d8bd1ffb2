"""The covariance of all parameters after an identification: a prediction is unsure where the data said nothing.

Parameters that were not identified stand at their nominal values, off by an unknown amount e with covariance S: what
is known of them before, from the robot's file or a prior, or else by their own priors. Through the fit they move the
identified ones by -A e, with A = (J' W J + P)^-1 J' W J_e, the least squares regression of their columns J_e on those
of the identified ones. Where the data do not distinguish them but the pose to be predicted does, J_e - J A is not zero,
and the prediction is unsure by its share of S. Source: the propagation of "consider parameters"; Tapley, Schutz and
Born, Statistical Orbit Determination (2004), section 6.2.

A robot may be built ten times better than its priors say, or half as well, and what the data determined tells of it:
all parameters of the arm depart from the drawing by priors times one unknown size, those of base and tool, which a user
placed, from the robot file by another. A size is log-normal about one (`SPREADS`), its posterior follows from the
likelihood of the data with all parameters integrated, and S has the mean of its square: a hierarchical
model; Gelman et al., Bayesian Data Analysis (2013), chapter 5. What other campaigns told of parameters stays as it is.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.grid import gain
from casadical.core.linear_gaussian.normal_equations import joined
from casadical.identification.fit_statistics import covariance
from casadical.identification.identifiability import scaled_inverse
from casadical.identification.least_squares import FRAME_GROUPS, LeastSquares
from casadical.robot.robot import Covariance, Robot

# One sigma of the logarithm of the arm's size, of that of base and tool, and both are looked at so far from one.
SPREADS, FARTHEST, POINTS = (1.0, 1.5), 50.0, 61


def covariance_of_all(
    problem: LeastSquares, v: Array, variance: float, given: Robot
) -> tuple[LeastSquares, Array, Array]:
    """Of all parameters that are not known exactly: the problem with their names, their departures, covariance [SI].

    problem : as it was solved, with the optimum v; variance : of a residual in units of sigma; given : the robot as its
    file has it, base and tool where they were thought to be
    """
    solved = ~problem.at_bounds(v)
    free = [n for n, kept in zip(problem.names, solved, strict=False) if kept]
    own = covariance(problem, v, variance)
    held = [p.name for p in problem.robot.parameters if p.name not in free and p.prior > 0]
    whole = problem.with_names([*free, *held])
    values = problem.values(v)
    start = [(values.get(n, p.value) - p.value) / p.scale for n in whole.names for p in [problem.robot.parameters[n]]]
    at_optimum = np.concatenate([start, v[len(problem.names) :]])
    H = whole.information(at_optimum)
    f, e = len(free), len(held)
    fitted = [*range(f), *range(f + e, len(H))]
    inside = np.flatnonzero(solved)
    P = problem.prior_matrix[np.ix_(inside, inside)]
    A = scaled_inverse(H[np.ix_(fitted, fitted)] + P) @ H[fitted, f : f + e]
    scale = whole.scale
    A = A[:f] * np.outer(scale[:f], 1 / scale[f:])
    sizes = _sizes(whole, at_optimum, variance, given)[f : f + e]
    S = _known(problem, held) * np.outer(sizes, sizes)
    at = inside[inside < len(problem.names)]
    C = np.block([[own[np.ix_(at, at)] + A @ S @ A.T, -A @ S], [-S @ A.T, S]])
    return whole, np.array(start), C


def _sizes(whole: LeastSquares, v: Array, variance: float, given: Robot) -> Array:
    """Departures that the data let expect of each variable, root of their mean square, in units of its own prior."""
    own = [whole.robot.parameters[n] for n in whole.names]
    effects = {p.name for e in whole.robot.effects for p in e.parameters()}
    elsewhere = {n for block in _blocks(whole) for n in block.names} | effects | whole.given.keys()
    frame, free = np.array([(p.group in FRAME_GROUPS, p.name not in elsewhere) for p in own]).T
    frames, arm = (np.flatnonzero(free & which) for which in (frame, ~frame))
    # Of a point that nobody knows, one sigma in its units.
    unit = np.concatenate([np.sqrt(np.diag(_known(whole, whole.names))) / whole.scale, [1e3] * (len(v) - len(own))])
    mean = whole.prior_mean / unit
    filed = dict(zip(whole.robot.parameters.names, whole.robot.values_of(given), strict=True))
    mean[frames] = [(filed[own[k].name] - own[k].value) / own[k].prior for k in frames]
    # Least variance of a residual: readings without noise tell no more.
    M, c = _likelihood(whole, v, max(variance, 1e-12), unit)
    grid = np.geomspace(1 / FARTHEST, FARTHEST, POINTS)
    likely = np.add.outer(*(-0.5 * (np.log(grid) / spread) ** 2 for spread in SPREADS[::-1]))
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


def _likelihood(whole: LeastSquares, v: Array, variance: float, unit: Array) -> tuple[Array, Array]:
    """What the data alone tell of all variables, in these units: information and its product with their estimate."""
    g, H = whole.gradient(v)
    product = (H @ v - g - whole.prior_matrix @ whole.prior_mean) * unit / variance
    value, V = np.linalg.eigh((H - whole.prior_matrix) * np.outer(unit, unit) / variance)
    seen = value > len(v) * np.finfo(float).eps * value[-1]
    # What the data tell of a direction beside its prior counts no more than this, so that squares
    # keep their digits.
    V, kept = V[:, seen], np.minimum(value[seen], 1e8)
    return (V * kept) @ V.T, V @ (kept / value[seen] * (V.T @ product))


def _blocks(problem: LeastSquares) -> Iterator[Covariance]:
    """Covariances that the robot file or another campaign tells."""
    yield from problem.robot.knowledge.covariance if problem.robot.knowledge else ()
    yield from (Covariance(*block) for block in problem.known)


def _known(problem: LeastSquares, names: Sequence[str]) -> Array:
    """Covariance of held parameters [SI]: as the problem was given it, or of the robot file, or by their priors."""
    robot = problem.robot
    S = np.diag([problem.given.get(n, (0.0, robot.parameters[n].prior))[1] ** 2 for n in names])
    for block in _blocks(problem):
        own = block.only(names)
        at = [list(names).index(n) for n in own.names]
        S[np.ix_(at, at)] = own.matrix
    return S

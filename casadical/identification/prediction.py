"""The covariance of all parameters after an identification: a prediction is unsure where the data said nothing.

Parameters that were not identified stand at their nominal values, off by an unknown amount e with covariance S: what
is known of them before, from the robot's file or a prior, or else by their own priors. Through the fit they move the
identified ones by -A e, with A = (J' W J + P)^-1 J' W J_e, the least squares regression of their columns J_e on those
of the identified ones. Where the data do not distinguish them but the pose to be predicted does, J_e - J A is not zero,
and the prediction is unsure by its share of S. Source: the propagation of "consider parameters"; Tapley, Schutz and
Born, Statistical Orbit Determination (2004), section 6.2.
"""

from collections.abc import Mapping

import numpy as np

from casadical.core.arrays import Array
from casadical.identification.identifiability import scaled_inverse
from casadical.identification.least_squares import LeastSquares
from casadical.robot.knowledge import Covariance


def covariance_of_all(problem: LeastSquares, v: Array, variance: float) -> tuple[LeastSquares, Array, Array]:
    """Of all parameters that are not known exactly: the problem with their names, their departures, covariance [SI].

    problem : as it was solved, with the optimum v; variance : of a residual in units of sigma
    """
    solved = ~problem.at_bounds(v)
    free = [n for n, kept in zip(problem.names, solved, strict=False) if kept]
    own = problem.covariance(v, variance)
    held = [p.name for p in problem.robot.parameters if p.name not in free and p.prior > 0]
    whole = problem.with_names([*free, *held])
    values = problem.values(v)
    start = [(values.get(n, p.value) - p.value) / p.scale for n in whole.names for p in [problem.robot.parameters[n]]]
    H = whole.information(np.concatenate([start, v[len(problem.names) :]]))
    f, e = len(free), len(held)
    fitted = [*range(f), *range(f + e, len(H))]
    inside = np.flatnonzero(solved)
    P = problem.prior_matrix[np.ix_(inside, inside)]
    A = scaled_inverse(H[np.ix_(fitted, fitted)] + P) @ H[fitted, f : f + e]
    scale = whole.scale
    A = A[:f] * np.outer(scale[:f], 1 / scale[f:])
    S = _known(problem, held)
    at = inside[inside < len(problem.names)]
    C = np.block([[own[np.ix_(at, at)] + A @ S @ A.T, -A @ S], [-S @ A.T, S]])
    return whole, np.array(start), C


def _known(problem: LeastSquares, names: list[str]) -> Array:
    """Covariance of held parameters [SI]: as the problem was given it, or of the robot file, or by their priors."""
    robot = problem.robot
    given = problem.priors if isinstance(problem.priors, Mapping) else {}
    S = np.diag([given.get(n, (0.0, robot.parameters[n].prior))[1] ** 2 for n in names])
    blocks = (Covariance(*block) for block in problem.known)
    for block in (*(robot.knowledge.covariance if robot.knowledge else ()), *blocks):
        own = block.only(names)
        at = [names.index(n) for n in own.names]
        S[np.ix_(at, at)] = own.matrix
    return S

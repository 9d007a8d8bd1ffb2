"""How much less an identification determines than its covariance says, where residuals are not independent noise.

The fit is repeated in one linear step with all parameters and the first harmonics of each turning joint's error, which
are in no base model. What is left may still have something in common at poses that follow each other or have similar
readings: gear errors of higher order, slow drifts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.identification.error_bound import Doubts, Sums, doubts_of, evaluated, posterior_of, sums_of
from casadical.identification.identifiability import scaled_inverse
from casadical.identification.identification import Identification
from casadical.robot.error_bound import doubted
from casadical.robot.robot import Robot

# Harmonics of each joint's error.
ORDERS = 2
# Residuals are summed up over so many parts of the poses, by their order and by the region of the joints.
PARTS = 12
# So many standard deviations of the misfit factor are taken for chance.
CHANCE = 2.0
_MM = 1e-3


@dataclass(frozen=True, eq=False)
class WideFit:
    """Of all parameters that are not known exactly, and the harmonics; lengths in mm.

    robot : calibrated, with harmonics of zero size; sums : over the poses, at its values
    s2 : variance of a coordinate that nothing explains [mm^2]; variance : of each parameter before the data, shape (k,)
    misfit : how many times more than independent noise residuals of similar poses push the parameters, at least 1
    """

    robot: Robot
    doubts: Doubts
    sums: Sums
    s2: float
    variance: Array
    misfit: float


def wide_fit(found: Identification) -> WideFit:
    """The fit of all positions that an identification used. Raises InputError where nothing measured a position."""
    sets = [m.positions_alone() for m in found.used if m.position is not None]
    if not sets:
        raise InputError(f"{found.measurements[0].source}: nothing measured a position; a comparison needs positions")
    robot = doubted(found.robot, ORDERS)
    doubts = doubts_of(robot, found.names)
    r, J = evaluated(robot, sets, doubts.names)
    sums = sums_of(r, J)
    s2, mean, _, variance = posterior_of(sums, doubts)
    times = _misfit(r + J @ mean, J, np.concatenate([m.q for m in sets]), s2, variance)
    return WideFit(robot, doubts, sums, s2, variance, times)


def misfit_of(found: Identification) -> float:
    """By how much the variances of an identification are to be multiplied, at least 1; 1 without positions."""
    try:
        fit = wide_fit(found)
    except InputError:
        return 1.0
    own = max(sigma for sigma, _ in found.sigmas) / _MM
    return float(max(1.0, fit.misfit * fit.s2 / own**2))


def _misfit(e: Array, J: Array, q: Array, s2: float, variance: Array) -> float:
    """How many times more than independent noise the residuals of similar poses push the parameters.

    e : residuals of the fit, shape (n, 3) [mm]; J : shape (n, 3, k). The sums J'e over parts of the poses, which follow
    each other or have similar readings, are compared with what independent noise of variance s2 would give; at least 1.
    """
    H = np.einsum("nip,niq->pq", J, J, optimize=True)
    inverse = scaled_inverse(H + s2 * np.diag(1 / variance))
    freedom = max(1.0, e.size - float(np.sum(inverse * H)))
    chance = CHANCE * np.sqrt(2 / freedom)
    found = 1.0
    for part in (_by_order(len(e)), _by_region(q)):
        pushed = usual = 0.0
        for k in range(part.max() + 1):
            own = J[part == k].reshape(-1, J.shape[2])
            push, seen = own.T @ e[part == k].ravel(), own.T @ own
            pushed += float(push @ inverse @ push) / s2
            seen = inverse @ seen
            usual += float(np.trace(seen) - np.sum(seen * seen.T))
        if usual > 0:
            found = max(found, pushed / usual - chance)
    return found


def _by_order(n: int) -> Array:
    return np.arange(n) * min(PARTS, n) // n


def _by_region(q: Array) -> Array:
    """A number for the region of the joints in which each pose lies: cells of equal count along two directions."""
    centred = (q - q.mean(axis=0)) / np.maximum(q.std(axis=0), 1e-9)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][:2].T
    rank = along.argsort(axis=0).argsort(axis=0) / len(q)
    across = rank[:, 1] if rank.shape[1] > 1 else np.zeros(len(q))
    return np.asarray((4 * rank[:, 0]).astype(int) * 3 + (3 * across).astype(int))

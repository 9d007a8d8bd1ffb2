"""The Levenberg-Marquardt method for nonlinear least squares, for many problems at once."""

from collections.abc import Callable

import numpy as np

from casadical.core.basics import Array

# Cost at points, shape (k,), and a function that gives normal matrices, shape (j, p, p), and right
# sides, shape (j, p), of the problems that a mask, shape (k,), chooses.
Evaluated = tuple[Array, Callable[[Array], tuple[Array, Array]]]


def levenberg_marquardt(
    evaluate: Callable[[Array], Evaluated],
    start: Array,
    steps: int,
    *,
    move: Callable[[Array, Array], Array] = np.add,
    floor: float = 0.0,
    least_gain: float = -1.0,
) -> tuple[Array, Array]:
    """Return the best point of each problem, shape (k, m), and its cost, shape (k,).

    The damping of a problem is a share of the diagonal of its normal matrix: it falls to a fifth
    after a step that lowers the cost and rises tenfold after one that does not.

    evaluate : of points, shape (k, m), one for each problem
    steps : evaluations at most
    move : takes points and steps, shape (k, p), to new points
    floor : is added to the diagonal before it is damped, where no data may determine a direction
    least_gain : a problem has converged where a step lowers the cost by less than this share of
        cost + 1, or is damped by 1e6; the method ends when all have
    """
    best, cost = start, np.full(len(start), np.inf)
    damping, converged = np.full(len(start), 1e-3), np.zeros(len(start), dtype=bool)
    tried = start
    normal, right = np.empty((0, 0, 0)), np.empty((0, 0, 0))
    for _ in range(steps):
        now, sums = evaluate(tried)
        better = now < cost
        converged |= (better & (cost - now < least_gain * (now + 1))) | ((least_gain >= 0) & (damping > 1e6))
        best = np.where(better[:, None], tried, best)
        cost = np.minimum(now, cost)
        if converged.all():
            break
        damping = np.where(better, np.maximum(damping / 5, 1e-9), damping * 10)
        changed = sums(better)
        if not normal.size:
            normal = np.zeros((len(start), *changed[0].shape[1:]))
            right = np.zeros((len(start), changed[1].shape[1], 1))
        normal[better], right[better] = changed[0], changed[1][..., None]
        diagonal = np.eye(normal.shape[1]) * (floor + normal)
        step = np.linalg.solve(normal + damping[:, None, None] * diagonal, right)[..., 0]
        tried = move(best, step)
    return best, cost

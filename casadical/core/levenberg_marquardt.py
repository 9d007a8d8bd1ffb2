"""The Levenberg-Marquardt method for nonlinear least squares, for many problems at once."""

from collections.abc import Callable

import numpy as np

from casadical.core.basics import Array

# Costs of k problems at their points, shape (k,), and a function that takes a mask of problems,
# shape (k,), and returns the normal matrices, shape (j, p, p), and right sides of the equations of
# the step, shape (j, p), of the j chosen ones.
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
    """Return the evaluated point of least cost of each of k problems, (k, m), and its cost, (k,).

    The damping times (diagonal + `floor`) is added to the diagonal of a problem's normal matrix. It
    is 2e-4 in the first step, falls to a fifth, at least 1e-9, after a step that lowers the cost,
    and rises tenfold after one that does not.

    evaluate : function of points, shape (k, m), one for each problem; see `Evaluated`
    start : first points, shape (k, m)
    steps : largest number of evaluations
    move : function of points, (k, m), and steps, (k, p), that returns new points, (k, m)
    floor : see above; it damps directions that no data determine
    least_gain : a problem has converged when a step lowers the cost by less than this times
        (cost + 1), or its damping exceeds 1e6; the method ends when all have. Below zero: never
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
        cost = np.where(better, now, cost)  # a cost of NaN is none
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

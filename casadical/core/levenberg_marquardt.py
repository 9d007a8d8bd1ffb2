"""The Levenberg-Marquardt method for nonlinear least squares, for many problems at once."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from casadical.core.basics import Array

# Costs of k problems (sums of squares) at their points, shape (k,), and a function that takes a
# mask of problems, shape (k,), and returns J'J, shape (j, p, p), and -J'r, shape (j, p), of the j
# chosen ones, with the residuals r and their Jacobian J.
Evaluated = tuple[Array, Callable[[Array], tuple[Array, Array]]]


@dataclass(frozen=True, eq=False)
class Descent:
    """k problems before their next step.

    point : point of least cost so far of each, shape (k, m); cost : there, shape (k,)
    step : next one, shape (k, p); zero for problems that have converged
    damping : of this step, shape (k,)
    predicted : decrease of the cost by this step if residuals were linear, shape (k,)
    gain : decrease of the cost by the last step, shape (k,); refused unless it is positive;
        infinite before the first
    active : mask of the problems that have not converged, shape (k,)
    """

    point: Array
    cost: Array
    step: Array
    damping: Array
    predicted: Array
    gain: Array
    active: Array


def levenberg_marquardt(
    evaluate: Callable[[Array], Evaluated],
    start: Array,
    evaluations: int,
    *,
    move: Callable[[Array, Array], Array] = np.add,
    scale: Callable[[Array], Array] = np.asarray,
    solve: Callable[[Array, Array, Array], Array] | None = None,
    first: Array | float = 1e-3,
    least: float = 1e-9,
    factors: tuple[float, float] | None = None,
    relative: float = 0.0,
    absolute: float = 0.0,
) -> Iterator[Descent]:
    """Yield the state of k problems before each step, the last one with all steps done.

    The damping follows Nielsen (1999), IMM-REP-1999-05: a step that lowers the cost as predicted
    divides it by three, refused ones in a row multiply it by 2, 4, 8 and so on; by default.

    evaluate : function of points, shape (k, m), one for each problem; see `Evaluated`
    start : first points, shape (k, m)
    evaluations : largest number of evaluations, that of the start included
    move : function of points, (k, m), and steps, (k, p), that returns new points, (k, m)
    scale : function of the diagonals of J'J, (k, p), that returns the factors of the damping, which
        is added to them. By default they are the diagonals (Marquardt), by `np.ones_like` all equal
    solve : function of points, damped matrices and right sides that returns steps, such as bounded
        ones; by default the solution of the equations
    first, least : initial and least damping, in units of the largest diagonal over the largest
        factor. Zero: undamped up to the first refused step, which takes 1e-3
    factors : divisor of the damping after a step that lowers the cost, and its factor after a
        refused one, in place of Nielsen's rule
    relative, absolute : a problem has converged when a step lowers the cost by no more than
        relative times the cost plus absolute, or when neither refusals nor damping leave a gain
    """
    cost, sums = evaluate(start)
    point, active = start, np.isfinite(cost)
    normal, right = sums(np.ones(len(start), dtype=bool))
    damping, growth, gain = (np.full(len(start), value) for value in (0.0, 2.0, np.inf))
    for turn in range(evaluations):
        diagonal = np.einsum("kii->ki", normal)
        scales = scale(diagonal)
        unit = diagonal.max(axis=1) / scales.max(axis=1)
        damping = np.maximum(damping, (least if turn else first) * unit)
        damped, step = normal[active], np.zeros_like(right)
        np.einsum("kii->ki", damped)[...] += (damping[:, None] * scales)[active]
        if solve is None:
            step[active] = np.linalg.solve(damped, right[active][..., None])[..., 0]
        elif active.any():
            step[active] = solve(point[active], damped, right[active])
        bent = (step[:, None] @ normal)[:, 0]
        predicted = np.einsum("ki,ki->k", step, 2 * right - bent)
        yield Descent(point, cost, step, damping, predicted, gain, active)
        if turn == evaluations - 1 or not active.any():
            return
        tried = np.where(active[:, None], move(point, step), point)
        now, sums = evaluate(tried)
        gain = np.subtract(cost, now, out=np.zeros(len(start)), where=active)
        better = active & (gain > 0)  # a cost of NaN is none
        converged = np.where(better, gain <= relative * cost + absolute, predicted <= 1e-12 * cost)
        share = np.clip(gain / np.maximum(predicted, np.finfo(float).tiny), 0, 1)
        lower, higher = damping * np.maximum(1 / 3, 1 - (2 * share - 1) ** 3), damping * growth
        if factors is not None:
            lower, higher = damping / factors[0], damping * factors[1]
        damping = np.where(better, lower, np.where(damping > 0, higher, 1e-3 * unit))
        growth = np.where(better, 2.0, 2 * growth)
        active = active & ~converged & (growth <= 1e6)
        damping, growth = np.where(active, (damping, growth), 1.0)
        point, cost = np.where(better[:, None], tried, point), np.where(better, now, cost)
        if better.any():
            normal, right = normal.copy(), right.copy()
            normal[better], right[better] = sums(better)

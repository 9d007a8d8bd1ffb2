"""The bounded optimum of many parameters, step by step.

A symbolic Hessian would grow with the square of the parameters at every pose; products of the Jacobian do not.
"""

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import ConvergenceError
from casadical.identification.solver import Progress, Solution, minimise

MOST_STEPS, LEAST_STEP, NO_GAIN = 20, 1e-3, 1e-7


def solve_in_steps(
    cost_at: Callable[[Array], float],
    gradient_at: Callable[[Array], tuple[Array, Array]],
    bounds: tuple[Array, Array],
    progress: Progress | None,
) -> Solution:
    """The optimum from v = 0 on, linearised again at each step.

    cost_at : of v, shape (size,); gradient_at : gradient and Gauss-Newton Hessian at v; bounds : of v

    Raises ConvergenceError.
    """
    v = np.zeros(len(bounds[0]))
    history = [cost_at(v)]
    for _ in range(MOST_STEPS):
        found = _step(*gradient_at(v), *(bound - v for bound in bounds))
        share = 1.0
        while (cost := cost_at(v + share * found.v)) > history[-1] and share > LEAST_STEP:
            share *= 0.5
        gain = history[-1] - cost
        if gain > 0:
            v = v + share * found.v
            history.append(cost)
        if progress:
            progress(len(history) - 1, history[-1])
        if gain < NO_GAIN * history[-1]:
            return replace(found, v=v, history=tuple(history))
    raise ConvergenceError(f"no optimum in {MOST_STEPS} Gauss-Newton steps; check the data, or free fewer parameters")


def _step(g: Array, H: Array, lower: Array, upper: Array) -> Solution:
    """The step to the optimum of the quadratic: the normal equations' if it is inside of the bounds, else Ipopt's.

    g, H : gradient and Hessian of the cost, shapes (size,) and (size, size); lower, upper : of the step
    """
    free = -np.linalg.solve(H, g)
    if (free > lower).all() and (free < upper).all():
        return Solution(free, "Solve_Succeeded", "Gauss-Newton steps found an optimum inside of the bounds.", ())
    step = ca.MX.sym("step", len(g))
    slope = ca.DM(H) @ step + ca.DM(g)
    quadratic = ca.dot(step, slope + ca.DM(g)) / 2
    size = max(float(abs(g @ free)), 1e-12)
    upper_half = ca.MX(ca.triu(ca.DM(H)))
    return minimise(step, quadratic, (quadratic, slope), upper_half, lower, upper, scale=size)

"""The variance of residuals, with outliers and without."""

import numpy as np

from casadical.core.arrays import Array
from casadical.identification.least_squares import LeastSquares


def variance(problem: LeastSquares, v: Array, *, trimmed: bool = False) -> float:
    """Of a residual, in units of sigma: the sum of squares over the degrees of freedom.

    With a robust loss, and unless outliers were trimmed, from the median absolute residuals instead. With what is known
    from elsewhere at least one: that the prior leaves little is no sign that it, or the instrument, is better.
    """
    least = 1.0 if problem.known else 0.0
    freedom = max(1, problem.degrees_of_freedom)
    if problem.loss != "linear" and not trimmed:
        typical = float(np.median([robust_std(r) ** 2 for r in problem.residuals(v)]))
        return max(least, typical * problem.residual_count / freedom)
    return max(least, (problem.square(v) + problem.prior_square(v, told=True)) / freedom)


def robust_std(r: Array) -> float:
    """Standard deviation of residuals from their median absolute value, robust to outliers; zeros have weight zero."""
    counted = np.abs(r[r != 0])
    return float(1.4826 * np.median(counted)) if counted.size else 0.0

"""Hyperparameters of a Gaussian process by maximum marginal likelihood, some ten times as fast as scikit-learn.

The squared differences that the gradient needs are sums over rows: for symmetric S, sum S_ij (x_i - x_j)^2 is
2 (sum x_i^2 (S 1)_i - x' S x), so that no array of shape (n, n, inputs) is made. (Rasmussen and Williams 2006, 5.4.)
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from casadical.core.arrays import Array

_JITTER = 1e-10


def loss(theta: Array, X: Array, y: Array) -> tuple[float, Array]:
    """Minus the log marginal likelihood of outputs y, shape (n, m), of the same process, and its gradient.

    theta : logarithms of variance, length scales (one for each column of X, shape (n, inputs)) and noise variance
    """
    from scipy.linalg import cho_solve, cholesky

    (c, *scales, w), (n, m) = np.exp(theta), y.shape
    Z = X / np.array(scales)
    squares = np.sum(Z**2, axis=1)
    K = c * np.exp(-0.5 * np.maximum(squares[:, None] + squares - 2 * Z @ Z.T, 0.0))
    try:
        L = cholesky(K + (w + _JITTER) * np.eye(n), lower=True)
    except np.linalg.LinAlgError:
        return np.inf, np.zeros_like(theta)
    inverse = cho_solve((L, True), np.eye(n))
    solved = inverse @ y
    A = solved @ solved.T - m * inverse
    S = A * K
    by_scale = Z.T**2 @ S.sum(axis=1) - np.sum(Z * (S @ Z), axis=0)
    value = 0.5 * float(np.sum(y * solved)) + m * (float(np.log(np.diag(L)).sum()) + 0.5 * n * np.log(2 * np.pi))
    return value, -np.array([0.5 * S.sum(), *by_scale, 0.5 * w * np.trace(A)])


def optimizer(X: Array, y: Array) -> Callable[..., tuple[Array, float]]:
    """What scikit-learn takes as `optimizer` of a process of these data."""

    def found(_objective: Any, start: Array, bounds: Array) -> tuple[Array, float]:
        from scipy.optimize import minimize

        best = minimize(loss, start, (X, y), method="L-BFGS-B", jac=True, bounds=bounds)
        return best.x, float(best.fun)

    return found

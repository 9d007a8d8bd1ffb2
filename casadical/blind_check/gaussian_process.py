"""A Gaussian process on the residual of the base model: it names no cause and only shrinks the gap.

Its inputs are sines and cosines of all joints and everything else that was logged, with a length scale for each, found
by the marginal likelihood (Rasmussen and Williams 2006, chapter 5; by scikit-learn). The gradient of the likelihood is
some ten times as fast as scikit-learn's: the squared differences that it needs are sums over rows (for symmetric S, sum
S_ij (x_i - x_j)^2 is 2 (sum x_i^2 (S 1)_i - x' S x)), so that no array of shape (n, n, inputs) is made.
"""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from casadical.blind_check.outcomes import outlying
from casadical.blind_check.predictor import Session, in_mm
from casadical.core.arrays import Array
from casadical.core.errors import optional
from casadical.diagnosis.cross_validation import random_folds, shrink_interval
from casadical.identification.accuracy import predicted
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements

# Length scales to start from, in spreads of an input.
STARTS = (3.0, 1.0)
_JITTER = 1e-10
_LOGGED = ("progress", "temperature_degC", "payload_kg", *(f"approach{j}" for j in range(1, 7)))


def gaussian_process(s: Session) -> dict[str, Any]:
    """Learn the residuals: something is there if held-out ones become smaller; no cause is ever named."""
    base = s.fitted(s.robot, np.zeros(0, dtype=int))
    m, _ = derive(s.everything, base.conditions)
    p = predicted(base, m)[0]
    X = _inputs(m)
    assert m.position is not None
    # Points that are wrong by much would be learnt by all of their neighbours.
    whole = (m.position - p)[s.seen]
    r, Xr = whole[~outlying(whole)], X[s.seen][~outlying(whole)]
    unit = float(np.sqrt(np.mean(r**2)))
    folds = random_folds(len(r), 0)
    learnt = np.empty_like(r)
    for fold in np.unique(folds):
        test = folds == fold
        # Scales and all, or what is held out would have been seen.
        learnt[test] = unit * _fitted(Xr[~test], r[~test] / unit).predict(Xr[test])
    before, after = (np.linalg.norm(e, axis=1) for e in (r, r - learnt))
    shrinks = shrink_interval(before, after, 0)[0] > 0
    base_mm = p[~s.seen]
    better = base_mm + unit * _fitted(Xr, r / unit).predict(X[~s.seen]) if shrinks else base_mm
    return {
        "campaign": s.name,
        "verdict": "unknown" if shrinks else "none",
        "gap_mm": {
            "before": round(1e3 * float(before.mean()), 5),
            "after": round(1e3 * float((after if shrinks else before).mean()), 5),
        },
        "causes": [],
        "posterior": {},
        "unseen": {"base_mm": in_mm(base_mm), "with_causes_mm": in_mm(better)},
    }


def _inputs(m: Measurements) -> Array:
    """Shape (poses, inputs), each of unit spread; what never changes is left out."""
    parts = [np.sin(m.q), np.cos(m.q), *(m.conditions[c][:, None] for c in _LOGGED if c in m.conditions)]
    X = np.concatenate(parts, axis=1)
    spread = X.std(axis=0)
    return np.asarray((X - X.mean(axis=0))[:, spread > 1e-9] / spread[spread > 1e-9])


def _fitted(X: Array, y: Array) -> Any:
    process = optional("sklearn.gaussian_process", "--by gp needs scikit-learn: pip install 'casadical[withheld]'")
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    fits = []
    for scale in STARTS:
        shape = ConstantKernel(0.5, (1e-3, 1e2)) * RBF(np.full(X.shape[1], scale), (0.3, 1e3))
        kernel = shape + WhiteKernel(0.5, (1e-3, 1e1))
        with warnings.catch_warnings():
            # A length scale at its bound only says that an input does not matter.
            warnings.simplefilter("ignore", ConvergenceWarning)
            fits.append(process.GaussianProcessRegressor(kernel, optimizer=optimizer(X, y)).fit(X, y))
    return max(fits, key=lambda fit: float(fit.log_marginal_likelihood_value_))


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

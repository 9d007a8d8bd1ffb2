"""Small linear-Gaussian models, and the normal distribution that each of them is, written out in full."""

from dataclasses import replace

import numpy as np
from scipy.stats import multivariate_normal

from casadical.core.linear_gaussian.columns import array_columns
from casadical.core.linear_gaussian.model import LinearModel

SIGMAS = np.geomspace(1e-2, 1.0, 5)
KAPPAS = np.array([0.5, 1.0, 4.0])
RATIOS = np.array([0.0, 0.5, 2.0])
FALLING = np.array([1.0, 0.3, 0.0])
NONE = np.zeros(0, dtype=np.int64)


def small_model(ratios: np.ndarray = RATIOS, seed: int = 0, n: int = 7, m: int = 3) -> LinearModel:
    """Some blocks, four base parameters, six columns."""
    rng = np.random.default_rng(seed)
    Jq = rng.normal(size=(n, m, 2))
    J, E = rng.normal(size=(n, m, 4)), 0.1 * rng.normal(size=(n, m, 6))
    mean, prior = 0.1 * rng.normal(size=4), np.array([1.0, 0.03, 0.3, 10.0])
    r = J @ (mean + 0.01 * rng.normal(size=4)) + E @ [1.0, 0, -0.5, 0, 0, 2] + 0.1 * rng.normal(size=(n, m))
    return LinearModel(
        r=r,
        J=J,
        delta0=mean,
        prior=prior,
        E=array_columns(E),
        cause_prior=np.array([8.0, 8.0, 8.0, 2.0, 2.0, 8.0]),
        Jq=Jq,
        sigmas=SIGMAS,
        ratios=ratios,
        kappas=KAPPAS,
        reference=0.1,
        near=tuple(range(len(ratios))),
    )


def without_last_rows(model: LinearModel, blocks: np.ndarray) -> LinearModel:
    """Some blocks have one row fewer than the others: zeros stand in its place."""
    r, J, E = model.r.copy(), model.J.copy(), model.E.take(np.arange(model.width)).copy()
    Jq = model.Jq.copy()
    for rows in (r, J, E, Jq):
        rows[blocks, -1] = 0.0
    measured = np.ones(r.shape, dtype=bool)
    measured[blocks, -1] = False
    return replace(model, r=r, J=J, E=array_columns(E), Jq=Jq, measured=measured)


def noise_of(model: LinearModel, point: int, sigma: float) -> np.ndarray:
    """Covariance of all rows' noise."""
    n, m = model.r.shape
    C = np.zeros((n * m, n * m))
    for b in range(n):
        A = model.ratios[point] * model.Jq[b]
        C[m * b : m * b + m, m * b : m * b + m] = sigma**2 * (np.eye(m) + A @ A.T)
    return C


def log_density(model: LinearModel, point: int, sigma: float, chosen: np.ndarray, group: np.ndarray, kappa: float):
    """log p(r), less what the package leaves out, which is the same for every noise and group."""
    rows, share = model.r.size, sigma / model.reference
    J = model.J.reshape(rows, -1)
    E = model.E.take(np.arange(model.width)).reshape(rows, -1)
    C = noise_of(model, point, sigma) + (J * (share * model.prior) ** 2) @ J.T
    C += (E[:, chosen] * (share * model.cause_prior_sigmas[chosen]) ** 2) @ E[:, chosen].T
    C += kappa**2 * E[:, group] @ E[:, group].T
    measured = np.any(np.abs(J) > 0, axis=1)
    density = multivariate_normal((J @ model.delta0)[measured], C[np.ix_(measured, measured)])
    priors = np.concatenate([model.prior, model.cause_prior_sigmas[chosen]])
    left_out = -0.5 * measured.sum() * np.log(2 * np.pi) + np.log(model.reference / priors).sum()
    return float(density.logpdf(model.r.ravel()[measured]) - left_out)

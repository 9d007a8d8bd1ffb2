"""Parametric bootstrap p-value of "no cause": how often pure noise has as large odds of one.

Noise of instrument and joints is drawn from the base model's own likelihood, projected on what the
base parameters do not absorb, and evaluated by the detection statistic: the log odds of any cause,
listed or not, against none (Davison and Hinkley, Bootstrap Methods and their Application, 1997, ch.
4).
"""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from casadical.core.basics import Array, Show
from casadical.diagnosis.evidence import KAPPA_GRID, KAPPA_WEIGHTS, RHO_GRID, Evidence
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.posterior import PRIOR_FIRST, Ranking, prior_weights

# One setting of a cause at one repeatability ratio: the indices of its columns, (k,), log prior
# probability of the cause with this setting, and eigenvalues, (k,), and eigenvectors, (k, k), of the
# columns' Gram matrix.
Group = tuple[Array, float, Array, Array]


def p_value(case: Case, ranking: Ranking, draws: int, seed: int, show: Show) -> float:
    """Return the p-value of no cause: how often pure noise has odds of a cause as high as the data.

    It is a fraction of the draws, above 0 to 1; the data count as one more draw.
    ranking : that of the data, without a cause in the model
    draws : number of draws of noise; show : called with a line of progress
    """
    ranking = ranking.restricted_to({c.label for c in case.candidates})
    seen = float(np.log1p(-ranking.none) - np.log(max(ranking.none, 1e-300)))
    rng = np.random.default_rng(seed)
    beyond = done = 0
    for odds in noise_odds(case, draws, rng):
        beyond += int((odds >= seen).sum())
        done += len(odds)
        show(f"bootstrap: {done} of {draws} draws, {beyond} beyond the data")
    return (1 + beyond) / (1 + draws)


def noise_odds(case: Case, draws: int, rng: np.random.Generator) -> Iterator[Array]:
    """Yield the log odds of any cause against none for draws of pure noise, in batches.

    draws : number of draws; an item has the shape (draws of the batch,)
    """
    e = case.evidence
    share = np.exp(e.log_base() - np.logaddexp.reduce(e.log_base(), axis=None))
    # Grid points of the noise with a posterior below 0.01 are not drawn and not summed over.
    rhos, sigmas = (np.flatnonzero(share.sum(axis=a) > 0.01) for a in (1, 0))
    # The most likely sigma of a draw may lie one grid step away.
    sigmas = np.arange(max(sigmas[0] - 1, 0), min(sigmas[-1] + 2, len(e.sigmas)))
    E = e.take(np.arange(e.width))
    projections = [e.projection(float(RHO_GRID[k])) for k in rhos]
    white = [p.columns(E) for p in projections]
    groups = [_groups(case, columns) for columns in white]
    for first in range(0, draws, 500):  # some draws at once, which bounds memory
        noise = noise_alone(e, share, min(500, draws - first), rng)
        total = [
            log_likelihoods(columns, p.columns(noise), own, e.sigmas[sigmas], p.log_norm, e.count - e.absorbed)
            for columns, p, own in zip(white, projections, groups, strict=True)
        ]
        nothing, something = (np.logaddexp.reduce([t[s] for t in total], axis=0) for s in (0, 1))
        yield something - nothing - np.log(PRIOR_FIRST["none"])


def noise_alone(e: Evidence, share: Array, count: int, rng: np.random.Generator) -> Array:
    """Return draws of the noise of instrument and joints at all poses, shape (n, 3, count) [m].

    share : posterior probability of each point of the noise grid, shape (rhos, sigmas), from which
        the size of the noise is drawn; count : number of draws
    """
    rho, sigma = np.unravel_index(rng.choice(share.size, count, p=share.ravel()), share.shape)
    joints = RHO_GRID[rho] * rng.standard_normal((len(e.r), e.Jq.shape[2], count))
    white = rng.standard_normal((*e.r.shape, count))
    if e.measured is not None:
        white *= e.measured[:, :, None]
    return np.asarray(e.sigmas[sigma] * (white + e.Jq @ joints))


def _groups(case: Case, white: Array) -> list[Group]:
    """Return for each variant of each candidate its columns, prior and Gram matrix's eigenpairs.

    The prior of a candidate is divided equally among its variants.
    white : all columns, whitened and orthogonal to the base model, shape (rows, columns)
    """
    weights = prior_weights(case.candidates, PRIOR_FIRST, frozenset())
    count = Counter(label for label, _ in case.groups)
    groups = []
    for (label, _), columns in case.groups.items():
        E = white[:, columns]
        value, vector = np.linalg.eigh(E.T @ E)
        log_weight = float(np.log(weights[label] / count[label]))
        groups.append((columns, log_weight, np.maximum(value, 0), vector))
    return groups


def log_likelihoods(
    E: Array, Y: Array, groups: list[Group], sigma: Array, log_norm: float, numbers: float
) -> tuple[Array, Array]:
    """Return the log likelihoods of each draw without a cause and with any, shapes (draws,).

    They are summed over the grid of the noise, the latter also over the groups and sizes of causes,
    weighted by their priors (the former without the prior of no cause).
    E : columns of all candidates, whitened and orthogonal to the base model, shape (rows, columns)
    Y : draws, treated likewise, shape (rows, draws); sigma : grid of the noise, shape (sigmas,) [m]
    log_norm : term that does not depend on sigma or cause
    numbers : degrees of freedom of the noise
    """
    base = log_norm - numbers * np.log(sigma)[:, None] - 0.5 * (Y**2).sum(axis=0) / sigma[:, None] ** 2
    b = E.T @ Y
    something = np.full(Y.shape[1], -np.inf)
    signal = ((KAPPA_GRID[None, :] / sigma[:, None]) ** 2).ravel()
    own = np.repeat(sigma, len(KAPPA_GRID))
    log_kappa = np.tile(np.log(KAPPA_WEIGHTS), len(sigma))
    for columns, log_weight, value, vector in groups:
        gain = 1 + signal[:, None] * value
        quad = (signal[:, None] / gain / own[:, None] ** 2) @ (vector.T @ b[columns]) ** 2
        constant = log_weight + log_kappa - 0.5 * np.log(gain).sum(axis=1)
        logs = np.repeat(base, len(KAPPA_GRID), axis=0) + constant[:, None] + 0.5 * quad
        something = np.logaddexp(something, np.logaddexp.reduce(logs, axis=0))
    return np.logaddexp.reduce(base, axis=0), something

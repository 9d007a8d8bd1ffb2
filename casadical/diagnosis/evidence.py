"""Marginal likelihoods of causes: Gaussian effects of realistic size on the residual, orthogonal to the base model.

The residual is r = J delta + E theta + noise, with noise covariance sigma^2 (I + rho^2 Jq Jq') of instrument and joint
repeatability, delta ~ N(delta0, prior) and theta ~ N(0, (kappa size)^2). delta and theta are integrated in closed
form; sigma, rho and kappa on grids. Base parameters that the data tell well are thereby projected out; one that they
tell badly keeps its prior. (MacKay 1992; Kass and Raftery 1995.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from casadical.core.transforms import Array
from casadical.effects.base import CHOSEN

SIGMAS = np.geomspace(3e-6, 300e-6, 33)
# Joint repeatability over the instrument's sigma [rad/m].
RHOS = np.array([0.0, 0.1, 0.2, 0.4, 0.8, 1.6])
KAPPAS = np.array([0.35, 0.7, 1.4, 2.8, 5.6])
KAPPA_WEIGHTS = np.array([0.15, 0.25, 0.3, 0.2, 0.1])


@dataclass(frozen=True, eq=False)
class Whitened:
    """The problem at one rho: residual and columns made white and orthogonal to the base model.

    y : shape (rows,); E : shape (rows, columns), columns in units of their size
    basis : orthonormal basis of the base model, shape (rows, P); log_norm : what does not depend on sigma or cause
    """

    y: Array
    E: Array
    basis: Array
    rows: int
    log_norm: float


@dataclass(frozen=True, eq=False)
class Evidence:
    """Residuals of a calibrated robot, what the base model and the candidate causes do to them.

    r : measured less modelled position, shape (n, 3) [m]
    J : base model's Jacobian, shape (n, 3, P); Jq : by joint variables, shape (n, 3, joints)
    delta0 : prior mean of the parameters less their present values, shape (P,); prior : one sigma, shape (P,)
    E : columns of all candidates, shape (n, 3, columns), in m per unit of size
    """

    r: Array
    J: Array
    Jq: Array
    delta0: Array
    prior: Array
    E: Array
    reference: float = 20e-6

    @cached_property
    def whitened(self) -> tuple[Whitened, ...]:
        return tuple(self.white(float(rho)) for rho in RHOS)

    def white(self, rho: float) -> Whitened:
        """The problem at one rho, joint repeatability over the instrument's sigma [rad/m]."""
        C = np.eye(3) + rho**2 * self.Jq @ self.Jq.transpose(0, 2, 1)
        L = np.linalg.cholesky(C)
        W = np.linalg.inv(L)
        flat = [(W @ part).reshape(self.r.size, -1) for part in (self.r[:, :, None], self.J, self.E)]
        weights = self.reference / self.prior
        A = np.concatenate([flat[1], np.diag(weights)])
        # A parameter whose column is long is scaled first, so that rank is judged fairly.
        Q, R = np.linalg.qr(A / np.linalg.norm(A, axis=0))
        y = np.concatenate([flat[0].ravel(), weights * self.delta0])
        rows = self.r.size
        E = -Q @ (Q[:rows].T @ flat[2])
        E[:rows] += flat[2]
        log_det = 2 * float(np.log(np.diagonal(L, axis1=1, axis2=2)).sum())
        log_det += 2 * float(np.log(np.abs(np.diag(R)) * np.linalg.norm(A, axis=0)).sum())
        return Whitened(y - Q @ (Q.T @ y), E, Q, rows, -0.5 * log_det)

    def log_base(self) -> Array:
        """Log likelihood without any cause, shape (rhos, sigmas)."""
        return np.array([w.log_norm - w.rows * np.log(SIGMAS) - 0.5 * (w.y @ w.y) / SIGMAS**2 for w in self.whitened])

    def log_grids(self, groups: Sequence[Array], also: Array | None = None) -> Array:
        """Log likelihood of each group of columns as a cause, shape (groups, rhos, sigmas, kappas).

        also : columns of causes that are in the model already; they are treated like the base model
        """
        problem = self if also is None or not len(also) else self.with_base(also)
        base = problem.log_base()
        out = np.empty((len(groups), len(RHOS), len(SIGMAS), len(KAPPAS)))
        widths = np.array([len(g) for g in groups])
        signal = (KAPPAS[None, :] / SIGMAS[:, None]) ** 2
        for k, w in enumerate(problem.whitened):
            b, by_column = w.E.T @ w.y, np.ascontiguousarray(w.E.T)
            for width in np.unique(widths):
                which = np.flatnonzero(widths == width)
                columns = np.stack([groups[int(g)] for g in which])
                E = by_column[columns]
                G = E @ E.transpose(0, 2, 1)
                value, vector = np.linalg.eigh(G)
                turned = np.einsum("gij,gi->gj", vector, b[columns])
                gain = 1 + signal[None, :, :, None] * np.maximum(value, 0)[:, None, None, :]
                quad = signal[None, :, :, None] * turned[:, None, None, :] ** 2 / gain
                quad = quad.sum(axis=3) / SIGMAS[None, :, None] ** 2
                out[which, k] = base[k][None, :, None] - 0.5 * np.log(gain).sum(axis=3) + 0.5 * quad
        return out

    def with_base(self, columns: Array) -> Evidence:
        """The problem with these columns moved into the base model, their prior wide."""
        J = np.concatenate([self.J, self.E[:, :, columns]], axis=2)
        zero, one = np.zeros(len(columns)), np.full(len(columns), CHOSEN)
        return Evidence(
            self.r, J, self.Jq, np.concatenate([self.delta0, zero]), np.concatenate([self.prior, one]), self.E
        )


def log_sum(a: Array, axis: int | tuple[int, ...] | None = None) -> Array:
    """log(sum(exp(a))) without overflow."""
    top = np.max(a, axis=axis, keepdims=True)
    total = np.log(np.exp(a - top).sum(axis=axis, keepdims=True)) + top
    return np.asarray(np.squeeze(total, axis=axis) if axis is not None else total.item())

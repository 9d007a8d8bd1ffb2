"""Log evidence of thousands of laws at one place, quickly: what all of them share is computed once.

A law's columns are those of its place, pose by pose, times functions of the driver. Made white and orthogonal to the
base model, their products need two things for each place: products of its own columns at each pose, and its columns in
the axes of the base model, shape (P, n). The rest is a product of matrices for all functions together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadical.core.basics import Array
from casadical.diagnosis.evidence import KAPPA_WEIGHTS, KAPPAS, REPEATABILITY, RHOS, SIGMAS, Evidence

# Log evidence of what is not judged.
NEVER = -1e9


@dataclass(frozen=True, eq=False)
class Screen:
    """A problem at one rho.

    W : makes each pose's columns white, shape (n, 3, 3); Q : base model's axes, shape (n, 3, P)
    y : residual, white and orthogonal to the base model, shape (n, 3)
    square, rows : of the whole residual and of the scatter of repeated poses, and how many numbers these are
    """

    W: Array
    Q: Array
    y: Array
    square: float
    rows: int

    @classmethod
    def at_rho(cls, e: Evidence, rho: int) -> Screen:
        """The problem at a rho of the grid, by its number."""
        r = float(RHOS[rho])
        projection = e.projection(r)
        y = projection.y
        rows, (scatter, freedom) = e.r.size, (e.known.repeats, e.known.freedom)
        again = freedom * scatter**2 / e.noise.mean_variance({REPEATABILITY: r}, rows)
        Q, left = projection.Q[:rows].reshape(*e.r.shape, -1), y[:rows].reshape(e.r.shape)
        return cls(projection.whitening.W, Q, left, float(y @ y) + again, round(e.count - e.absorbed) + freedom)

    def products(self, columns: Array, functions: Array) -> tuple[Array, Array]:
        """Products of every law's columns, shape (K, w, w), and with the residual, shape (K, w); w = parts times d.

        columns : of the place, shape (n, 3, d); functions : parts of the forms at the poses, shape (parts, n, K), or of
            each column, shape (parts, n, d, K)
        """
        B = self.W @ columns
        d, parts = B.shape[2], len(functions)
        M = np.einsum("nap,nad->dpn", self.Q, B)
        each = functions[:, :, None] if functions.ndim == 3 else functions
        own_of = [0] * d if functions.ndim == 3 else range(d)
        F = [[np.ascontiguousarray(part[:, i]) for i in range(each.shape[2])] for part in each]
        seen = [[M[i] @ part[own_of[i]] for i in range(d)] for part in F]
        own = np.einsum("nai,naj->ijn", B, B)
        K = functions.shape[-1]
        G = np.empty((K, parts * d, parts * d))
        for a in range(parts):
            for b in range(a, parts):
                both = F[a][0] * F[b][0]
                for i in range(d):
                    for j in range(i if a == b else 0, d):
                        if functions.ndim > 3:
                            both = F[a][i] * F[b][j]
                        G[:, a * d + i, b * d + j] = own[i, j] @ both - np.einsum("pk,pk->k", seen[a][i], seen[b][j])
                        G[:, b * d + j, a * d + i] = G[:, a * d + i, b * d + j]
        right = np.einsum("nai,na->in", B, self.y)
        return G, np.stack([right[i] @ part[own_of[i]] for part in F for i in range(d)], axis=1)

    def reach(self, G: Array, b: Array) -> Array:
        """What log evidence over none no law exceeds, whatever its size and the noise, shape (K,); see `gains`."""
        free = (SIGMAS[0] / KAPPAS[-1]) ** 2 * np.eye(G.shape[1])
        taken = (b * np.linalg.solve(G + free, b[:, :, None])[:, :, 0]).sum(axis=1)
        return np.asarray(-0.5 * self.rows * np.log1p(-np.minimum(taken / self.square, 1 - 1e-12)))

    def gains(self, G: Array, b: Array, least: float = 0.0) -> Array:
        """Log evidence of each law over none, mean over sizes, noise as it comes out; shape (K,).

        G, b : products of columns in units of their sizes (see `products`)
        least : laws that cannot reach this are not judged, and have `NEVER`
        """
        if least > 0:
            found, can = np.full(len(b), NEVER), self.reach(G, b) >= least
            found[can] = self.gains(G[can], b[can])
            return found
        rows = self.rows
        least = float(SIGMAS[0]) ** 2
        before = max(self.square / rows, least)
        if G.shape[1] == 1:
            value, turned = G[:, :, 0], b
        else:
            value, vector = np.linalg.eigh(G)
            turned = (vector * b[:, :, None]).sum(axis=1)
        value = np.maximum(value, 0.0)
        logs = np.empty((len(KAPPAS), len(b)))
        for k, kappa in enumerate(KAPPAS):
            size = kappa**2
            variance = np.full(len(b), before)
            for _ in range(2):
                taken = (size * turned**2 / (variance[:, None] + size * value)).sum(axis=1)
                variance = np.maximum((self.square - taken) / rows, least)
            gain = 1 + size * value / variance[:, None]
            quad = (size * turned**2 / gain).sum(axis=1) / variance
            logs[k] = -0.5 * rows * np.log(variance) - 0.5 * np.log(gain).sum(axis=1)
            logs[k] += 0.5 * (quad - self.square) / variance
        none = -0.5 * rows * np.log(before) - 0.5 * self.square / before
        return np.asarray(log_mean(logs, np.log(KAPPA_WEIGHTS)[:, None]) - none)


def log_mean(logs: Array, log_weights: Array | float = 0.0) -> Array:
    """log(sum(exp(logs + weights))) over the first axis."""
    logs = logs + log_weights
    top = logs.max(axis=0)
    return np.asarray(top + np.log(np.exp(logs - top).sum(axis=0)))

"""Normal equations: sums of products of white rows, and parameters that join a model by them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dtrtri

from casadical.core.basics import Array


@dataclass(frozen=True, eq=False)
class NormalSums:
    """Of white rows A and residual y: H = A'A, g = A'y, y'y, and how many were measured; blocks may be taken off."""

    H: Array
    g: Array
    square: float
    count: int

    def plus(self, other: NormalSums) -> NormalSums:
        return NormalSums(self.H + other.H, self.g + other.g, self.square + other.square, self.count + other.count)

    def less(self, other: NormalSums) -> NormalSums:
        """Without the rows of another one."""
        return NormalSums(self.H - other.H, self.g - other.g, self.square - other.square, self.count - other.count)

    def moved(self, x: Array) -> NormalSums:
        """With y + A x as the residual."""
        return NormalSums(self.H, self.g + self.H @ x, self.square + 2 * x @ self.g + x @ self.H @ x, self.count)


def normal_sums(y: Array, A: Array) -> NormalSums:
    """Of white rows; y : shape (n, m) or (rows,), A : shape (n, m, p) or (rows, p)."""
    rows, left = A.reshape(-1, A.shape[-1]), y.ravel()
    return NormalSums(rows.T @ rows, rows.T @ left, float(left @ left), len(left))


@dataclass(frozen=True, eq=False)
class Joined:
    """Parameters that joined a model at one noise.

    L, scale : Cholesky factor of their scaled normal matrix beside those before, and what scales it
    z : what they take up in the axes of `root`, shape (new,)
    square, log_norm : of the residual, what is left; of the log likelihood, what does not depend on sigma
    """

    L: Array
    scale: Array
    z: Array
    square: float
    log_norm: float

    @cached_property
    def root(self) -> Array:
        """Of the inverse of their normal matrix, shape (new, new)."""
        return np.asarray(inverse_of_triangle(self.L) * self.scale)


def joined(normal: Array, right: Array, square: float, log_norm: float) -> Joined:
    """How parameters join a model.

    normal : beside what is in the model, shape (new, new); right : products with what was left, shape (new,)
    square, log_norm : of the model before
    """
    # A parameter whose column is long is scaled first, so that rank is judged fairly.
    scale = 1 / np.sqrt(np.diag(normal))
    L, z = reduced(normal * np.outer(scale, scale), scale * right)
    return Joined(L, scale, z, square - float(z @ z), log_norm - float((np.log(np.diag(L)) - np.log(scale)).sum()))


def without_others(H: Array, g: Array, kept: Array, inverse: Array) -> tuple[Array, Array]:
    """Information and score of some parameters, the others integrated.

    H, g : of all; kept : numbers of those asked for; inverse : of the others' H with their prior, in rising order
    """
    rest = np.setdiff1d(np.arange(len(g)), kept)
    own = inverse @ H[np.ix_(rest, kept)]
    return H[np.ix_(kept, kept)] - H[np.ix_(kept, rest)] @ own, g[kept] - own.T @ g[rest]


def inverse_of_triangle(L: Array) -> Array:
    """Return the inverse of a lower triangle, shape (p, p)."""
    return np.asarray(dtrtri(L, lower=1)[0]) if len(L) else L


def reduced(normal: Array, right: Array) -> tuple[Array, Array]:
    """Cholesky factor L of a normal matrix, shape (p, p), and the solution z of L z = right, in one factorisation.

    normal : of unit diagonal. Raises numpy.linalg.LinAlgError where it is not positive definite, beyond round-off.
    """
    L = _factor(normal)
    return L, solve_triangular(L, right, lower=True)


def root_of_inverse(normal: Array) -> Array:
    """A root R of the inverse R' R of a normal matrix, shape (p, p), scaled first so that rank is judged fairly.

    Raises numpy.linalg.LinAlgError where the matrix is not positive definite, beyond round-off.
    """
    scale = 1 / np.sqrt(np.diag(normal))
    return np.asarray(inverse_of_triangle(_factor(normal * np.outer(scale, scale))) * scale)


def inverse_of(normal: Array) -> Array:
    """Inverse of a normal matrix, shape (p, p), as `root_of_inverse`: symmetric to the last bit."""
    root = root_of_inverse(normal)
    return np.asarray(root.T @ root)


def _factor(normal: Array) -> Array:
    try:
        return np.linalg.cholesky(normal)
    except np.linalg.LinAlgError:
        # What round-off may take from a matrix of unit diagonal: where it is not positive definite,
        # so much is added.
        return np.linalg.cholesky(normal + 1e-10 * np.eye(len(normal)))

"""Normal equations: sums of products of whitened rows, and adding parameters to a model by them."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from casadical.core.basics import Array

# Largest size of a triangle that numpy inverts as a full matrix: scipy.linalg takes longer to import
# than a thousand of these.
MAX_NUMPY_ROWS = 50


@dataclass(frozen=True, eq=False)
class NormalSums:
    """Sums of products of whitened rows A and residual y, which can be added and subtracted.

    H : A'A, shape (p, p)
    g : A'y, shape (p,)
    square : y'y
    count : number of rows
    """

    H: Array
    g: Array
    square: float
    count: int

    def plus(self, other: NormalSums) -> NormalSums:
        """Return the sums of the rows of both."""
        return NormalSums(self.H + other.H, self.g + other.g, self.square + other.square, self.count + other.count)

    def less(self, other: NormalSums) -> NormalSums:
        """Return the sums without the rows of another one."""
        return NormalSums(self.H - other.H, self.g - other.g, self.square - other.square, self.count - other.count)

    def moved(self, x: Array) -> NormalSums:
        """Return the sums with y + A x in place of the residual y; x : shape (p,)."""
        return NormalSums(self.H, self.g + self.H @ x, self.square + 2 * x @ self.g + x @ self.H @ x, self.count)


def normal_sums(y: Array, A: Array) -> NormalSums:
    """Return the normal sums of whitened rows.

    y : whitened residual, shape (n, m) or (rows,)
    A : whitened columns, shape (n, m, p) or (rows, p)
    """
    rows, residual = A.reshape(-1, A.shape[-1]), y.ravel()
    return NormalSums(rows.T @ rows, rows.T @ residual, float(residual @ residual), len(residual))


@dataclass(frozen=True, eq=False)
class Joined:
    """Parameters added to a model at one noise level, by a Schur complement.

    L : Cholesky factor of their normal matrix given the parameters before, scaled to unit diagonal,
        shape (new, new)
    scale : factor of each row and column that scales the normal matrix so, shape (new,)
    z : their estimate in the orthonormal axes of `root`, shape (new,)
    square : squared norm of the whitened residual with them in the model
    log_norm : term of the log likelihood that does not depend on sigma
    """

    L: Array
    scale: Array
    z: Array
    square: float
    log_norm: float

    @cached_property
    def root(self) -> Array:
        """Return a root R of the inverse R'R of their normal matrix, shape (new, new)."""
        return np.asarray(inverse_of_triangle(self.L) * self.scale)

    @property
    def estimate(self) -> Array:
        """Return the estimate of the parameters if no others are added to the model, (new,)."""
        from scipy.linalg import solve_triangular

        return np.asarray(solve_triangular(self.L.T, self.z) * self.scale)


def joined(normal: Array, right: Array, square: float, log_norm: float) -> Joined:
    """Return the update of a model by additional parameters.

    normal : their normal matrix given the parameters in the model, priors included, shape (new,
        new)
    right : products of their columns with the whitened residual of the model before, shape (new,)
    square, log_norm : those of the model before, see `Joined`
    Raises numpy.linalg.LinAlgError where the matrix is not positive definite, beyond round-off.
    """
    from scipy.linalg import solve_triangular

    L, scale = _factor(normal)
    z = solve_triangular(L, scale * right, lower=True)
    return Joined(L, scale, z, square - float(z @ z), log_norm - float((np.log(np.diag(L)) - np.log(scale)).sum()))


def joined_base(gram: Array, weights: Array, mean: Array, log_det: float) -> Joined:
    """Return the update of a model without parameters by P base parameters.

    gram : of their whitened columns and, last, the residual, shape (P + 1, P + 1)
    weights, mean : inverse prior standard deviations and prior means, for sigma = 1, shape (P,)
    log_det : log determinant of the noise covariance
    """
    own = weights**2
    square = float(gram[-1, -1] + (weights * mean) @ (weights * mean))
    return joined(np.diag(own) + gram[:-1, :-1], gram[:-1, -1] + own * mean, square, -0.5 * float(log_det))


def marginalised(H: Array, g: Array, selected: Array, inverse: Array) -> tuple[Array, Array]:
    """Return information, (k, k), and score, (k,), of k parameters with the others marginalised.

    H, g : information and score of all parameters, shapes (p, p), (p,)
    selected : indices of the k parameters
    inverse : inverse of the sum of the others' part of H and their prior precision, shape (p - k,
        p - k), in the order of their indices
    """
    others = np.delete(np.arange(len(g)), selected)
    own = inverse @ H[np.ix_(others, selected)]
    return H[np.ix_(selected, selected)] - H[np.ix_(selected, others)] @ own, g[selected] - own.T @ g[others]


def inverse_of_triangle(L: Array) -> Array:
    """Return the inverse of a lower triangular matrix, shape (p, p)."""
    if len(L) <= MAX_NUMPY_ROWS:
        return np.asarray(np.linalg.inv(L))
    from scipy.linalg.lapack import dtrtri

    return np.asarray(dtrtri(L, lower=1)[0])


def root_of_inverse(normal: Array) -> Array:
    """Return a root R of the inverse R'R of a normal matrix, shape (p, p).

    Raises numpy.linalg.LinAlgError where the matrix is not positive definite, beyond round-off.
    """
    L, scale = _factor(normal)
    return np.asarray(inverse_of_triangle(L) * scale)


def inverse_of(normal: Array) -> Array:
    """Return the inverse of a normal matrix, shape (p, p), symmetric to the last bit.

    Raises numpy.linalg.LinAlgError where the matrix is not positive definite; of a singular one see
    `scaled_inverse`.
    """
    from scipy.linalg.lapack import dpotri

    L, scale = _factor(normal)
    lower = np.tril(dpotri(L, lower=1)[0])
    return np.asarray((lower + np.tril(lower, -1).T) * np.outer(scale, scale))


def scaled_solution(H: Array, g: Array) -> Array:
    """Return H^-1 g, shape (k,), of a positive semidefinite matrix H, shape (k, k), via unit diagonal.

    It is as by `scaled_inverse`, with a third of its operations where H is far from singular.
    """
    root = np.sqrt(np.maximum(np.diag(H), 1e-200))
    scaled = np.outer(root, root)
    with suppress(np.linalg.LinAlgError):
        L = np.linalg.cholesky(np.divide(H, scaled, out=scaled))
        if np.diag(L).min(initial=1.0) > 1e-4:
            if len(L) <= MAX_NUMPY_ROWS:
                half = inverse_of_triangle(L)
                return np.asarray(half.T @ (half @ (g / root)) / root)
            from scipy.linalg import cho_solve

            return np.asarray(cho_solve((L, True), g / root, check_finite=False) / root)
    return np.asarray(scaled_inverse(H) @ g)


def scaled_inverse(H: Array) -> Array:
    """Return the inverse of a positive semidefinite matrix H, shape (k, k), via unit diagonal.

    The result is in the units of H^-1. Directions with eigenvalues at round-off get a very large
    variance, not an infinite one.
    """
    root = np.sqrt(np.maximum(np.diag(H), 1e-200))
    scaled = H / np.outer(root, root)
    with suppress(np.linalg.LinAlgError):
        L = inverse_of_triangle(np.linalg.cholesky(scaled))
        inverse = np.asarray(L.T @ L)
        # Cholesky factors are faster, and accurate where no scaled variance is near round-off.
        if np.diag(inverse).max(initial=0.0) < 1e8:
            return np.asarray(inverse / np.outer(root, root))
    eigenvalues, V = np.linalg.eigh(scaled)
    return np.asarray((V / np.maximum(eigenvalues, 1e-15)) @ V.T / np.outer(root, root))


def _factor(normal: Array) -> tuple[Array, Array]:
    """Return the Cholesky factor of a normal matrix scaled to unit diagonal, and the scale, (p,).

    Scaled so, its rank does not depend on the units of the parameters. It is regularised if
    necessary.
    Raises numpy.linalg.LinAlgError where it is not positive definite, beyond round-off.
    """
    scale = 1 / np.sqrt(np.diag(normal))
    unit = normal * np.outer(scale, scale)
    try:
        return np.linalg.cholesky(unit), scale
    except np.linalg.LinAlgError:
        # Round-off may take this much from a matrix of unit diagonal; it is added to its diagonal.
        return np.linalg.cholesky(unit + 1e-10 * np.eye(len(unit))), scale

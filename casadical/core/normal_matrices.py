"""Roots of normal matrices, without a library of triangular solvers: numpy has none."""

import numpy as np

from casadical.core.arrays import Array

# Up to so many rows a triangle is inverted in one go.
SMALL = 48
# What round-off may take from a matrix of unit diagonal: where it is not positive definite, so much is added.
ROUND_OFF = 1e-10


def inverse_of_triangle(L: Array) -> Array:
    """Inverse of a lower triangle, shape (p, p), by halves: a few times faster than that of a full matrix."""
    if len(L) <= SMALL:
        return np.linalg.inv(L)
    half = len(L) // 2
    inverse = np.zeros_like(L)
    inverse[:half, :half] = first = inverse_of_triangle(L[:half, :half])
    inverse[half:, half:] = last = inverse_of_triangle(L[half:, half:])
    inverse[half:, :half] = -last @ (L[half:, :half] @ first)
    return inverse


def reduced(normal: Array, right: Array) -> tuple[Array, Array]:
    """Cholesky factor L of a normal matrix, shape (p, p), and the solution z of L z = right, in one factorisation.

    normal : of unit diagonal. Raises numpy.linalg.LinAlgError where it is not positive definite, beyond round-off.
    """
    p = len(right)
    whole = np.empty((p + 1, p + 1))
    whole[:p, :p], whole[p, :p], whole[:p, p] = normal, right, right
    # What the last row leaves of it is not used; it has to be positive.
    whole[p, p] = np.finfo(float).max ** 0.25
    L = _factor(whole)
    return L[:p, :p], L[p, :p]


def root_of_inverse(normal: Array) -> Array:
    """A root R of the inverse R' R of a normal matrix, shape (p, p).

    A parameter whose column is long is scaled first, so that rank is judged fairly.
    Raises numpy.linalg.LinAlgError where the matrix is not positive definite, beyond round-off.
    """
    scale = 1 / np.sqrt(np.diag(normal))
    return np.asarray(inverse_of_triangle(_factor(normal * np.outer(scale, scale))) * scale)


def _factor(normal: Array) -> Array:
    """Cholesky factor of a matrix of unit diagonal, shape (p, p)."""
    try:
        return np.linalg.cholesky(normal)
    except np.linalg.LinAlgError:
        return np.linalg.cholesky(normal + ROUND_OFF * np.eye(len(normal)))

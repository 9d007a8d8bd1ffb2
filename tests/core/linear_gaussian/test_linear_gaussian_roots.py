"""Roots of normal matrices against numpy's full inverses."""

import numpy as np
import pytest

from casadical.core.linear_gaussian.normal_equations import SMALL, inverse_of_triangle, reduced, root_of_inverse


@pytest.mark.parametrize("size", [1, 5, SMALL, SMALL + 1, 3 * SMALL + 7])
def test_a_triangle_is_inverted(size: int) -> None:
    A = np.random.default_rng(size).standard_normal((2 * size, size))
    L = np.linalg.cholesky(A.T @ A + np.eye(size))
    found = inverse_of_triangle(L)
    assert found @ L == pytest.approx(np.eye(size), abs=1e-10)
    assert np.all(found == np.tril(found))


def test_a_right_hand_side_is_reduced_with_the_factorisation() -> None:
    rng = np.random.default_rng(0)
    A, right = rng.standard_normal((40, 9)), 1e6 * rng.standard_normal(9)
    L, z = reduced(A.T @ A, right)
    assert pytest.approx(A.T @ A) == L @ L.T
    assert L @ z == pytest.approx(right)


def test_a_root_of_the_inverse_holds_for_columns_of_very_unlike_length() -> None:
    A = np.random.default_rng(1).standard_normal((300, 120)) * np.geomspace(1e-9, 1e9, 120)
    normal = A.T @ A
    root = root_of_inverse(normal)
    assert root @ normal @ root.T == pytest.approx(np.eye(120), abs=1e-8)


def test_what_is_not_positive_definite_is_refused() -> None:
    for of in (root_of_inverse, lambda m: reduced(m, np.ones(2))):
        with pytest.raises(np.linalg.LinAlgError):
            of(np.array([[1.0, 2.0], [2.0, 1.0]]))


def test_what_round_off_takes_from_a_normal_matrix_stops_nothing() -> None:
    """Two columns alike to the last digits: the scaled matrix is singular, and may be below zero by round-off."""
    J = np.random.default_rng(0).normal(size=(40, 30)) * 10.0 ** np.linspace(-6, 6, 30)
    J[:, 1] = J[:, 0] * 3
    normal = J.T @ J
    normal[0, 1] = normal[1, 0] = np.sqrt(normal[0, 0] * normal[1, 1]) * (1 + 1e-14)
    root = root_of_inverse(normal)
    right = J.T @ (J @ np.ones(30))
    np.testing.assert_allclose(J @ (root.T @ (root @ right)), J @ np.ones(30), rtol=1e-5, atol=1e-3)

"""The same numbers by every path: chunked and whole maps, compiled and interpreted kernels."""

from dataclasses import replace
from functools import partial

import arms
import casadi as ca
import numpy as np
import pytest

from casadical.core.mapped_function import (
    COMPILATION_POINTS,
    LIBRARY_LOOKUP_POINTS,
    MAX_CHUNK_POINTS,
    MappedFunction,
    compiler,
)
from casadical.identification.least_squares import LeastSquares
from casadical.identification.residuals import LOSS_KNEE_SQUARE, make_block

ARM = arms.six_axis()
NAMES = ("base_x", "a1", "alpha2", "theta3", "d4", "tool_x")


def problem(n, loss="soft_l1"):
    built = arms.planted(ARM, 1)
    m = replace(arms.positions(built, arms.readings(built, n, 2), 3), weight=np.linspace(0.5, 1.5, n))
    return LeastSquares(ARM, (m,), NAMES, loss, False, ((1e-4, 1e-4),))


def sums(least_squares, v):
    return [least_squares.cost(v), *least_squares.gradient(v)]


@pytest.mark.parametrize(
    "n",
    [1, MAX_CHUNK_POINTS - 1, MAX_CHUNK_POINTS, MAX_CHUNK_POINTS + 1, 2 * MAX_CHUNK_POINTS, 2 * MAX_CHUNK_POINTS + 1],
)
def test_chunks_sum_to_the_whole(n):
    """Against the sum of residuals computed pose by pose, which knows no chunks."""
    least_squares = problem(n)
    v = np.random.default_rng(0).normal(size=len(NAMES))
    cost, gradient, hessian = sums(least_squares, v)
    found = [one_pose(least_squares, k, v) for k in range(n)]
    r, J = (np.array(both) for both in zip(*found, strict=True))
    knee = LOSS_KNEE_SQUARE[3]
    root = np.sqrt(1 + np.sum(r**2, axis=1) / knee)
    assert cost == pytest.approx(np.sum(knee * (root - 1)), rel=1e-12)
    assert np.allclose(
        gradient, np.einsum("n,nm,nmz->z", 1 / root, r, J), rtol=1e-10, atol=1e-10 * np.abs(gradient).max()
    )
    assert np.allclose(
        hessian, np.einsum("n,nmy,nmz->yz", 1 / root, J, J), rtol=1e-10, atol=1e-10 * np.abs(hessian).max()
    )


def one_pose(least_squares, k, v):
    """Residual and Jacobian of one pose, by the kernel itself."""
    (block,) = least_squares.blocks
    r, J = block.kernel.residual(block.data(slice(k, k + 1)), np.concatenate([v, block.robot]))
    return r.squeeze(), J.T


@pytest.fixture
def with_compiler(monkeypatch, tmp_path):
    if compiler() is None:
        pytest.skip("no C compiler here: neither $CC nor gcc, clang or cc is on the PATH")
    monkeypatch.setenv("CASADICAL_CACHE", str(tmp_path))
    return tmp_path / "casadical"


def test_machine_code_takes_over_where_it_pays(with_compiler):
    """Looked for after some points, made after more; the bits stay the same."""
    x, a = ca.SX.sym("x", 2), ca.SX.sym("a", 2)
    made = partial(MappedFunction, "wave", x, a, [ca.sin(a[0]) * ca.cos(x) + a[1]])
    f, states, shared = made(), [], np.array([0.3, 1.2])
    points = np.random.default_rng(0).normal(size=(2, COMPILATION_POINTS // 2))
    for n in (LIBRARY_LOOKUP_POINTS, COMPILATION_POINTS // 2, COMPILATION_POINTS // 2, 9):
        (found,) = f(points[:, :n], shared)
        states.append((f.is_compiled, len(list(with_compiler.iterdir()))))
        assert np.array_equal(found[:, :9], f(points[:, :9], shared)[0])
    assert states == [(False, 0), (False, 0), (True, 1), (True, 1)]
    assert np.allclose(found, np.sin(0.3) * np.cos(points[:, :9]) + 1.2, rtol=1e-14)
    another = made()
    another(points[:, :LIBRARY_LOOKUP_POINTS], shared)
    assert another.is_compiled  # it is there already


def test_inputs_that_are_not_kept_give_the_same_residuals() -> None:
    m, none, x = problem(7).sets[0], np.zeros((0, 3)), np.random.default_rng(0).normal(size=len(NAMES))
    made, kept = (make_block(ARM, m, NAMES, 1e-4, 1e-4, none, np.zeros(7, int), max_cached=n) for n in (0, 100))
    for one, other in zip(made.evaluate(x, none), kept.evaluate(x, none), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal([*made.residuals(x, none)], [*kept.residuals(x, none)])

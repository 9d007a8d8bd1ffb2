"""The same numbers by every path: chunked and whole maps, compiled and interpreted kernels."""

from dataclasses import replace

import arms
import casadi as ca
import numpy as np
import pytest

from casadical import identify
from casadical.core import compile_cache as compiled
from casadical.identification import residuals
from casadical.identification.least_squares import LeastSquares

ARM = arms.six_axis()
NAMES = ("base_x", "a1", "alpha2", "theta3", "d4", "tool_x")


def problem(n, loss="soft_l1"):
    built = arms.planted(ARM, 1)
    m = replace(arms.positions(built, arms.readings(built, n, 2), 3), weight=np.linspace(0.5, 1.5, n))
    return LeastSquares(ARM, (m,), NAMES, loss, False, ((1e-4, 1e-4),))


def sums(least_squares, v):
    x, u = ca.MX(ca.DM(v)), ca.MX(3, 0)
    parts = [ca.MX(0), ca.MX(0), ca.MX(0)]
    for block in least_squares.blocks:
        again, gradient = block.gradient(x, u)
        assert float(ca.evalf(again)) == pytest.approx(float(ca.evalf(block.cost(x, u))), rel=1e-12)
        parts = [a + b for a, b in zip(parts, (block.cost(x, u), gradient, block.hessian(x, u)), strict=True)]
    return [ca.evalf(p).full() for p in parts]


@pytest.mark.parametrize("n", [1, 511, 512, 513, 1024, 1025])
def test_chunks_sum_to_the_whole(n):
    """Against the sum of residuals computed pose by pose, which knows no chunks."""
    least_squares = problem(n)
    v = np.random.default_rng(0).normal(size=len(NAMES))
    cost, gradient, hessian = sums(least_squares, v)
    g, H = least_squares.gradient(v)
    assert np.allclose(gradient.ravel(), g, rtol=1e-10)
    assert np.allclose(hessian, np.triu(H), rtol=1e-10, atol=1e-10 * np.abs(H).max())
    r = least_squares.evaluate(v)[0][0]
    knee = residuals._KNEE[3]
    expected = np.sum(knee * (np.sqrt(1 + np.sum(r**2, axis=1) / knee) - 1))
    assert cost.item() == pytest.approx(expected, rel=1e-12)


def test_chunk_length_does_not_matter(monkeypatch):
    v = np.random.default_rng(0).normal(size=len(NAMES))
    whole = sums(problem(700), v)
    for length in (64, 700, 1000):
        monkeypatch.setattr(residuals, "CHUNK", length)
        for a, b in zip(sums(problem(700), v), whole, strict=True):
            assert np.allclose(a, b, rtol=1e-11)


@pytest.fixture
def with_compiler(monkeypatch, tmp_path):
    if compiled.compiler() is None:
        pytest.skip("no C compiler here: neither $CC nor gcc, clang or cc is on the PATH")
    monkeypatch.setenv("CASADICAL_CACHE", str(tmp_path))
    return tmp_path


def test_compiled_kernels_give_the_same_result(with_compiler, monkeypatch):
    built = arms.planted(ARM, 1, arms.TRACKER)
    m = arms.positions(built, arms.readings(built, 60, 2), 3)
    interpreted = identify(ARM, m, ["placement", "a2"])
    assert not list(with_compiler.iterdir())
    monkeypatch.setattr(residuals, "COMPILE_FROM", 1)
    machine = identify(ARM, m, ["placement", "a2"])
    made = sorted(f.name.split("-")[0] for f in with_compiler.iterdir())
    assert made == ["cost", "gradient", "hessian", "residual"]
    assert machine.names == interpreted.names
    assert np.allclose(machine.solution.v, interpreted.solution.v, rtol=0, atol=1e-6)
    assert np.allclose(machine.covariance, interpreted.covariance, rtol=1e-6)


def test_a_library_is_made_once(with_compiler):
    x = ca.SX.sym("x", 2)
    f = ca.Function("twice", [x], [2 * ca.sin(x)])
    first = compiled.compiled(f)
    (library,) = with_compiler.iterdir()
    made = library.stat().st_mtime_ns
    again = compiled.compiled(f)
    assert library.stat().st_mtime_ns == made
    assert np.array_equal(first([0.3, 1.2]).full(), again([0.3, 1.2]).full())
    assert np.allclose(first([0.3, 1.2]).full().ravel(), 2 * np.sin([0.3, 1.2]))
    other = compiled.compiled(ca.Function("twice", [x], [3 * ca.sin(x)]))
    assert len(list(with_compiler.iterdir())) == 2
    assert float(other([0.3, 1.2])[0]) == pytest.approx(3 * np.sin(0.3))


def test_without_a_compiler_the_function_itself_is_used(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CC", "no-such-compiler")
    f = ca.Function("f", [ca.SX.sym("x")], [ca.SX(1)])
    assert compiled.compiler() is None
    assert compiled.compiled(f) is f


def test_a_compiler_that_fails_leaves_nothing_behind(monkeypatch, tmp_path):
    broken = tmp_path / "bin" / "gcc"
    broken.parent.mkdir()
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    cache = tmp_path / "cache"
    monkeypatch.setenv("CC", str(broken))
    monkeypatch.setenv("CASADICAL_CACHE", str(cache))
    f = ca.Function("f", [ca.SX.sym("x")], [ca.SX(1)])
    assert compiled.compiled(f) is f
    assert list(cache.iterdir()) == []

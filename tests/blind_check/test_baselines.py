"""The methods that the diagnosis is measured against do what textbooks say."""

from types import SimpleNamespace

import numpy as np
import pytest

from casadical.blind_check.baselines import Regression, _by_bic, _left


def test_gains_are_those_of_least_squares() -> None:
    rng = np.random.default_rng(0)
    A, E, y = rng.normal(size=(60, 4)), rng.normal(size=(60, 7)), rng.normal(size=60)
    A = np.column_stack([A, A[:, 0]])  # a column twice: rank 4
    E[:, 6] = E[:, 5]
    left, columns, rank = _left(A, y, E)
    assert rank == 4
    found = Regression(left, columns, 60 - rank)

    def squares(X: np.ndarray) -> float:
        return float(np.sum((y - X @ np.linalg.lstsq(X, y)[0]) ** 2))

    groups = [np.array([0]), np.array([1, 2]), np.array([5, 6])]
    expected = [squares(A) - squares(np.column_stack([A, E[:, g]])) for g in groups]
    assert found.gains(groups) == pytest.approx(expected)
    more = found.without(groups[1])
    assert more.freedom == 54
    both = squares(np.column_stack([A, E[:, [1, 2]]])) - squares(np.column_stack([A, E[:, [0, 1, 2]]]))
    assert more.gains(groups[:1]) == pytest.approx([both])


def test_among_many_candidates_the_extended_criterion_takes_what_is_there_and_no_noise() -> None:
    rng, many = np.random.default_rng(4), 400
    case = SimpleNamespace(
        groups=[np.array([k]) for k in range(many)],
        variants=[(k, 0) for k in range(many)],
        candidates=[SimpleNamespace(label=f"c{k}") for k in range(many)],
    )
    dearer, taken = 2 * np.log(many), {"bic": 0, "ebic": 0}
    for _ in range(20):
        E, noise = rng.normal(size=(100, many)), rng.normal(size=100)
        for name, cost in (("bic", 0.0), ("ebic", dearer)):
            taken[name] += _by_bic(Regression(noise, E, 100), case, cost).take is not None
            found = _by_bic(Regression(noise + 2 * E[:, 7], E, 100), case, cost)
            assert found.take is not None
            assert found.take[0].label == "c7"
            assert found.probability["c7"] > 0.99
    assert taken["bic"] >= 15
    assert taken["ebic"] <= 1


def test_a_gaussian_process_learns_what_is_smooth() -> None:
    pytest.importorskip("sklearn", reason="scikit-learn is not installed")
    from casadical.blind_check.gaussian_process import _fitted

    rng = np.random.default_rng(1)
    X = rng.uniform(-2, 2, (120, 2))
    y = np.column_stack([np.sin(X[:, 0]), np.zeros(120), np.cos(X[:, 1])]) + 0.01 * rng.normal(size=(120, 3))
    process = _fitted(X[:80], y[:80])
    assert np.abs(process.predict(X[80:]) - y[80:]).mean() < 0.05


def test_the_marginal_likelihood_is_scikit_learns() -> None:
    pytest.importorskip("sklearn", reason="scikit-learn is not installed")
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    from casadical.blind_check.gaussian_process import loss

    rng = np.random.default_rng(2)
    X, y = rng.normal(size=(40, 3)), rng.normal(size=(40, 3))
    kernel = ConstantKernel(0.7) * RBF([0.5, 2.0, 9.0]) + WhiteKernel(0.2)
    process = GaussianProcessRegressor(kernel, optimizer=None).fit(X, y)
    theta = process.kernel_.theta
    value, gradient = process.log_marginal_likelihood(theta, eval_gradient=True)
    own, slope = loss(theta, X, y)
    assert own == pytest.approx(-value, rel=1e-9)
    assert slope == pytest.approx(-gradient, rel=1e-6)

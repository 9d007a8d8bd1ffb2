"""Batches of nonlinear least-squares problems against scipy, one by one."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from casadical.core.levenberg_marquardt import Evaluated, levenberg_marquardt

T = np.linspace(0, 3, 30)


@pytest.mark.parametrize("factors", [None, (5, 8)])
def test_the_optima_of_many_problems_are_scipys(factors: tuple[float, float] | None) -> None:
    """Decays a exp(-b t) with noise, starts far off; the last problem stands at its optimum."""
    rng = np.random.default_rng(0)
    true = np.column_stack([rng.uniform(0.5, 3, 6), rng.uniform(0.2, 4, 6)])
    y = true[:, :1] * np.exp(-true[:, 1:] * T) + 0.01 * rng.normal(size=(6, 30))
    exact = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
    expected = [least_squares(lambda x, own=own: own - x[0] * np.exp(-x[1] * T), [1.0, 1.0], **exact) for own in y]

    def evaluate(x: np.ndarray) -> Evaluated:
        decay = np.exp(-x[:, 1:] * T)
        left = y - x[:, :1] * decay

        def sums(chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            J = np.stack([decay, -x[:, :1] * T * decay], axis=2)[chosen]
            return J.transpose(0, 2, 1) @ J, (J.transpose(0, 2, 1) @ left[chosen][..., None])[..., 0]

        return (left**2).sum(axis=1), sums

    start = np.concatenate([np.ones((5, 2)), [expected[-1].x]])
    *_, end = levenberg_marquardt(evaluate, start, 60, relative=1e-14, factors=factors)
    assert end.point == pytest.approx(np.array([e.x for e in expected]), abs=1e-6)
    assert end.cost == pytest.approx([2 * e.cost for e in expected], rel=1e-9)
    assert not end.active.any()
    states = list(levenberg_marquardt(evaluate, start, 3))
    assert len(states) == 3
    assert (states[-1].cost >= end.cost - 1e-12).all()
    assert states[-1].point.shape == (6, 2)

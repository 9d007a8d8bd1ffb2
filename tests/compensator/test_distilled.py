"""The Gaussian process against finite differences and direct formulas, and the network that it teaches."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.stats import multivariate_normal

from casadical.compensator import Compensator, Layout, LevenbergMarquardt, Taught
from casadical.compensator.trainers.distilled import GaussianProcess, cost_and_slope
from casadical.core.basics import InputError


def one_joint(poses: int, seed: int):
    """A residual that hangs on two of six joints only, quickly, with noise: hard for one ridge on all weights."""
    random = np.random.default_rng(seed)
    q = random.uniform(-2, 2, (poses, 6))
    smooth = np.column_stack([np.sin(2 * q[:, 0]), np.cos(2 * q[:, 0]), np.sin(q[:, 1])])
    return q, 0.3 * smooth + random.normal(0, 0.1, smooth.shape)


def test_cost_is_the_likelihood_and_slope_its_gradient() -> None:
    random = np.random.default_rng(0)
    x, y = random.normal(size=(12, 2)), random.normal(size=(12, 3))
    logs = np.log([0.8, 2.0, 1.3, 0.4])
    cost, slope = cost_and_slope(logs, x, y)
    K = 1.3**2 * np.exp(-0.5 * (((x[:, None] - x) / [0.8, 2.0]) ** 2).sum(-1)) + 0.4**2 * np.eye(12)
    direct = -sum(multivariate_normal(cov=K).logpdf(column) for column in y.T)
    assert cost + 0.5 * 36 * np.log(2 * np.pi) == pytest.approx(direct, rel=1e-9)
    numeric = approx_fprime(logs, lambda v: cost_and_slope(v, x, y)[0], 1e-6)
    assert slope == pytest.approx(numeric, rel=1e-3, abs=1e-3)


def test_the_process_finds_which_joints_matter() -> None:
    q, y = one_joint(60, 1)
    process = GaussianProcess.fit(q / 2, y)
    assert process.lengths[2:].min() > 3 * process.lengths[:2].max()
    assert 0.07 < process.noise < 0.14
    other, truth = one_joint(500, 2)
    assert np.std(truth - process.mean(other / 2)) < 1.3 * 0.1  # the noise itself is 0.1


def sign_steps(start: np.ndarray, x: np.ndarray, y: np.ndarray, steps: int) -> tuple[float, list[float]]:
    """The least cost on the path of Rprop, a coordinate at a time (Riedmiller and Braun 1993), and where it is."""
    at, step, before = [*start], [0.2] * len(start), [0.0] * len(start)
    best = (np.inf, at)
    for _ in range(steps):
        cost, slope = cost_and_slope(np.array(at), x, y)
        best = min(best, (cost, [*at]))
        for k, s in enumerate(np.sign(slope)):
            turned = s * before[k]
            step[k] = min(1.2 * step[k], 0.5) if turned > 0 else 0.5 * step[k] if turned < 0 else step[k]
            before[k] = 0.0 if turned < 0 else s
            at[k] -= step[k] * before[k]
    return best


@pytest.mark.parametrize("seed", range(3))
def test_the_process_is_the_likelier_end_of_sign_steps_from_two_starts(seed: int) -> None:
    q, y = one_joint(30, seed)
    rms = np.log(np.sqrt(np.mean(y**2)))
    ends = [sign_steps(np.r_[np.full(6, np.log(s)), rms, rms - 1], q / 2, y, 12) for s in (1.0, 3.0)]
    process = GaussianProcess.fit(q / 2, y, steps=12)
    np.testing.assert_allclose(np.log([*process.lengths, process.size, process.noise]), min(ends)[1], atol=1e-9)


@pytest.mark.slow
def test_on_few_poses_the_taught_network_beats_the_ridge() -> None:
    held_out = one_joint(500, 99)
    gains = {}
    for trainer in (Taught(), LevenbergMarquardt()):
        fits = [Compensator.fit(*one_joint(50, s), choose=held_out, trainer=trainer, seed=s) for s in range(3)]
        gains[trainer.name] = [fit.choice.gain for fit in fits]
    assert all(fit > 0.3 for fit in gains["taught"])
    assert np.median(gains["taught"]) > np.median(gains["lm"]) + 0.05


def test_what_it_cannot_do_it_refuses() -> None:
    q, y = one_joint(20, 0)
    with pytest.raises(InputError, match="no periodic inputs"):
        Compensator.fit(q, y, trainer="taught", layout=Layout(periodic=(0,)))
    assert Taught(lessons=10).lessons == 10
    for few in (3, 9):
        with pytest.raises(InputError, match=f"lessons must be at least 10 poses; got {few}"):
            Taught(lessons=few)

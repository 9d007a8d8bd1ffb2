"""A smooth synthetic residual for the tests."""

import numpy as np

from casadical.compensator import JointBox, Layout, make_task
from casadical.compensator.network import Task


def smooth(poses: int, seed: int, noise_mm: float = 0.01):
    """Joint angles and a residual that is smooth in them, 0.25 mm rms, with noise."""
    truth = np.random.default_rng(99)
    mix, rates, phase = truth.normal(size=(3, 3)), truth.normal(0, 0.4, (6, 3)), truth.uniform(0, 6, 3)
    random = np.random.default_rng(seed)
    q = random.uniform(-2, 2, (poses, 6))
    residual = np.sin(q @ rates + phase) @ mix.T
    return q, 0.1 * residual + random.normal(0, noise_mm, residual.shape)


def small_task(hidden=(3,), poses: int = 24, seed: int = 0, scale_mm: float = 0.2) -> Task:
    q, residual = smooth(poses, seed)
    return make_task(Layout(hidden=hidden), JointBox((-2,) * 6, (2,) * 6), q, residual, scale_mm=scale_mm)

"""Disturbances drawn by chance: the same for the same seed, of about their usual size, and clear refusals."""

from dataclasses import fields

import numpy as np
import pytest
from numpy_physics import disturbances, draw_disturbance

from casadical.core.errors import InputError

ALL = disturbances.LISTED | disturbances.UNLISTED


def drawn(effect: str, seed: int, scale: float = 1.0) -> disturbances.Disturbance:
    joint = 5 if "joint" in {f.name for f in fields(ALL[effect])} else None
    return draw_disturbance(effect, seed, joint=joint, scale=scale)


@pytest.mark.parametrize("effect", ALL)
def test_drawn_by_seed(effect: str) -> None:
    assert isinstance(drawn(effect, 1), ALL[effect])
    assert drawn(effect, 1) == drawn(effect, 1)
    assert len({drawn(effect, s) for s in range(5)}) == 5


def test_sizes_and_signs() -> None:
    ripples = np.array([drawn("transmission_ripple", s, scale=2.0).size for s in range(200)]) / 20e-6  # type: ignore[attr-defined]
    assert 1.4 <= ripples.min() < 1.5
    assert 2.9 < ripples.max() <= 3.0
    scales = np.array([drawn("joint_scale", s).size for s in range(50)])  # type: ignore[attr-defined]
    assert (scales > 0).any()
    assert (scales < 0).any()
    shifts = [np.linalg.norm(drawn("target_shift", s).shift_m) for s in range(50)]  # type: ignore[attr-defined]
    assert 34e-6 < min(shifts) < max(shifts) < 75e-6


@pytest.mark.parametrize(
    ("effect", "joint", "message"),
    [
        ("gremlins", None, "effect 'gremlins' is unknown; there are gear_eccentricity"),
        ("backlash", None, "needs a joint from 1 to 6, not None"),
        ("backlash", 7, "needs a joint from 1 to 6, not 7"),
        ("joint_coupling", 1, "needs a joint from 2 to 6, not 1"),
        ("frame_drift", 2, "sits in no joint"),
    ],
)
def test_refusals(effect: str, joint: int | None, message: str) -> None:
    with pytest.raises(InputError, match=message):
        draw_disturbance(effect, 1, joint=joint)

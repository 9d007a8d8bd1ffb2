"""Rare disturbances: nothing at size zero, a shift in proportion to their size, and what some of them claim."""

from dataclasses import replace

import numpy as np
import pytest
from numpy_physics import HH800
from numpy_physics.disturbance import Disturbance
from numpy_physics.disturbances_rare import RARE, SlippedMark, WormSlack, draw_rare
from numpy_physics.statics import positions

from casadical.blind_check.mujoco_physics import Plant, perturb
from casadical.blind_check.mujoco_physics.rigid import Array
from casadical.blind_check.mujoco_physics.stops import Stops, Warmup, draw_poses, draw_stops

PLANT = perturb(Plant.from_dict({k: v for k, v in HH800.items() if k != "four_bar"}), 3)


def stops(n: int = 60) -> Stops:
    q = draw_poses(PLANT, n, np.random.default_rng(1), PLANT.ranges, (0.0, 9.0))
    return draw_stops(q, np.random.SeedSequence(1).spawn(2), [0.0, PLANT.payload_kg], Warmup())


def seen(d: Disturbance) -> Array:
    """What the instrument sees of a disturbance, shape (n, 3) [m]."""
    at = stops()
    clean = positions(PLANT, (), at)
    return d.measured(positions(PLANT, (d,), at), at, np.random.default_rng(0)) - clean


@pytest.mark.parametrize("effect", RARE)
def test_a_rare_disturbance_grows_with_its_size(effect: str) -> None:
    d = draw_rare(effect, 5, PLANT)
    assert np.abs(seen(replace(d, size=0.0))).max() < 1e-9  # type: ignore[call-arg]
    one, half = seen(d), seen(replace(d, size=d.size / 2))  # type: ignore[attr-defined, call-arg]
    assert 2e-6 < np.linalg.norm(one, axis=1).max() < 2e-3
    np.testing.assert_allclose(half, one / 2, rtol=0, atol=0.05 * np.abs(one).max())


def test_a_slipped_mark_moves_the_poses_beyond_it_alone() -> None:
    d = SlippedMark(1, 1e-4, share=0.5)
    q = stops().q[:, 0]
    moved = np.linalg.norm(seen(d), axis=1) > 1e-8
    np.testing.assert_array_equal(moved, q > np.median(q))


def test_a_worm_does_not_give_way_to_small_loads() -> None:
    d = WormSlack(2, 1e-4, share=0.0)
    still = np.linalg.norm(seen(d), axis=1) < 1e-9
    assert 0 < still.mean() < 1

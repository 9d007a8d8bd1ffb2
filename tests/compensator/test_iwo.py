"""Invasive weed optimisation against a second, plain-loop derivation of eqs. 13-17 and known optima."""

import math

import numpy as np
import pytest

from casadical.compensator import InvasiveWeeds, IwoSettings, iwo_minimise
from casadical.compensator.iwo import seed_counts
from casadical.core.basics import InputError


def sphere(x):
    return ((x - 0.3) ** 2).sum(axis=1)


def reference(losses_of, dimension, s, seed):
    """Eqs. 13-17 member by member, as printed, with the random numbers drawn in one order: parent by parent."""
    random = np.random.default_rng(seed)
    colony = [(float(losses_of(x[None])[0]), x) for x in random.uniform(s.lower, s.upper, (s.initial, dimension))]
    colony.sort(key=lambda member: member[0])
    for iteration in range(s.iterations):
        sigma = (s.iterations - iteration) ** s.exponent / s.iterations**s.exponent
        sigma = sigma * (s.sigma_initial - s.sigma_final) + s.sigma_final
        low, high = colony[0][0], colony[-1][0]
        children = []
        for loss, x in colony:
            ratio = (loss - high) / (low - high)
            for _ in range(math.floor(s.seeds_min + (s.seeds_max - s.seeds_min) * ratio)):
                k = random.standard_normal(dimension) if s.dispersal == "normal" else random.random(dimension)
                child = np.clip(x + sigma * k, s.lower, s.upper)
                children.append((float(losses_of(child[None])[0]), child))
        colony = sorted(colony + children, key=lambda member: member[0])[: s.maximum]
    return colony[0]


@pytest.mark.parametrize("dispersal", ["normal", "literal"])
@pytest.mark.parametrize("seed", [0, 1])
def test_equals_the_plain_loops(dispersal, seed):
    s = IwoSettings(iterations=40, dispersal=dispersal, seeds_min=1)
    result = iwo_minimise(sphere, 4, s, seed=seed)
    loss, x = reference(sphere, 4, s, seed)
    np.testing.assert_allclose(result.x, x, rtol=1e-9)
    assert result.loss == pytest.approx(loss, rel=1e-9)


def test_one_point_objective_gives_the_same_search():
    s = IwoSettings(iterations=20)
    batch = iwo_minimise(lambda x: np.abs(x).sum(axis=1), 2, s, seed=1)
    single = iwo_minimise(lambda x: np.abs(x).sum(), 2, s, seed=1, vectorised=False)
    assert batch.loss == single.loss


def test_seed_counts_by_hand():
    """Losses 1, 2, 5, S in 0..5: ratios 1, 3/4, 0, so 5, floor(3.75) and 0 children."""
    np.testing.assert_array_equal(seed_counts(np.array([2.0, 1.0, 5.0]), 0, 5), [3, 5, 0])


def test_equal_fitness_does_not_divide_by_zero():
    result = iwo_minimise(lambda x: np.zeros(len(x)), 2, IwoSettings(iterations=5), seed=0)
    assert result.loss == 0.0
    assert result.evaluations > 10


def test_nan_losses_lose():
    result = iwo_minimise(lambda x: np.where(x[:, 0] < 0, np.nan, sphere(x)), 2, IwoSettings(iterations=100), seed=0)
    assert np.isfinite(result.loss)
    assert result.x[0] >= 0


def test_bounds_hold_and_colony_is_capped():
    search = InvasiveWeeds(2, IwoSettings(lower=(-1.0, 0.0), upper=(1.0, 0.5), sigma_initial=3.0), seed=0)
    while not search.stop():
        points = search.ask()
        assert np.all((points >= [-1, 0]) & (points <= [1, 0.5]))
        search.tell(sphere(points))
    assert len(search.members) == 50


def test_history_and_parents_compete():
    result = iwo_minimise(sphere, 5, IwoSettings(iterations=50), seed=2)
    assert np.all(np.diff(result.history["best"]) <= 0)
    assert len(result.history["best"]) == 51
    assert result.history["evaluations"][-1] == result.evaluations
    assert result.history["sigma"][1] == 0.05
    assert result.history["best"][-1] == result.loss


@pytest.mark.parametrize(
    ("changes", "word"),
    [({"target": 0.01}, "target"), ({"patience": 3}, "patience"), ({"iterations": 7}, "iterations")],
)
def test_stop_reasons(changes, word):
    flat = (lambda x: np.ones(len(x))) if word == "patience" else sphere
    result = iwo_minimise(flat, 2, IwoSettings(**changes), seed=0)
    assert result.reasons[0].startswith(word)


def test_start_members_are_used():
    result = iwo_minimise(sphere, 2, IwoSettings(iterations=1), seed=0, start=[[0.3, 0.3]])
    assert result.loss == 0.0


def test_misuse_is_named():
    search = InvasiveWeeds(2)
    with pytest.raises(InputError, match="without ask"):
        search.tell([1.0])
    search.ask()
    with pytest.raises(InputError, match="10 points"):
        search.tell([1.0])
    with pytest.raises(InputError, match="nothing has been evaluated"):
        search.result()


@pytest.mark.parametrize(
    "changes",
    [{"initial": 0}, {"seeds_max": 0}, {"sigma_final": -1.0}, {"lower": 2.0}, {"dispersal": "x"}, {"iterations": 0}],
)
def test_wrong_settings_are_refused(changes):
    with pytest.raises(InputError):
        IwoSettings(**changes)

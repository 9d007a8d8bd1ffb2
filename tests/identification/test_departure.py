"""How far an arm departs from its drawing, and the prior that its poses choose for it."""

from dataclasses import replace

import arms
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from casadical import identify
from casadical.identification.identification import prepare
from casadical.identification.least_squares import LeastSquares
from casadical.identification.prior import PRIOR_PROBABILITY_OF_NONE, SIZE_GRID, Departure, departure_of

ARM = arms.six_axis()
NOISE = 1e-4


def built(size, seed):
    """The arm with all its geometry off by normal errors of so many mm and mrad, in front of a tracker."""
    rng = np.random.default_rng(seed)
    values = {p.name: p.value + size * 1e-3 * rng.normal() for p in ARM.parameters if p.group == "geometry"}
    robot = ARM.with_values(values)
    return replace(robot, base=replace(robot.base, T=arms.TRACKER))


def measured(robot, n, seed):
    return arms.positions(robot, arms.readings(robot, n, seed), seed, sigma=NOISE)


def held_out(found, robot):
    q = arms.readings(robot, 200, 99)
    return np.linalg.norm(found.predict(q)[0] - arms.points(robot, q), axis=1).mean()


@pytest.mark.parametrize("size", [0.0, 0.1, 0.3, 1.0])
def test_never_worse_than_frames_only_nor_than_the_free_fit(size):
    """Twenty poses of three simulated arms of each size; means of held-out errors without noise."""
    errors = []
    for seed in range(3):
        robot = built(size, seed)
        m = measured(robot, 20, seed + 10)
        fits = identify(ARM, m, ["placement"]), identify(ARM, m, ["kinematic"], priors=False), identify(ARM, m)
        errors.append([held_out(found, robot) for found in fits])
    frames, free, chosen = np.mean(errors, axis=0)
    assert chosen < 1.05 * min(frames, free)


def test_the_size_is_in_its_interval_and_said():
    found = [identify(ARM, measured(built(0.3, seed), 20, seed + 10)) for seed in range(5)]
    assert sum(f.departure.low <= 0.3 <= f.departure.high for f in found) >= 4
    assert all(f.departure.prior == pytest.approx(f.departure.size, rel=0.3) for f in found)
    assert "departs from nominal by 0.3" in Departure(0.3, 0.2, 0.5, 0.29).in_words()
    assert found[0].to_json()["departure"]["high"] == found[0].departure.high


def test_an_arm_as_drawn_is_said_to_be_so():
    departure = identify(ARM, measured(built(0.0, 1), 20, 11)).departure
    assert not departure.visible
    assert departure.high < 0.1
    assert "does not visibly depart" in departure.in_words()


def test_many_poses_leave_the_fit_free():
    robot = built(1.0, 3)
    m = measured(robot, 150, 4)
    found, free = identify(ARM, m), identify(ARM, m, priors=False)
    assert found.departure.prior is None
    np.testing.assert_array_equal(found.estimate, free.estimate)


def test_the_posterior_is_that_of_the_normal_distribution():
    """The likelihood of each size, with flat frames projected out, by dense covariances and another integration."""
    m = measured(built(0.1, 5), 14, 6)
    start = prepare(ARM, m).start
    found = identify(ARM, m, ["kinematic"], priors=False)
    problem = LeastSquares(start, (m,), found.names, "linear", False, ((1e-4, 1e-4),))
    v = problem.solve().v
    ours = departure_of(problem, v, 1.0, found.names)
    (r,), J = problem.evaluate(v)
    drawn = np.array([start.parameters[name].group == "geometry" for name in found.names])
    rest = np.linalg.svd(J[:, ~drawn])[0][:, (~drawn).sum() :]  # what moving base and tool leaves unchanged
    y, G = rest.T @ (J[:, drawn] @ v[drawn] - r.ravel()), rest.T @ J[:, drawn]
    sigmas = np.geomspace(0.2, 6.0, 150)
    logs = np.array(
        [
            [multivariate_normal.logpdf(y, cov=s**2 * np.eye(len(y)) + size**2 * G @ G.T) for s in sigmas]
            for size in SIZE_GRID[::4]
        ]
    )
    # Only every fourth size, for speed; the first one stands for none.
    weight = np.exp(logs - logs.max()).sum(axis=1)
    share = np.full(len(weight), (1 - PRIOR_PROBABILITY_OF_NONE) / (len(weight) - 1))
    share[0] = PRIOR_PROBABILITY_OF_NONE
    below = np.cumsum(weight * share) / np.sum(weight * share)
    low, size, high = (SIZE_GRID[::4][np.argmax(below > q)] for q in (0.025, 0.5, 0.975))
    step = (SIZE_GRID[5] / SIZE_GRID[1]) * 1.001
    for own, wanted in ((ours.low, low), (ours.size, size), (ours.high, high)):
        assert 1 / step <= own / wanted <= step

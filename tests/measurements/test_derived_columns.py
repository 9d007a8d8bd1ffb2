"""Columns that follow from logged ones."""

from dataclasses import replace

import numpy as np
from scipy.integrate import solve_ivp

from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements


def poses(n: int, **conditions: np.ndarray) -> Measurements:
    q = np.random.default_rng(0).uniform(-1, 1, (n, 3))
    return Measurements(q=q, kind="position", position=np.zeros((n, 3)), conditions=conditions)


def test_progress_follows_time_else_pose_else_rows() -> None:
    time = np.array([40.0, 10.0, 30.0, 20.0])
    for m in (poses(4, time_s=time), poses(4, pose=time / 10)):
        found, missing = derive(m, ["progress"])
        assert missing == ()
        np.testing.assert_allclose(found.conditions["progress"], [1, 0, 2 / 3, 1 / 3])
    np.testing.assert_allclose(derive(poses(4), ["progress"])[0].conditions["progress"], [0, 1 / 3, 2 / 3, 1])


def test_lagged_warmth_solves_the_differential_equation() -> None:
    rng = np.random.default_rng(1)
    time = np.sort(rng.uniform(0, 3000, 40))
    felt = 20 + 7 * (1 - np.exp(-time / 900)) + 0.05 * rng.normal(size=40)
    exact = solve_ivp(
        lambda t, x: (np.interp(t, time, felt) - x) / 600, (time[0], time[-1]), [felt[0]],
        t_eval=time, rtol=1e-10, atol=1e-10, max_step=5.0,
    ).y[0]  # fmt: skip
    order = rng.permutation(40)
    m = poses(40, time_s=time[order], temperature_degC=felt[order])
    found = derive(m, ["warmth_600s", "warmth_0s"])[0].conditions
    np.testing.assert_allclose(found["warmth_600s"], (exact - exact.mean())[order], atol=2e-6)
    np.testing.assert_allclose(found["warmth_0s"], (felt - felt.mean())[order], atol=1e-12)


def test_approach_follows_from_the_order_of_the_poses() -> None:
    q = np.array([[0.0], [1.0], [1.0], [0.5], [2.0]])
    m = Measurements(q=q, kind="position", position=np.zeros((5, 3)), conditions={"pose": np.arange(5.0)})
    shuffled = m[np.array([3, 0, 4, 1, 2])]
    found = derive(shuffled, ["approach1"])[0].conditions["approach1"]
    np.testing.assert_array_equal(found, [-1, 0, 1, 1, 1])  # a joint that rests keeps its last direction
    logged = replace(m, conditions={"approach1": -np.ones(5)})
    np.testing.assert_array_equal(derive(logged, ["approach1"])[0].conditions["approach1"], -np.ones(5))


def test_what_cannot_be_had_is_named() -> None:
    found, missing = derive(poses(4), ["progress", "warmth_600s", "payload_kg", "approach9", "progress"])
    assert missing == ("warmth_600s", "payload_kg", "approach9")
    assert set(found.conditions) == {"progress"}
    assert derive(poses(4, temperature_degC=np.arange(4.0)), ["warmth_300s"])[1] == ("warmth_300s",)

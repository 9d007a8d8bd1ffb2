"""Columns that follow from logged ones; clocks that go back or jump are said, tables in another order are not."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from casadical.measurements.derived_columns import clock_faults, derive
from casadical.measurements.measurements import Measurements
from casadical.project.check.check import precheck


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


def test_the_heat_of_a_load_is_its_square_behind_a_lag() -> None:
    rng = np.random.default_rng(2)
    time = np.sort(rng.uniform(0, 3000, 30))
    m = poses(30, time_s=time)

    def loads(q: np.ndarray, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        return q * [1, 3, 1] + columns["time_s"][:, None] / 3000

    square = (3 * m.q[:, 1] + time / 3000) ** 2
    exact = solve_ivp(
        lambda t, x: (np.interp(t, time, square) - x) / 300, (time[0], time[-1]), [square[0]],
        t_eval=time, rtol=1e-10, atol=1e-10, max_step=5.0,
    ).y[0]  # fmt: skip
    np.testing.assert_allclose(derive(m, ["heat2_300s"], loads)[0].conditions["heat2_300s"], exact, atol=2e-6)
    for known, name, of in ((m, "heat2_300s", None), (m, "heat4_300s", loads), (poses(30), "heat2_300s", loads)):
        assert derive(known, [name], of)[1] == (name,)


def test_the_sense_of_a_heads_last_turn_is_seen_from_its_station() -> None:
    seen = np.array([[0, 1, 0], [1, 1, 0], [1, 1, 5], [0, 1, 0], [-2, 0.1, 0], [-2, -0.1, 0]], float)
    m = Measurements(q=np.zeros((6, 1)), kind="position", position=seen)
    columns = derive(m, ["head_0_0_0mm", "head_m3000_0_m700mm"])[0].conditions
    np.testing.assert_array_equal(columns["head_0_0_0mm"], [0, -1, -1, 1, 1, 1])  # across the seam at half a turn
    np.testing.assert_array_equal(columns["head_m3000_0_m700mm"], [0, -1, -1, 1, -1, -1])
    assert derive(replace(m, position=None, kind="distance", distance=np.ones(6)), ["head_0_0_0mm"])[1]
    assert derive(replace(m, position=0 * seen), ["head_0_0_0mm"])[1]  # of several tables together
    still = replace(m, position=seen[[0, 1, 1, 1, 3, 3]] + 1e-3 * np.random.default_rng(0).uniform(-1, 1, (6, 3)))
    np.testing.assert_array_equal(derive(still, ["head_0_0_0mm"])[0].conditions["head_0_0_0mm"], [0, -1, -1, -1, 1, 1])


def test_approach_follows_from_the_order_of_the_poses() -> None:
    q = np.array([[0.0], [1.0], [1.0], [0.5], [2.0]])
    m = Measurements(q=q, kind="position", position=np.zeros((5, 3)), conditions={"pose": np.arange(5.0)})
    shuffled = m[np.array([3, 0, 4, 1, 2])]
    found = derive(shuffled, ["approach1"])[0].conditions["approach1"]
    np.testing.assert_array_equal(found, [-1, 0, 1, 1, 1])  # a joint that rests keeps its last direction
    logged = replace(m, conditions={"approach1": -np.ones(5)})
    np.testing.assert_array_equal(derive(logged, ["approach1"])[0].conditions["approach1"], -np.ones(5))
    jitter = replace(m, q=q + 1e-12 * np.array([[0.0], [0.0], [-1.0], [0.0], [0.0]]))
    np.testing.assert_array_equal(derive(jitter, ["approach1"])[0].conditions["approach1"], [0, 1, 1, -1, 1])


def test_what_cannot_be_had_is_named() -> None:
    found, missing = derive(poses(4), ["progress", "warmth_600s", "payload_kg", "approach9", "progress"])
    assert missing == ("warmth_600s", "payload_kg", "approach9")
    assert set(found.conditions) == {"progress"}
    assert derive(poses(4, temperature_degC=np.arange(4.0)), ["warmth_300s"])[1] == ("warmth_300s",)


HOUR = 3600.0


def timed(time: list[float]) -> Measurements:
    n = len(time)
    return Measurements(
        q=np.zeros((n, 2)),
        kind="position",
        position=np.zeros((n, 3)),
        conditions={"time_s": np.array(time)},
        row=np.arange(2, n + 2),
    )


def test_a_clock_that_goes_back_and_one_that_jumps() -> None:
    (text,) = clock_faults(timed([0, 30, 60, 5, 35, 65]))
    assert text.startswith("table: time_s goes back from 60 to 5 s at row 5")
    (text,) = clock_faults(timed([0, 30, 60, 6.3e8, 6.3e8 + 30]))
    assert "time_s jumps from 60 to 630000000 s at row 5: a clock was set or started again" in text


@pytest.mark.parametrize(
    "time",
    [
        list(np.arange(20) * 30.0),
        [*np.arange(10) * 30.0, *(16 * HOUR + np.arange(10) * 30.0)],  # a night
        list(np.random.default_rng(0).permutation(20) * 30.0),  # rows in another order
        [7.0] * 5,
    ],
)
def test_nothing_is_said_of_other_clocks(time: list[float]) -> None:
    assert clock_faults(timed(time)) == ()


def test_check_says_it(tmp_path: Path) -> None:
    problem = Path(__file__).parents[2] / "problems/planar"
    for name in ("robot.toml", "problem.toml"):
        (tmp_path / name).write_text((problem / name).read_text().replace("../../data/planar/", ""))
    (table,) = (problem / "../../data/planar").resolve().glob("*.csv")
    first, *lines = table.read_text().splitlines()
    times = [30 * k if k < 20 else 30 * k - 400 for k in range(len(lines))]
    text = "\n".join([f"{first},time_s", *(f"{line},{t}" for line, t in zip(lines, times, strict=True))])
    (tmp_path / table.name).write_text(text)
    (said,) = [f.text for f in precheck(tmp_path).findings if f.topic == "clock"]
    assert f"{table.name}: time_s goes back from 570 to 200 s at row 22" in said

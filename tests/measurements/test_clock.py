"""Clocks that go back or jump are said, with rows; tables in another order are not."""

from pathlib import Path

import numpy as np
import pytest

from casadical import Measurements
from casadical.measurements.clock import clock_faults
from casadical.project.check.check import precheck

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

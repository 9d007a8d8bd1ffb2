"""What a log says of itself: clock, quanta, repeated rows, delays; each fault of a log with its sentence and figure."""

import numpy as np
import pandas as pd
import pytest

from casadical import InputError, Joint, Robot
from casadical.measurements.logs.findings import _fastest, quantum, repeated_rows
from casadical.measurements.logs.log import JointLog
from casadical.measurements.logs.reading import read_log

STEP = 0.01
T = STEP * np.arange(3000)
TWO = Robot("two", (Joint(lower=-2, upper=2), Joint(a=0.4, lower=-2, upper=2)))


def motion(t):
    return np.column_stack([0.8 * np.sin(2 * t) + 0.2 * np.sin(5.3 * t), 0.5 * np.sin(1.3 * t + 1)])


def said(tmp_path, robot=None, **changes):
    """Findings of a log of two joints, in one text."""
    q = np.round(motion(T - 0.02) / 1e-3) * 1e-3
    columns = {"time_s": T, "command1_rad": motion(T)[:, 0], "command2_rad": motion(T)[:, 1]}
    columns |= {"q1_rad": q[:, 0], "q2_rad": q[:, 1], "current1_A": q[:, 0] - 0.1, "current2_A": q[:, 1]} | changes
    pd.DataFrame({name: c for name, c in columns.items() if c is not None}).to_csv(tmp_path / "log.csv", index=False)
    return "\n".join(read_log(tmp_path / "log.csv", robot).findings)


def test_a_good_log_is_told_with_its_figures(tmp_path) -> None:
    text = said(tmp_path)
    assert "3000 rows of 2 joints, joint 1, joint 2: command, position, current; SI units" in text
    assert "1 run of 30.0 s at 100.00 Hz; steps differ by" in text
    assert "positions come in steps of 1 mrad" in text
    assert len(text.splitlines()) == 3


def test_lost_samples_and_jitter(tmp_path) -> None:
    rng = np.random.default_rng(0)
    time = T + rng.normal(0, 0.0004, len(T))
    time[500:] += 5 * STEP
    time[2000:] += STEP
    text = said(tmp_path, time_s=time)
    assert "6 samples are lost (0.2 %) in 2 gaps, the longest 6" in text
    spread = float(text.split("steps differ by ")[1].split(" ms")[0])
    assert spread == pytest.approx(0.4 * np.sqrt(2), rel=0.05)


def test_repeated_rows_are_found_and_slow_motion_is_none(tmp_path) -> None:
    q = np.round(motion(T) / 1e-3) * 1e-3
    rows = np.random.default_rng(1).choice(np.arange(5, 2990), 40, replace=False)
    held = q.copy()
    held[rows] = held[rows - 1]
    found = repeated_rows(JointLog(T, ("a", "b"), held, command=q))
    slow = (np.abs(q[rows + 1] - q[rows - 1]) <= 4e-3).all(axis=1)
    assert set(rows[~slow]) >= set(np.flatnonzero(found)) > set()
    assert found.sum() >= 0.9 * (~slow).sum() >= 25
    assert not repeated_rows(JointLog(T, ("a", "b"), q, command=q)).any()
    text = said(tmp_path, q1_rad=held[:, 0], q2_rad=held[:, 1], current1_A=None, current2_A=None)
    assert "rows repeat the reading before while the arm moves" in text


@pytest.mark.parametrize("step", [1e-5, 1.534e-3, 0.1])
def test_quantum(step) -> None:
    x = motion(T)[:, 0]
    assert quantum(np.round(x / step) * step) == pytest.approx(step, rel=0.02)
    assert quantum(np.round(np.round(x / step) * step, 7)) == pytest.approx(step, rel=0.03)


def test_no_quantum_of_continuous_numbers() -> None:
    assert quantum(motion(T)[:, 0]) == 0.0
    assert quantum(np.random.default_rng(0).normal(size=2000)) == 0.0
    assert quantum(np.zeros(100)) == 0.0


@pytest.mark.parametrize("delay", [0.0, 0.008, 0.02, -0.012])
def test_delay_of_logged_speeds(tmp_path, delay) -> None:
    h = 1e-4
    v = (motion(T - 0.02 - delay + h) - motion(T - 0.02 - delay - h)) / (2 * h)
    text = said(tmp_path, v1_rad_s=v[:, 0], v2_rad_s=v[:, 1])
    if not delay:
        assert "speeds are" not in text
        return
    assert float(text.split("speeds are ")[1].split(" ms")[0]) == pytest.approx(1e3 * abs(delay), rel=0.1)
    assert ("behind" if delay > 0 else "ahead of") + " positions" in text


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {"q2_rad": np.full(len(T), 0.3), "command2_rad": np.full(len(T), 0.3)},
            "joint 2 never moves (0 mrad): of it only the load that it holds is identified",
        ),
        (
            {"q2_rad": np.round(0.1 * np.sin(0.1 * T) / 1e-4) * 1e-4},
            "joint 2 moves at 10 mrad/s at most: too slow to tell viscous friction, lag or inertia",
        ),
        ({"current2_A": np.full(len(T), 1.5)}, "current of joint 2 is 1.5 in every row: it is not measured"),
        ({"command2_rad": -motion(T)[:, 1]}, "joint 2: command and reading count in opposite directions"),
        (
            {"command1_rad": motion(T)[:, 1], "command2_rad": motion(T)[:, 0]},
            "the command of joint 1 moves as the reading of joint 2 does",
        ),
        (
            {"command1_rad": None, "command2_rad": None},
            "no commands: friction, load and inertia are identified from the torque",
        ),
        (
            {"current1_A": None, "current2_A": None},
            "no torque and no signed current: causes are identified from the response",
        ),
        (
            {"current1_A": np.abs(T % 2), "current2_A": np.abs(T % 3)},
            "current is never negative, though 2 joints move to and fro: read as the absolute value",
        ),
    ],
)
def test_faults_are_told_with_what_helps(tmp_path, changes, expected) -> None:
    text = said(tmp_path, **changes)
    assert expected in text
    remedies = ("Log ", "Move ", "turn the sign", "Name the columns")
    line = next(line for line in text.splitlines() if expected in line)
    assert any(remedy in line for remedy in remedies)


def test_commands_that_are_the_readings(tmp_path) -> None:
    q = np.round(motion(T) / 1e-3) * 1e-3
    text = said(tmp_path, q1_rad=q[:, 0], q2_rad=q[:, 1], command1_rad=q[:, 0], command2_rad=q[:, 1])
    assert "commands are the readings to the last digit" in text


def test_degrees_called_radians_are_refused(tmp_path) -> None:
    degrees = np.rad2deg(motion(T - 0.02))
    with pytest.raises(
        InputError, match=r"position of joint 1: .* rad; such angles are degrees: name the columns q1_deg"
    ):
        said(tmp_path, q1_rad=degrees[:, 0], q2_rad=degrees[:, 1])
    small = np.rad2deg(0.15 * motion(T - 0.02))
    with pytest.raises(InputError, match="such angles are degrees"):
        said(tmp_path, TWO, q1_rad=small[:, 0], q2_rad=small[:, 1], command1_rad=None, command2_rad=None)
    with pytest.raises(InputError, match=r"readings of joint 1 are 57.3 times its commands: degrees called"):
        said(tmp_path, q1_rad=small[:, 0], q2_rad=small[:, 1], command1_rad=0.15 * motion(T)[:, 0])


def test_the_fastest_speed_is_that_of_a_tenth_of_a_second() -> None:
    q = np.sin(6 * T)[:, None]
    assert _fastest(JointLog(T, ("a",), q, q), 0) == pytest.approx(6, rel=0.02)


def test_readings_that_were_not_measured_are_refused(tmp_path) -> None:
    still = np.full(len(T), 0.3)
    with pytest.raises(
        InputError, match=r"joint 2: 0.3 rad in all 3000 rows, though its commands move by 1 rad: .*Log"
    ):
        said(tmp_path, q2_rad=still)
    with pytest.raises(InputError, match="no joint moves, each reading is one number in all 3000 rows; log a motion"):
        said(tmp_path, q1_rad=still, q2_rad=still, command1_rad=None, command2_rad=None)


def test_what_is_logged_of_some_joints_alone_is_left_out(tmp_path) -> None:
    text = said(tmp_path, TWO, current1_A=None)
    assert "current is left out, for there is none of joint 1. Log it of every joint" in text
    with pytest.raises(InputError, match="neither commands nor a torque or current"):
        said(tmp_path, TWO, current1_A=None, command1_rad=None)


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"payload_kg": np.full(len(T), -5)}, "row 2, column 'payload': -5 is not possible; allowed: 0 to 100000"),
        ({"temperature1_degC": np.full(len(T), -400.0)}, "'temperature joint 1': -400 is not possible; allowed: -273"),
        ({"time_s": np.full(len(T), 1.0)}, "time grows in none of its 3000 rows from the row before in its run"),
        ({"run": np.arange(len(T))}, "time grows in none of its 3000 rows"),
        ({"time_s": 100 * T}, "rows lie 1 s apart; a motion is logged some times a second"),
        ({"run": np.full(len(T), 1e30)}, r"row 2, column 'run': 1e\+30 is no whole number"),
        ({"run": np.full(len(T), 1.5)}, r"row 2, column 'run': 1.5 is no whole number"),
        ({"q1_deg": 0 * T}, "columns q1_rad and q1_deg are the position of one joint; keep one"),
    ],
)
def test_cells_that_cannot_be_are_refused(tmp_path, changes, fault) -> None:
    with pytest.raises(InputError, match=fault):
        said(tmp_path, **changes)


def test_a_second_column_of_a_quantity_is_left_out_and_said(tmp_path) -> None:
    assert "column joint_1_position is not used, for q1_rad is the position of joint 1" in said(
        tmp_path, joint_1_position=0 * T
    )


def test_a_unit_that_changes_is_refused_with_its_row(tmp_path) -> None:
    q = 0.15 * motion(T)
    q[1700:] = np.rad2deg(q[1700:])
    assert (np.abs(q[1700]) > 1).any()
    with pytest.raises(InputError, match=r"row 1702, position of joint \d: .* 5\d.\d times: the unit changes there"):
        said(tmp_path, q1_rad=q[:, 0], q2_rad=q[:, 1], command1_rad=None, command2_rad=None)

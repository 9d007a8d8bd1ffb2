"""Logs of the contract's tables: channels, joints, units and runs; what is refused, and with which words."""

import gzip
import time

import numpy as np
import pandas as pd
import pytest

from casadical import InputError, Joint, Robot
from casadical.measurements.logs.log import JointLog
from casadical.measurements.logs.reading import is_log, read_log
from casadical.measurements.raw_table import plain_headings
from casadical.robot.urdf import read_urdf

T = np.arange(400) / 100
Q = np.column_stack([0.5 * np.sin(T), 1.0 + 0.3 * np.cos(2 * T)])
COLUMNS = {
    "time_s": T, "command1_rad": Q[:, 0], "command2_rad": Q[:, 1], "q1_rad": Q[:, 0] - 0.01, "q2_rad": Q[:, 1] + 0.02,
    "v1_rad_s": np.gradient(Q[:, 0], T), "v2_rad_s": np.gradient(Q[:, 1], T),
    "current1_A": Q[:, 0], "current2_A": Q[:, 1],
    "temperature1_degC": 30 + T, "temperature2_degC": 31 + T, "voltage_V": 12 - T / 100, "payload_kg": 0 * T + 2,
    "run": (T >= 2) + 1,
}  # fmt: skip
ARM = Robot("two", (Joint(name="shoulder"), Joint(a=0.4, name="elbow")))


def frame(**changes):
    table = pd.DataFrame(COLUMNS | changes)
    return table[[name for name in table if table[name].notna().any()]]


@pytest.mark.parametrize("form", ["csv", "csv.gz", "parquet", "semicolons"])
def test_table_of_the_contract(tmp_path, form) -> None:
    path = tmp_path / f"log.{'csv' if form == 'semicolons' else form}"
    if form == "parquet":
        frame().to_parquet(path)
    elif form == "semicolons":
        frame().to_csv(path, index=False, sep=";", decimal=",")
    else:
        frame().to_csv(path, index=False)
    log = read_log(path)
    assert (len(log), log.joints, log.kinds) == (400, ("joint 1", "joint 2"), ("revolute", "revolute"))
    assert log.command == pytest.approx(Q)
    assert log.position == pytest.approx(Q + np.array([-0.01, 0.02]))
    assert log.speed == pytest.approx(np.gradient(Q, T, axis=0))
    assert log.current == pytest.approx(Q)
    assert not log.current_unsigned
    assert log.temperature == pytest.approx(np.column_stack([30 + T, 31 + T]))
    assert log.voltage == pytest.approx(12 - T / 100)
    assert log.payload == pytest.approx(np.full(400, 2.0))
    assert log.torque is None
    assert log.command_speed is None
    assert [(int(run.run[0]), len(run)) for run in log.runs()] == [(1, 200), (2, 200)]
    assert log.step == pytest.approx(0.01)
    assert log.row[:2].tolist() == [2, 3]


def test_degrees_and_millimetres_become_si(tmp_path) -> None:
    table = frame()[["time_s", "command1_rad"]]
    table = table.assign(q1_deg=np.degrees(Q[:, 0]), v1_deg_s=10.0, q2_mm=1e3 * Q[:, 1], v2_mm_s=5.0, torque2_N=7.0)
    table.to_csv(tmp_path / "log.csv", index=False)
    log = read_log(tmp_path / "log.csv")
    assert log.kinds == ("revolute", "prismatic")
    assert log.position == pytest.approx(Q)
    assert log.speed[0] == pytest.approx([np.radians(10), 0.005])
    assert log.torque[0, 1] == 7.0
    assert np.isnan(log.torque[:, 0]).all()
    assert log.unit("speed", 1) == "m/s"
    assert not log.current_unsigned  # a load that never changes its sign is none without a sign


def test_missing_cells_are_nan_and_arrays_cannot_be_written(tmp_path) -> None:
    table = frame()
    table.loc[7, "current2_A"] = np.nan
    table.to_csv(tmp_path / "log.csv", index=False)
    log = read_log(tmp_path / "log.csv")
    assert np.argwhere(np.isnan(log.current)).tolist() == [[7, 1]]
    with pytest.raises(ValueError, match="read-only"):
        log.current[0, 0] = 1.0
    assert log[5:10].row.tolist() == [7, 8, 9, 10, 11]


def test_rtde_table_with_zero_based_numbers(tmp_path) -> None:
    table = pd.DataFrame({"timestamp": 500.0 + T})
    for i in range(2):
        table[f"target_q_{i}"], table[f"actual_q_{i}"] = Q[:, i], Q[:, i] - 0.01
        table[f"target_qd_{i}"], table[f"actual_qd_{i}"] = Q[:, i], Q[:, i] + 1
        table[f"target_current_{i}"], table[f"actual_current_{i}"] = 7.0, Q[:, i]
        table[f"target_moment_{i}"], table[f"joint_temperatures_{i}"] = 9.0, 30.0
        table[f"actual_TCP_pose_{i}"] = 0.1
    table.to_csv(tmp_path / "rtde.csv", index=False, sep=" ")
    log = read_log(tmp_path / "rtde.csv", ARM)
    assert log.joints == ("shoulder", "elbow")
    assert log.command == pytest.approx(Q)
    assert log.position == pytest.approx(Q - 0.01)
    assert log.command_speed == pytest.approx(Q)
    assert log.speed == pytest.approx(Q + 1)
    assert log.current == pytest.approx(Q)
    assert log.temperature[0].tolist() == [30.0, 30.0]
    assert log.torque is None


def test_joints_by_name_in_the_robots_order_without_others(tmp_path) -> None:
    table = pd.DataFrame({"time": T * 1e3})
    for name, column in (("elbow_joint", Q[:, 1]), ("gripper", T), ("shoulder", Q[:, 0])):
        table[f"/joint_states/{name}/position"], table[f"{name} command"] = column, column
        table[f"/joint_states/{name}/effort"] = 2 * column
    named = table.rename(columns=lambda name: f"{name} position" if name.endswith("command") else name)
    named.to_csv(tmp_path / "log.csv", index=False)
    log = read_log(tmp_path / "log.csv", ARM)
    assert log.joints == ("shoulder", "elbow")
    assert log.position == pytest.approx(Q)
    assert log.command == pytest.approx(Q)
    assert log.torque == pytest.approx(2 * Q)
    assert log.time == pytest.approx(T)
    assert any("gripper" in text and "left out" in text for text in log.findings)


def test_time_that_jumps_back_begins_a_run_and_repeated_rows_are_left_out(tmp_path) -> None:
    time = np.where(T < 2, T, T - 1.5)
    time[10] = time[9]
    frame(time_s=time).drop(columns="run").to_csv(tmp_path / "log.csv", index=False)
    log = read_log(tmp_path / "log.csv")
    assert [len(run) for run in log.runs()] == [199, 200]
    said = " ".join(log.findings)
    assert "row 202: time jumps back from 1.99 to 0.5 s" in said
    assert "row 12: the time of the row before, as 1 rows: left out" in said


@pytest.mark.parametrize(
    ("drop", "said"),
    [
        (["command", "current"], "neither commands nor a torque or current"),
        (["q"], "no column holds the positions of joints"),
        (["time"], "no column holds the time; name it time_s"),
    ],
)
def test_what_is_missing_is_said_with_a_remedy(tmp_path, drop, said) -> None:
    table = frame()
    table = table[[name for name in table if not any(name.startswith(stem) for stem in drop)]]
    table.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(InputError, match=said):
        read_log(tmp_path / "log.csv")


def test_too_few_joints_are_refused(tmp_path) -> None:
    frame().to_csv(tmp_path / "log.csv", index=False)
    three = Robot("three", (*ARM.joints, Joint(a=0.1)))
    with pytest.raises(InputError, match=r"positions of 2 joints \(1, 2\), the robot 'three' has 3"):
        read_log(tmp_path / "log.csv", three)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"position": Q[:, :1]}, r"position has the shape \(400, 1\); allowed: \(400, 2\)"),
        ({"joints": ("a", "a")}, "joint 'a' is there twice"),
        ({"time": T[::-1]}, "row 3, column 'time_s': 3.98 s follows 3.99 s; allowed: times that grow"),
        ({"position": np.where(T[:, None] == 1, np.inf, Q)}, "row 102, column 'position a': inf is not possible"),
        ({"current": -np.ones((400, 2)), "current_unsigned": True}, "allowed: absolute values"),
        ({"run": np.where(T < 1, 1, np.where(T < 2, 2, 1))}, "rows of one run stand apart"),
    ],
)
def test_what_no_arm_can_have_logged_is_refused(changes, said) -> None:
    with pytest.raises(InputError, match=said):
        JointLog(**({"time": T, "joints": ("a", "b"), "position": Q, "command": Q} | changes))


def test_truth_values_and_words_are_no_positions(tmp_path) -> None:
    frame(q1_rad=T > 1, q2_rad=T > 2).to_parquet(tmp_path / "log.parquet")
    with pytest.raises(InputError, match="column 'q1_rad': False is no number"):
        read_log(tmp_path / "log.parquet")
    words = frame(q1_rad=T, q2_rad=T).astype({"q2_rad": object})
    words.loc[9, "q2_rad"] = "--"
    words.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(InputError, match="row 11, column 'q2_rad': -- is no number; correct or empty the cell"):
        read_log(tmp_path / "log.csv")


def test_a_quote_that_is_never_closed_is_looked_for_once() -> None:
    began = time.process_time()
    assert plain_headings(b"a," * 1000 + b'"') == ()
    assert time.process_time() - began < 2


def test_gzip_that_is_damaged_or_too_large_is_refused(tmp_path) -> None:
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(b"time_s,q1_rad\n" * 1000)[:40])
    with pytest.raises(InputError, match="not a readable gzip file"):
        read_log(path)


@pytest.mark.parametrize("form", ["rows", "text"])
def test_more_numbers_than_memory_should_hold_are_refused(tmp_path, form) -> None:
    """Zeros, which are a few kilobytes of Parquet or gzip."""
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    path, zeros = tmp_path / "log.parquet", arrow.array(np.zeros(1_100_000))
    if form == "rows":
        parquet.write_table(arrow.table(dict.fromkeys(("time_s", *(f"q{k}_rad" for k in range(1, 30))), zeros)), path)
    else:
        path = tmp_path / "log.csv.gz"
        path.write_bytes(gzip.compress(b"time_s,q1_rad\n" + b"0,0\n" * 16_000_000, 1))
    with pytest.raises(InputError, match=r"has more than 30000000 numbers; split it"):
        read_log(path)


def test_a_pause_begins_another_run_and_rows_of_no_motion_are_refused(tmp_path) -> None:
    """What is resampled to even steps would else fill the memory."""
    frame(time_s=np.where(T < 2, T, 1e12 + T), run=np.nan).to_csv(tmp_path / "log.csv", index=False)
    log = read_log(tmp_path / "log.csv")
    assert [len(run) for run in log.runs()] == [200, 200]
    assert any("row 202: 1e+12 s after the row before: read as a new run from there" in str(f) for f in log.findings)
    frame(time_s=T * 86400e2).to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(InputError, match=r"rows lie 8.64e\+04 s apart"):
        read_log(tmp_path / "log.csv")


def test_a_stray_row_with_a_run_of_its_own_is_left_out_and_said(tmp_path) -> None:
    path = tmp_path / "stray.csv"
    pd.concat([frame(), frame().head(1).assign(run=3)]).to_csv(path, index=False)
    log = read_log(path)
    assert (len(log), [len(run) for run in log.runs()]) == (400, [200, 200])
    assert any("row 402: a run of its own (1 such): left out" in str(f) for f in log.findings)


def lists(values: np.ndarray, form: str) -> list[str]:
    return [form.format([float(v) for v in row]) for row in values]


@pytest.mark.parametrize(
    "columns",
    [
        {"Time": T, "Joint_1": Q[:, 0], "Joint_2": Q[:, 1], "current_1": T, "current_2": -T},
        {"t [s]": T, "timestamp [ms]": 1e9 * T, "q_1": Q[:, 0], "q_2": Q[:, 1], "i_1": T, "i_2": -T},
        {"timestamp": T, "θ1 (rad)": Q[:, 0], "θ2 (rad)": Q[:, 1], "I1 [A]": T, "I2 [A]": -T},
        {"Zeit": T, "Achse 1 [rad]": Q[:, 0], "Achse 2 [rad]": Q[:, 1], "Strom A1": T, "Strom A2": -T},
        {"time": T, "name": "['shoulder', 'elbow']", "position": lists(Q, "{}"), "current": lists(np.c_[T, -T], "{}")},
        {
            "time": T,
            "name": "['elbow', 'shoulder']",
            "position": lists(Q[:, ::-1], "array('d', {})"),
            "current": lists(np.c_[-T, T], "array('d', {})"),
        },
    ],
    ids=["Joint_1, current_1", "q_1, i_1", "letters", "German", "JointState", "JointState of Python, another order"],
)  # fmt: skip
def test_headings_as_people_write_them(columns, tmp_path) -> None:
    pd.DataFrame(columns).to_csv(tmp_path / "log.csv", index=False)
    assert is_log(tmp_path / "log.csv")
    log = read_log(tmp_path / "log.csv", ARM)
    assert log.position == pytest.approx(Q)
    assert log.current == pytest.approx(np.column_stack([T, -T]))
    assert log.time - log.time[0] == pytest.approx(T - T[0])


URDF = """<robot name="m"><link name="base"/><link name="l1"/><link name="l2"/><link name="l3"/><link name="thumb"/>
<link name="finger"/>{joints}</robot>"""


def urdf_joint(name, parent, child, mimic=""):
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>'
    limit = '<limit lower="-2" upper="2" effort="9" velocity="3"/>'
    return f'<joint name="{name}" type="revolute">{ends}{limit}{mimic}</joint>'


@pytest.mark.parametrize("numbered", [False, True])
def test_joints_that_mimic_others_need_no_column(numbered, tmp_path) -> None:
    """The wrist mimics a joint of the chain, the finger one beside it; what they would read is computed by hand."""
    joints = urdf_joint("pan", "base", "l1") + urdf_joint("lift", "l1", "l2")
    joints += urdf_joint("wrist", "l2", "l3", '<mimic joint="lift" multiplier="-1" offset="0.1"/>')
    joints += urdf_joint("grip", "l3", "thumb")
    joints += urdf_joint("finger_joint", "l3", "finger", '<mimic joint="grip" multiplier="-2" offset="0.05"/>')
    (tmp_path / "m.urdf").write_text(URDF.format(joints=joints))
    robot = read_urdf(tmp_path / "m.urdf", tip_link="l3" if numbered else "finger")
    t = np.arange(0, 5, 0.02)
    pan, lift, grip = (0.3 * np.sin((k + 1) * t) for k in range(3))
    said = [("1", pan), ("2", lift)] if numbered else [("pan", pan), ("lift", lift), ("grip", grip)]
    columns = {"time_s": t}
    for joint, q in said:
        columns |= {f"q{joint}_rad" if numbered else f"{joint} position rad": q}
        columns |= {f"command{joint}_rad" if numbered else f"{joint} command rad": q + 0.01}
        columns |= {f"v{joint}_rad_s" if numbered else f"{joint} velocity rad/s": np.gradient(q, t)}
    pd.DataFrame(columns).to_csv(tmp_path / "log.csv", index=False)
    log = read_log(tmp_path / "log.csv", robot)
    wanted = [pan, lift, 0.1 - lift, *([] if numbered else [0.05 - 2 * grip])]
    np.testing.assert_allclose(log.position, np.column_stack(wanted), atol=1e-12)
    factor = np.array([1, 1, -1, -2])[: robot.n]
    np.testing.assert_allclose(log.command - log.position, 0.01 * np.tile(factor, (len(t), 1)), atol=1e-12)
    np.testing.assert_allclose(log.speed, np.gradient(np.column_stack(wanted), t, axis=0), atol=1e-9)
    assert any("wrist: not in the log, and computed" in text for text in log.findings)

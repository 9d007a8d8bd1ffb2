"""Logs of other systems: folders of SAGE, LeRobot's Parquet, ROS bags and MCAP written by rosbags itself."""

import json
from dataclasses import replace
from pathlib import Path
from sqlite3 import connect

import numpy as np
import pandas as pd
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from casadical import InputError, Joint, Robot
from casadical.core.drive import Drive
from casadical.measurements.logs.reading import is_log, read_log
from casadical.measurements.logs.systems import _of_stream

T = np.arange(200) / 50
Q = np.column_stack([0.5 * np.sin(3 * T), 1.0 + 0.3 * np.cos(2 * T)])
ARM = Robot("two", (Joint(name="shoulder", lower=-2, upper=2), Joint(a=0.4, name="elbow_joint", lower=-1, upper=3)))
STORE = get_typestore(Stores.ROS2_HUMBLE)
CONTROLLER = """
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint reference
trajectory_msgs/JointTrajectoryPoint feedback
trajectory_msgs/JointTrajectoryPoint error
"""
STORE.register(get_types_from_msg(CONTROLLER, "control_msgs/msg/JointTrajectoryControllerState"))
TYPES = STORE.types


def header(time):
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=int(time), nanosec=int(1e9 * (time % 1)))
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id="")


def state(time, names, q, effort=()):
    lists = (np.asarray(values, dtype=float) for values in (q, np.zeros(len(q)) + 0.5, effort))
    return TYPES["sensor_msgs/msg/JointState"](header(time), list(names), *lists)


def controller(time, names, wanted, there):
    point, duration = TYPES["trajectory_msgs/msg/JointTrajectoryPoint"], TYPES["builtin_interfaces/msg/Duration"](0, 0)
    empty = np.zeros(0)
    points = [point(np.asarray(q, dtype=float), empty, empty, empty, duration) for q in (wanted, there, there)]
    return TYPES["control_msgs/msg/JointTrajectoryControllerState"](header(time), list(names), *points)


def write(path, messages, plugin=StoragePlugin.SQLITE3):
    """messages : (topic, received [s], message)"""
    with Writer(path, version=9, storage_plugin=plugin) as bag:
        kinds = {topic: type(message).__msgtype__ for topic, _, message in messages}
        topics = {topic: bag.add_connection(topic, kind, typestore=STORE) for topic, kind in kinds.items()}
        for topic, received, message in messages:
            data = STORE.serialize_cdr(message, type(message).__msgtype__)
            bag.write(topics[topic], int(1e9 * received), data)
    return path


@pytest.mark.parametrize(("plugin", "end"), [(StoragePlugin.SQLITE3, "db3"), (StoragePlugin.MCAP, "mcap")])
def test_bag_of_joint_states_and_a_controller(tmp_path, plugin, end) -> None:
    """Names are in another order, a gripper stands between; commands come from the controller's own topic."""
    messages = []
    for t, (a, b) in zip(1e9 + T, Q, strict=True):
        names = ("elbow_joint", "gripper", "shoulder")
        messages.append(("/joint_states", t + 0.002, state(t, names, (b, 0.0, a), (2 * b, 0.1, 2 * a))))
        wanted, there = (a + 0.01, b + 0.01), (a, b)
        messages.append(("/arm/state", t + 0.003, controller(t - 0.004, ("shoulder", "elbow_joint"), wanted, there)))
    folder = write(tmp_path / "bag", messages, plugin)
    for path in (folder, next(folder.glob(f"*.{end}"))):
        log = read_log(path, ARM)
        assert log.joints == ("shoulder", "elbow_joint")
        assert log.position == pytest.approx(Q)
        assert log.command == pytest.approx(Q + 0.01)
        assert log.torque == pytest.approx(2 * Q)
        assert log.time == pytest.approx(T, abs=1e-6)
    said = " ".join(log.findings)
    assert "/joint_states: recorded 2.0 ms after the stamp" in said
    assert "command: of another stream, 4.0 ms" in said
    assert "joints gripper are not of the robot" in said
    assert read_log(path, ARM, effort="current").current == pytest.approx(2 * Q)


def test_bag_without_stamps_and_with_two_arms(tmp_path) -> None:
    names = ("left_j1", "left_j2", "right_j1", "right_j2")
    four = np.hstack([Q, -Q])
    messages = [("/joint_states", 1e9 + t, state(0.0, names, q, q)) for t, q in zip(T, four, strict=True)]
    log = read_log(write(tmp_path / "bag", messages))
    assert log.joints == names
    said = " ".join(log.findings)
    assert "without stamps; times are those of recording" in said
    assert "joints of two arms stand in one log" in said
    right = Robot("right", (Joint(name="right_j1"), Joint(a=0.4, name="right_j2")))
    assert read_log(tmp_path / "bag", right).position == pytest.approx(-Q)


def test_bags_that_cannot_be_used(tmp_path) -> None:
    empty = write(tmp_path / "other", [("/clock", 1.0, TYPES["std_msgs/msg/Float64"](1.0))])
    with pytest.raises(InputError, match=r"no joint states; there are /clock \(std_msgs/msg/Float64\); record"):
        read_log(empty)
    (tmp_path / "damaged.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    with pytest.raises(InputError, match="not a readable bag"):
        read_log(tmp_path / "damaged.mcap")
    odd = "insert into topics values(1,NULL,NULL,'cdr','')"
    with connect(tmp_path / "odd.db3") as database:
        database.executescript(
            "create table topics(id,name,type,serialization_format,offered_qos_profiles);"
            f"create table messages(id,topic_id,timestamp,data);{odd};insert into messages values(1,1,NULL,NULL)"
        )
    names = ("shoulder", "elbow_joint")
    nothing = [("/joint_states", 1e9 + t, state(1e9 + t, names, (np.nan, np.nan), (1.0, 1.0))) for t in T]
    with pytest.raises(InputError, match="the positions of the robot's joints have no number in any row"):
        read_log(write(tmp_path / "nothing", nothing), ARM)
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "metadata.yaml").write_text("rosbag2_bagfile_information: 5")
    for path in (tmp_path / "odd.db3", tmp_path / "meta"):
        with pytest.raises(InputError, match="not a readable bag: damaged, or of an unknown form; record it"):
            read_log(path)
    with pytest.raises(InputError, match="no such file"):
        read_log(tmp_path / "none.db3")
    with pytest.raises(InputError, match="a folder without state_motor"):
        read_log(tmp_path)


def sage(folder, torques):
    folder.mkdir()
    (folder / "joint_list.txt").write_text("elbow_joint\nshoulder\n")
    stamps = (1e6 * T).astype(int)
    state = {"type": "STATE_MOTOR", "timestamp": stamps + 5000, "positions": [json.dumps([b, a]) for a, b in Q]}
    state |= {"velocities": [json.dumps([0.1 * b, 0.1 * a]) for a, b in Q], "torques": [json.dumps(t) for t in torques]}
    pd.DataFrame(state).to_csv(folder / "state_motor.csv", index=False)
    told = {"type": "CONTROL", "timestamp": stamps, "positions": [json.dumps([b + 0.01, a]) for a, b in Q]}
    pd.DataFrame(told).to_csv(folder / "control.csv", index=False)
    return folder


def test_folder_of_sage_in_microseconds(tmp_path) -> None:
    log = read_log(sage(tmp_path / "motion", [[b - 1, a] for a, b in Q]), ARM)
    assert log.position == pytest.approx(Q)
    assert log.command == pytest.approx(Q + np.array([0, 0.01]))
    assert log.torque == pytest.approx(Q - np.array([0, 1]))
    assert np.diff(log.time) == pytest.approx(0.02)
    assert any("command: of another stream, 5.0 ms" in text for text in log.findings)


def test_torque_that_is_never_negative_is_an_unsigned_current(tmp_path) -> None:
    log = read_log(sage(tmp_path / "motion", [[abs(b - 1), abs(a)] for a, b in Q]), ARM)
    assert log.torque is None
    assert log.current_unsigned
    assert log.current == pytest.approx(np.abs(Q - np.array([0, 1])))
    assert any("torque is never negative, though 2 joints move to and fro" in text for text in log.findings)


def test_lists_of_other_lengths_are_named_by_row(tmp_path) -> None:
    folder = sage(tmp_path / "motion", [[b, a] for a, b in Q])
    text = (folder / "state_motor.csv").read_text().splitlines()
    text[5] = text[5].replace("[", "[0.5, ", 1)
    (folder / "state_motor.csv").write_text("\n".join(text))
    with pytest.raises(InputError, match=r"row 6, column 'positions': a list of 3 numbers, 2 in the first row"):
        read_log(folder)


@pytest.mark.parametrize("cell", ["3", "[0.1, null, {}]", '["a", "b"]', "[[1, 2], [3, 4]]", "[1, 2], [3, 4]"])
def test_what_is_no_list_of_numbers_is_named_by_row(tmp_path, cell) -> None:
    folder = sage(tmp_path / "motion", [[b, a] for a, b in Q])
    table = pd.read_csv(folder / "state_motor.csv").astype(object)
    table.loc[3, "positions"] = cell
    table.to_csv(folder / "state_motor.csv", index=False)
    with pytest.raises(InputError, match=r"column 'positions': "):
        read_log(folder)


def lerobot(tmp_path, scale):
    data = tmp_path / "data" / "chunk-000"
    data.mkdir(parents=True)
    (tmp_path / "meta").mkdir()
    names = [f"{joint.name.removesuffix('_joint')}.pos" for joint in ARM.joints]
    info = {"features": {"observation.state": {"names": names}, "action": {"names": names}}}
    (tmp_path / "meta" / "info.json").write_text(json.dumps(info))
    rows = {
        "action": list((scale * Q).astype(np.float32)),
        "observation.state": list((scale * Q - 1).astype(np.float32)),
    }
    rows |= {"timestamp": np.where(T < 2, T, T - 2), "episode_index": (T >= 2).astype(int), "index": np.arange(len(T))}
    pd.DataFrame(rows).to_parquet(data / "file-000.parquet")
    return data / "file-000.parquet"


def test_lerobot_in_degrees_with_episodes_as_runs(tmp_path) -> None:
    log = read_log(lerobot(tmp_path, 180 / np.pi * 2), ARM)
    assert log.command == pytest.approx(2 * Q, abs=1e-5)
    assert log.position == pytest.approx(2 * Q - np.deg2rad(1), abs=1e-5)
    assert [len(run) for run in log.runs()] == [100, 100]
    assert log.joints == ("shoulder", "elbow_joint")


def test_lerobot_in_per_cent_asks_and_takes_the_robots_ranges(tmp_path) -> None:
    path = lerobot(tmp_path, 50.0)
    with pytest.raises(InputError, match="degrees or, as LeRobot writes by default, per cent of each joint"):
        read_log(path, ARM)
    log = read_log(path, ARM, unit="percent")
    assert log.command == pytest.approx(Q + np.array([0, 1]), abs=1e-5)
    assert read_log(path, ARM, unit="deg").command == pytest.approx(np.deg2rad(50 * Q), abs=1e-5)
    said = replace(ARM, drive=Drive(log_angles="deg"))  # [drive] says it where no argument can, as in a command
    assert read_log(path, said).command == pytest.approx(np.deg2rad(50 * Q), abs=1e-5)
    with pytest.raises(InputError, match="needs the ranges of the joints: give the robot"):
        read_log(path, unit="percent")


def test_logs_are_told_from_tables_of_poses(tmp_path) -> None:
    assert is_log(sage(tmp_path / "motion", Q.tolist()))
    assert is_log(tmp_path / "motion" / "state_motor.csv")
    assert is_log(lerobot(tmp_path, 1.0))
    assert not is_log("data/planar/planar.csv")
    assert not is_log("data/ur10_laser_tracker/series_C_random_poses.csv")
    assert not is_log(next(iter(Path("data/campaigns/practice").glob("**/*.csv"))))
    pd.DataFrame({"time_s": T, "q1_rad": Q[:, 0], "command1_rad": Q[:, 0]}).to_csv(tmp_path / "log.csv", index=False)
    assert is_log(tmp_path / "log.csv")


def test_a_bag_of_more_bytes_than_are_read_is_refused_before_it_is_opened(tmp_path) -> None:
    with (tmp_path / "many.mcap").open("wb") as file:
        file.truncate(500_000_001)
    for path in (tmp_path / "many.mcap", tmp_path):
        (tmp_path / "metadata.yaml").touch()
        with pytest.raises(InputError, match=r"many\.mcap: has 500000001 bytes; at most 500000000 are read"):
            read_log(path)


def test_messages_of_a_topic_are_counted_from_one() -> None:
    times = [10**9, 2 * 10**9]
    stream = {"stamp": times, "received": times, "position": [[0, 1], [2, 3]]}
    log = _of_stream(("/joint_states", "a", "b"), stream, Path("a.mcap"))
    assert (log.row.tolist(), log.time.tolist()) == ([1, 2], [1.0, 2.0])
    assert {name: values.tolist() for name, values in log.channels["position"].items()} == {"a": [0, 2], "b": [1, 3]}

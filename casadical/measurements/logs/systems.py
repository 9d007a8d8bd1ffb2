"""Logs of other systems: SAGE's folders, LeRobot's datasets and ROS bags.

Streams with their own time stamps are merged into one log.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from casadical.core.basics import Array, InputError, optional
from casadical.core.reading import MAX_TABLE_BYTES, foreign, load_json, read_text, regular
from casadical.measurements.logs.columns import Logged, logged
from casadical.measurements.raw_table import RawTable, read_table, refuse_many
from casadical.measurements.table_form import Form, clean

# File of the measured states in a folder of SAGE.
SAGE_STATE_FILE = "state_motor.csv"
# Column of LeRobot's datasets -> its channel.
LEROBOT_CHANNELS = {"action": "command", "observation.state": "position"}


def sage(folder: Path) -> Logged:
    """Return the log in a folder of SAGE: states and, where logged, commands. Raises InputError."""
    names = [clean(line) for line in read_text(folder / "joint_list.txt").splitlines() if line.strip()]
    states = logged(read_table(folder / SAGE_STATE_FILE), listed=names)
    # File of the commands in a folder of SAGE.
    sage_control_file = "control.csv"
    if not (folder / sage_control_file).exists():
        return states
    control = logged(read_table(folder / sage_control_file), listed=names)
    commands = replace(control, channels={"command": control.channels.get("position", {})})
    return replace(joined([states, commands]), source=folder.name)


def lerobot(path: Path, table: RawTable, unit: str | None) -> Logged:
    """Return the log in a Parquet file of a LeRobot dataset.

    unit : of angles, "deg", "rad" or "percent"; None: degrees, if the numbers show it
    Raises InputError where the unit is not given and the numbers do not show it.
    """
    about = next((up / "meta" / "info.json" for up in path.parents[:4] if (up / "meta" / "info.json").exists()), None)
    names: Sequence[str] = ()
    if about:
        features = load_json(about).get("features", {})
        with foreign(f"{about}: not the info.json of a LeRobot dataset"):
            given = features.get("observation.state", features.get("action", {})).get("names") or ()
            listed = given.get("motors", ()) if isinstance(given, dict) else given
            names = [str(name).removesuffix(".pos") for name in listed]
    log = logged(table, listed=names)
    sizes = [np.nanmax(np.abs(column)) for column in log.channels.get("position", {}).values()]
    if not unit and max(sizes, default=0.0) <= 100.0:
        raise InputError(
            f"{path.name}: positions within -100 to 100 are degrees or, as LeRobot writes by "
            "default, per cent of each joint's calibrated range; nothing here says which. Say it "
            "in the table [drive] of the robot file, or of "
            '--drive FILE.toml: log_angles = "deg", or "percent"'
        )
    return replace(log, units=dict.fromkeys(log.units, unit or "deg"))


# Function of topic and message that yields names, channel and values of each channel.
_Reader = Callable[[str, Any], Iterator[tuple[tuple[str, ...], str, Any]]]


# Messages of a bag by topic and the joints or frames that they name: of each message the time stamp
# and the time of receipt [ns] ("stamp" and "received"), and the values of each channel.
_Streams = dict[tuple[str, ...], dict[str, list[Any]]]


def bag(path: Path) -> Logged:
    """Return the joint states and commands of a ROS bag or an MCAP file. Raises InputError."""
    readers = {"JointState": _states, "JointTrajectoryControllerState": _controller}
    streams, topics = _streams(path, readers)
    logs = [_of_stream(key, stream, path) for key, stream in streams.items()]
    if not any("position" in log.channels for log in logs):
        raise InputError(
            f"{path}: no joint states; there are {', '.join(topics) or 'no topics'}; record "
            "/joint_states (sensor_msgs/msg/JointState) and the controller's state, which has the "
            "commands"
        )
    return joined(sorted(logs, key=lambda log: ("position" in log.channels, len(log.time)), reverse=True))


def is_bag(path: Path) -> bool:
    """Return whether a file is a ROS bag or MCAP file by its name, or a folder by metadata.yaml."""
    return path.suffix.lower() in (".db3", ".mcap", ".bag") or (path / "metadata.yaml").exists()


def stations_of_bag(path: Path) -> RawTable:
    """Return a table of the stations in a ROS bag: joint readings at rest, and the mean pose of a target there.

    The poses are those of a transform or pose topic, or of the frame on /tf that a board's or marker's name has.
    Raises InputError: no joint states, no such poses or several, or fewer than five rests.
    """
    from scipy.spatial.transform import Rotation

    posed = dict.fromkeys(("TransformStamped", "PoseStamped", "TFMessage"), _pose)
    streams, topics = _streams(path, {"JointState": _states, **posed})
    poses = {key: stream for key, stream in streams.items() if "pose" in stream}
    # Words in the name of a frame or topic mark it as that of a target.
    target_name = re.compile("board|marker|aruco|tag|checker|chess|target|object")
    boards = {k: v for k, v in poses.items() if target_name.search(" ".join(k))}
    # The frames of a robot's links are on /tf, too.
    poses = boards or {k: v for k, v in poses.items() if not k[0].startswith("/tf")}
    logged = [key for key, stream in streams.items() if "position" in stream]
    if not logged or len(poses) != 1:
        found = "; ".join(" ".join(key) for key in poses) or ", ".join(topics)
        raise InputError(
            f"{path}: needs joint states and one stream of poses of a target (geometry_msgs PoseStamped, "
            f"TransformStamped, or a frame on /tf named for a board, marker or tag); there are {found}"
        )
    ((key, seen),) = poses.items()
    topic, *joints = max(logged, key=lambda key: len(streams[key]["stamp"]))
    states = streams[topic, *joints]
    order = np.argsort(states["stamp"])
    time, q = 1e-9 * np.array(states["stamp"])[order], np.array(states["position"], dtype=float)[order]
    stamps, images = 1e-9 * np.array(seen["stamp"]), np.array(seen["pose"], dtype=float)
    # A joint rests that moves by less than this [rad or m] from a quarter of a second before an image until after it.
    at = [[np.interp(stamps + late, time, column) for column in q.T] for late in (-0.25, 0.0, 0.25)]
    still = (np.ptp(at, axis=0).max(axis=0) < 2e-3) & (stamps > time[0]) & (stamps < time[-1])
    there = np.array(at[1]).T
    begins = still & np.append(True, ~still[:-1] | (np.abs(np.diff(there, axis=0)).max(axis=1) > 2e-3))
    groups = [np.flatnonzero(still & (np.cumsum(begins) == k + 1)) for k in range(int(begins.sum()))]
    if len(groups) < 5:
        raise InputError(
            f"{path}: the joints rested at {len(groups)} stations with images; allowed: five or more, of half a second"
        )
    rows = [
        [*there[g].mean(axis=0), *images[g, :3].mean(axis=0), *Rotation.from_quat(images[g, 3:]).mean().as_quat()]
        for g in groups
    ]
    # Universal Robots' drivers send joints in the order of the alphabet; others number them.
    numbers = [UR_JOINTS.index(n) + 1 if n in UR_JOINTS else int(*re.findall(r"\d+$", n)) for n in joints]
    valid = sorted(numbers) == list(range(1, len(numbers) + 1))
    names = [f"q{k}_rad" if valid else f"{name} [rad]" for k, name in zip(numbers, joints, strict=True)]
    table = pd.DataFrame(rows, columns=[*names, "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"])
    table = table[[f"q{k + 1}_rad" for k in range(len(names))] + list(table.columns[len(names) :])] if valid else table
    said = (
        f"{path.name}: {len(groups)} stations at which the joints of {topic} rested, with {int(still.sum())} "
        f"poses of {' '.join(key)}, their mean at each."
    )
    return RawTable(path, tuple(map(str, table)), (), table, np.arange(len(table)) + 1, Form("bag"), said=(said,))


def _streams(path: Path, readers: Mapping[str, _Reader]) -> tuple[_Streams, list[str]]:
    """Return a bag's streams by topic and what they name, and all topics with their types."""
    needed = f"{path}: reading bags needs rosbags: pip install 'casadical[logs]'"
    highlevel, typesys = optional("rosbags.highlevel", needed), optional("rosbags.typesys", needed)
    for file in (f for f in path.iterdir() if f.exists() and not f.is_dir()) if path.is_dir() else (path,):
        if (size := regular(file).stat().st_size) > MAX_TABLE_BYTES:
            raise InputError(
                f"{file}: has {size} bytes; at most {MAX_TABLE_BYTES} are read: record the joints' topics alone"
            )
    streams: _Streams = {}
    size = 0
    with foreign(f"{path}: not a readable bag", "record it again, or write its joint states to a CSV"):
        store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        with highlevel.AnyReader([path], default_typestore=store) as reader:
            topics = sorted({f"{c.topic} ({c.msgtype})" for c in reader.connections})
            wanted = [c for c in reader.connections if c.msgtype.rsplit("/", 1)[-1] in readers]
            for connection, received, data in reader.messages(wanted) if wanted else ():
                refuse_many(path, (size := size + len(data)) // 8)
                message = reader.deserialize(data, connection.msgtype)
                read = readers[connection.msgtype.rsplit("/", 1)[-1]]
                # A TFMessage has several transforms, each with its own stamp.
                for part in getattr(message, "transforms", [message]):
                    _keep(streams, connection.topic, read, part, received)
    return streams, topics


def _states(topic: str, message: Any) -> Iterator[tuple[tuple[str, ...], str, Any]]:
    """Yield joint names, channel and values for each channel of a JointState message.

    Of topics whose name says so, positions and velocities are commands.
    """
    # Words in the name of a ROS topic that mark its joint states as commands.
    commanded_topic_words = ("command", "desired", "target", "reference", "goal", "leader", "action")
    commanded = any(word in topic.casefold() for word in commanded_topic_words)
    for field, channel in {"position": "position", "velocity": "speed", "effort": "torque"}.items():
        if not commanded or channel != "torque":
            name = {"position": "command", "speed": "command_speed"}[channel] if commanded else channel
            yield tuple(message.name), name, getattr(message, field)


def _controller(_: str, message: Any) -> Iterator[tuple[tuple[str, ...], str, Any]]:
    """Yield joint names, channel and values for each channel of a controller's state message.

    The message is a JointTrajectoryControllerState of ROS 1 or 2.
    """
    # Names of the message's fields in ROS 1 and 2: what was commanded, what was measured; our
    # channels.
    channels = (
        (("reference", "desired"), ("command", "command_speed", "")),
        (("feedback", "actual"), ("position", "speed", "torque")),
    )
    for fields, names in channels:
        point = next((getattr(message, field) for field in fields if hasattr(message, field)), None)
        for values, name in zip(("positions", "velocities", "effort"), names, strict=True):
            if name:
                yield tuple(message.joint_names), name, getattr(point, values, ())


def _pose(_: str, message: Any) -> Iterator[tuple[tuple[str, ...], str, Any]]:
    """Yield frames, "pose", and position [m] and quaternion (x, y, z, w) of a stamped pose or transform."""
    pose = getattr(message, "transform", None) or message.pose
    p, turn = (
        getattr(pose, a, None) or getattr(pose, b)
        for a, b in (("translation", "position"), ("rotation", "orientation"))
    )
    frames = tuple(f for f in (message.header.frame_id, getattr(message, "child_frame_id", "")) if f)
    yield frames, "pose", (p.x, p.y, p.z, turn.x, turn.y, turn.z, turn.w)


# Joints of Universal Robots' arms from the base on.
UR_JOINTS = (
    *("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"),
    *("wrist_1_joint", "wrist_2_joint", "wrist_3_joint"),
)


def _keep(streams: _Streams, topic: str, read: _Reader, message: Any, received: int) -> None:
    """Append a message's stamp and values to the stream of its topic and joints or frames.

    read : reader of its type; received : time of receipt [ns]
    """
    stamp = message.header.stamp
    for k, (names, channel, values) in enumerate(read(topic, message)):
        stream = streams.setdefault((topic, *names), {"stamp": [], "received": []})
        if not k:
            stream["stamp"].append(int(stamp.sec) * 10**9 + int(stamp.nanosec))
            stream["received"].append(received)
        if len(values) == len(names) or channel == "pose":
            stream.setdefault(channel, []).append(values)


def _of_stream(key: tuple[str, ...], stream: dict[str, list[Any]], path: Path) -> Logged:
    """Return a ROS topic's messages as a log, timed by their stamps, else by their receipt [s].

    key : the topic and its joints; stream : see `_Streams`
    """
    (topic, *names), stamps, received = key, np.array(stream["stamp"]), np.array(stream["received"])
    notes = []
    if stamped := bool((stamps > 0).all()):
        late = (received - stamps) * 1e-6
        if abs(np.median(late)) < 1e5:
            low, high = np.quantile(late, (0.05, 0.95))
            span = f"{np.median(late):.1f} ms after the stamp ({low:.1f} to {high:.1f} ms)"
            notes.append(f"{topic}: recorded {span}; the stamps are taken")
    else:
        notes.append(f"{topic}: without stamps; times are those of recording, with its delay and jitter")
    channels = {
        name: dict(zip(names, np.array(rows, dtype=float).T, strict=True))
        for name, rows in stream.items()
        if name not in ("stamp", "received") and len(rows) == len(stamps) and np.any(np.asarray(rows))
    }
    if "torque" in channels:
        notes.append(
            f"{topic}: effort is read as torque [N m]; some drivers write currents there (Universal Robots' "
            'among them): then write log_effort = "current" into the table [drive]'
        )
    units = {(name, joint): "rad" for name, columns in channels.items() for joint in columns}
    row = np.arange(len(stamps)) + 1
    return Logged((stamps if stamped else received) * 1e-9, channels, units, row, path.name, notes=tuple(notes))


def joined(logs: Sequence[Logged]) -> Logged:
    """Return several streams as one log, at the times of the first, with the others' last values.

    Rows before another stream begins are dropped; times count from the first one's start. Raises
    InputError if the streams do not overlap.
    """
    first, *others = logs
    start = first.time[0]
    channels: dict[str, Mapping[str, Array]] = dict(first.channels)
    units, notes, complete = dict(first.units), [*first.notes], np.ones(len(first.time), dtype=bool)
    for other in others:
        last = np.searchsorted(other.time, first.time, side="right") - 1
        more = {name: columns for name, columns in other.channels.items() if {*columns} - {*channels.get(name, ())}}
        if not more:
            continue
        complete &= last >= 0
        for name, columns in more.items():
            channels[name] = {j: c[np.maximum(last, 0)] for j, c in columns.items()} | dict(channels.get(name, {}))
            units |= {(name, joint): other.units.get((name, joint), "") for joint in columns}
        age = 1e3 * (first.time - other.time[np.maximum(last, 0)])[last >= 0]
        if len(age):
            what = ", ".join(name.replace("_", " ") for name in more)
            notes.append(
                f"{what}: of another stream, {np.median(age):.1f} ms (at most {age.max():.0f} ms) before its row"
            )
        notes += [note for note in other.notes if note not in notes]
    if not complete.any():
        raise InputError(f"{first.source}: its streams do not overlap in time; record them together")
    which = np.flatnonzero(complete)
    return replace(
        first,
        time=(first.time - start)[which],
        units=units,
        row=first.row[which],
        notes=tuple(notes),
        channels={n: {j: c[which] for j, c in columns.items()} for n, columns in channels.items()},
        scalars={name: values[which] for name, values in first.scalars.items()},
    )

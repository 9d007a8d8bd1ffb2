"""Poses of a camera: inverted ones are recognised, read so, said and kept; errors of orientation are told."""

import re
import tomllib
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
import yaml
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from casadical import InputError, Measurements, calibrate, identify, read_problem
from casadical.core.parts import Placement
from casadical.core.transforms import frame, from_rpy
from casadical.identification.accuracy import predicted, turn_errors
from casadical.measurements.logs.systems import UR_JOINTS, stations_of_bag
from casadical.project.calibration import Calibration
from casadical.project.check.check import precheck
from casadical.project.check.repair import repaired
from casadical.project.hand_eye import hand_eye_of
from casadical.project.new import new_problem
from casadical.project.robot_columns import as_poses
from casadical.robot.robot import Robot
from casadical.robot.robot_file import robot_from
from casadical.robot.urdf.writing import new_urdf

DH = """joint,a_mm,alpha_deg,d_mm,theta_deg
1,0,90,162.5,0
2,-425,0,0,0
3,-392.2,0,0,0
4,0,90,133.3,0
5,0,-90,99.7,0
6,0,0,99.6,0
"""
JOINTS = [
    {"alpha_deg": 0, "a_mm": 0, "d_mm": 162.5},
    {"alpha_deg": 90, "a_mm": 0, "d_mm": 0},
    {"alpha_deg": 0, "a_mm": -425, "d_mm": 0},
    {"alpha_deg": 0, "a_mm": -392.2, "d_mm": 133.3},
    {"alpha_deg": 90, "a_mm": 0, "d_mm": 99.7},
    {"alpha_deg": -90, "a_mm": 0, "d_mm": 99.6},
]
# The camera on the flange looks along its z axis; its target lies in front of the robot.
HAND_EYE = frame(from_rpy(np.array([0.05, -0.1, 1.5])), np.array([0.04, -0.06, 0.08]))
TARGET = frame(from_rpy(np.array([3.0, 0.1, 0.4])), np.array([-0.5, 0.15, 0.05]))


def ur5e() -> Robot:
    robot = robot_from({"casadical": 1, "name": "arm", "joint": JOINTS}, "arm")
    free = replace(robot.base, unknown="pose"), replace(robot.tool, unknown="pose")
    return replace(robot, base=free[0], tool=free[1])


def seen(inverted: bool, poses: int = 30, seed: int = 0) -> Measurements:
    """Poses of a camera on the flange in the frame of its target, 0.3 to 0.7 m away, or the inverse (of the target)."""
    rng = np.random.default_rng(seed)
    robot = ur5e()
    q = rng.uniform(-2.6, 2.6, (60_000, 6))
    given = replace(robot, base=replace(robot.base, T=np.linalg.inv(TARGET)), tool=replace(robot.tool, T=HAND_EYE))
    m = Measurements(q, "position", position=np.zeros((len(q), 3)))
    p, R = predicted(given, m)
    x, y, z = -np.einsum("nji,nj->in", R, p)  # the target's place in the camera
    near = (z > 0.3) & (z < 0.8) & (np.hypot(x, y) < 0.5 * z)
    p, R, q = p[near][:poses], R[near][:poses], q[near][:poses]
    assert len(q) == poses
    p = p + rng.normal(0, 3e-4, p.shape)
    R = R @ Rotation.from_rotvec(rng.normal(0, 5e-4, p.shape)).as_matrix()
    m = Measurements(q, "pose", position=p, orientation=R, source="poses.csv")
    return replace(m.inverse(), inverted=False) if inverted else m


def written(folder: Path, m: Measurements) -> Path:
    """A table as a script around OpenCV writes it: radians, metres, rotation vectors."""
    vector = Rotation.from_matrix(m.orientation).as_rotvec()
    columns = {f"j{k}": m.q[:, k - 1] for k in range(1, 7)}
    columns |= {f"tvec_{c}": m.position[:, k] for k, c in enumerate("xyz")}
    columns |= {f"rvec_{c}": vector[:, k] for k, c in enumerate("xyz")}
    path = folder / "poses.csv"
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def test_an_inverse_is_the_inverse() -> None:
    m = seen(False)
    twice = m.inverse().inverse()
    np.testing.assert_allclose(twice.position, m.position, atol=1e-12)
    T = [frame(R, p) for R, p in zip(m.orientation, m.position, strict=True)]
    back = m.inverse()
    np.testing.assert_allclose(back.position, [np.linalg.inv(each)[:3, 3] for each in T], atol=1e-12)
    assert (back.inverted, twice.inverted) == (True, False)


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("declared", ["", "in hand"])
def test_poses_are_read_as_the_robot_has_them(inverted: bool, declared: str) -> None:
    m = as_poses(seen(inverted), ur5e(), camera=declared)
    assert m.inverted == inverted
    assert m.camera == "in hand"
    np.testing.assert_allclose(m.position, seen(False).position, atol=1e-12)


def test_a_camera_is_where_errors_of_orientation_do_not_move_its_target() -> None:
    """The board's origin is a far corner, outside of any field of view: by the angle alone it is not told."""
    rng, there = np.random.default_rng(5), seen(False, poses=25).inverse()
    p = there.position + there.orientation @ np.array([0.35, 0.25, 0])
    p = p * (1 + rng.normal(0, 2e-3, (25, 1))) + rng.normal(0, 2e-4, (25, 3))
    turned = Rotation.from_rotvec(rng.normal(0, 4e-3, (25, 3))).as_matrix() @ there.orientation
    m = replace(there, position=p, orientation=turned, inverted=True).inverse()
    off = [np.quantile(np.arctan2(np.hypot(x, y), z), 0.9) for x, y, z in (m.position.T, m.inverse().position.T)]
    assert min(off) > np.deg2rad(50)
    assert as_poses(m, ur5e()).camera == "in hand"


@pytest.mark.parametrize("joints", [False, True])
def test_samples_of_easy_handeye2_need_joint_readings(tmp_path: Path, joints: bool) -> None:
    """The flange's poses, here wrong ones, are not used."""
    m = seen(True)

    def pose(xyz: np.ndarray, xyzw: np.ndarray) -> dict[str, dict[str, float]]:
        parts = {
            "translation": zip("xyz", xyz.tolist(), strict=True),
            "rotation": zip("xyzw", xyzw.tolist(), strict=True),
        }
        return {"header": {"frame_id": "a"}, "transform": {key: dict(part) for key, part in parts.items()}}

    turns = Rotation.from_matrix(m.orientation).as_quat()
    samples = [
        {"robot": pose(p[::-1], turn[::-1]), "optical": pose(p, turn)} | ({"joints": q.tolist()} if joints else {})
        for q, p, turn in zip(m.q, m.position, turns, strict=True)
    ]
    (tmp_path / "cell.samples").write_text(yaml.safe_dump({"samples": samples}))
    (tmp_path / "dh.csv").write_text(DH)
    given = {"dh": tmp_path / "dh.csv", "convention": "standard", "data": tmp_path / "cell.samples"}
    if not joints:
        with pytest.raises(InputError, match="add the readings of /joint_states to each sample"):
            new_problem(tmp_path / "arm", **given)
        return
    ((_, read), *_) = new_problem(tmp_path / "arm", **given).parts()
    assert (read.inverted, read.camera) == (True, "in hand")
    at = [int(np.abs(m.q - q).sum(axis=1).argmin()) for q in read.q]
    np.testing.assert_allclose(read.position, seen(False).position[at], atol=1e-9)


def test_stations_of_a_ros_bag_are_the_rests_of_the_joints(tmp_path: Path) -> None:
    """Joints are named in the order of the alphabet, as UR's driver has them; /tf has the links, too."""
    m, store = seen(True, poses=14), get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    names = sorted(UR_JOINTS)
    turns = Rotation.from_matrix(m.orientation).as_quat()
    with Writer(tmp_path / "bag", version=9) as bag:
        topics = {
            "/joint_states": bag.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store),
            "/tf": bag.add_connection("/tf", "tf2_msgs/msg/TFMessage", typestore=store),
        }

        def write(topic: str, t: float, message: object) -> None:
            bag.write(topics[topic], int(1e9 * t), store.serialize_cdr(message, type(message).__msgtype__))

        def header(t: float, frame_id: str) -> object:
            stamp = types["builtin_interfaces/msg/Time"](sec=int(t), nanosec=int(1e9 * (t % 1)))
            return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)

        def transform(t: float, child: str, p: np.ndarray, turn: np.ndarray) -> object:
            parts = types["geometry_msgs/msg/Vector3"](*p), types["geometry_msgs/msg/Quaternion"](*turn)
            both = types["geometry_msgs/msg/Transform"](*parts)
            return types["geometry_msgs/msg/TransformStamped"](header(t, "camera"), child, both)

        for k in range(280):  # two seconds at each station, the first one of them at rest
            t, (station, part) = 100 + 0.1 * k, divmod(k, 20)
            after = m.q[min(station + 1, 13)]
            q = m.q[station] + max(0, part - 10) / 10 * (after - m.q[station])
            values = [q[list(UR_JOINTS).index(name)] for name in names]
            lists = [np.array(v, dtype=float) for v in (values, [], [])]
            write("/joint_states", t, types["sensor_msgs/msg/JointState"](header(t, ""), names, *lists))
            p = m.position[station] + (0.0 if part <= 10 or station == 13 else 0.3)
            t += 0.01
            both = [transform(t, "charuco_board", p, turns[station]), transform(t, "forearm", p + 1, turns[0])]
            write("/tf", t, types["tf2_msgs/msg/TFMessage"](both))
    table = stations_of_bag(tmp_path / "bag").frame
    np.testing.assert_allclose(table.iloc[:, :6], m.q, atol=1e-9)
    np.testing.assert_allclose(table[["x_m", "y_m", "z_m"]], m.position, atol=1e-9)
    (tmp_path / "dh.csv").write_text(DH)
    given = {"dh": tmp_path / "dh.csv", "convention": "standard", "data": tmp_path / "bag"}
    parts = [m for _, m in new_problem(tmp_path / "arm", **given).parts()]
    assert sum(map(len, parts)) == 14
    assert (parts[0].inverted, parts[0].camera) == (True, "in hand")


def test_new_says_and_keeps_what_the_robot_tells(tmp_path: Path) -> None:
    (tmp_path / "dh.csv").write_text(DH)
    said: list[str] = []
    table = written(tmp_path, seen(True))
    new_problem(
        tmp_path / "arm", dh=tmp_path / "dh.csv", convention="standard", data=table,
        show=lambda block: said.append(getattr(block, "text", "")),
    )  # fmt: skip
    assert any("Each pose is inverted" in text and "eye in hand" in text for text in said)
    (kept,) = tomllib.loads((tmp_path / "arm" / "problem.toml").read_text())["measurements"]
    assert (kept["inverted"], kept["camera"]) == (True, "in hand")
    found = precheck(tmp_path / "arm")
    assert found.ok
    assert any("with each pose inverted" in f.text for f in found.findings)
    problem = tmp_path / "arm" / "problem.toml"
    problem.write_text(re.sub("inverted = true.*\n", "", problem.read_text()))
    assert "+inverted = true" in repaired(precheck(tmp_path / "arm"))
    assert tomllib.loads(problem.read_text())["measurements"][0]["inverted"] is True
    assert not repaired(precheck(tmp_path / "arm"))


def test_a_declared_reading_is_taken_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "dh.csv").write_text(DH)
    folder = tmp_path / "arm"
    new_problem(folder, dh=tmp_path / "dh.csv", convention="standard", data=written(tmp_path, seen(True)))
    text = (folder / "problem.toml").read_text()
    (folder / "problem.toml").write_text(text.replace("inverted = true", "inverted = false"))
    assert not any(m.inverted for _, m in read_problem(folder).parts())
    with pytest.raises(InputError, match="orientations are"):
        calibrate(folder)


@pytest.mark.parametrize(("poses", "bad"), [(15, [4]), (30, [1, 5, 9, 14, 20, 27])])
def test_grossly_wrong_rows_are_left_out_before_they_distort_the_frames(poses: int, bad: list[int]) -> None:
    """A board that was seen elsewhere: one row of 15, a fifth of 30; the rest calibrates as without them."""
    m, rng = seen(False, poses=poses), np.random.default_rng(3)
    position, orientation = m.position.copy(), m.orientation.copy()
    position[bad] += rng.uniform(-1.5, 1.5, (len(bad), 3))
    orientation[bad] = Rotation.random(len(bad), random_state=1).as_matrix()
    found = identify(ur5e(), replace(m, position=position, orientation=orientation), method="KM")
    assert [i for _, i in found.outliers] == bad
    clean = identify(ur5e(), m[np.setdiff1d(np.arange(poses), bad)], method="KM")
    np.testing.assert_allclose(found.robot.tool.T, clean.robot.tool.T, atol=1e-4)


def test_inverted_needs_orientations() -> None:
    with pytest.raises(InputError, match="inverted: has no effect on kind 'position'"):
        as_poses(seen(False).positions_alone(), ur5e(), inverted=True)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    folder = tmp_path_factory.mktemp("camera in hand")
    (folder / "dh.csv").write_text(DH)
    table = written(folder, seen(True, poses=40))
    return calibrate(new_problem(folder / "arm", dh=folder / "dh.csv", convention="standard", data=table))


def test_errors_of_orientation_stand_beside_those_of_position(result: Calibration) -> None:
    (_, report), *_ = [(name, m) for name, m in result.problem.parts() if name == "report"]
    off = Rotation.from_matrix(predicted(result.robot, report)[1].transpose(0, 2, 1) @ report.orientation).magnitude()
    np.testing.assert_allclose(turn_errors(result.robot, report), off, atol=1e-9)
    figures = result.to_json()["methods"]["KM"]["sets"]["report"]
    assert figures["orientation"]["mean_deg"] == pytest.approx(np.rad2deg(off.mean()))
    assert figures["before_placed"]["orientation"]["max_deg"] > 0
    assert f"{figures['orientation']['mean_deg']:.3g} deg" in " ".join(str(result).split())
    assert "deg: mean" in str(result)


def test_the_hand_eye_transform_is_named_and_written(result: Calibration) -> None:
    """With the nominal arm the camera is where it was planted, within its errors; the file is of easy_handeye2."""
    found = result.hand_eye
    assert (found.camera, found.parent) == ("in hand", "flange")
    np.testing.assert_allclose(found.T[:3, 3], HAND_EYE[:3, 3], atol=5 * max(found.std_errors) + 2e-4)
    np.testing.assert_allclose(found.T[:3, :3], HAND_EYE[:3, :3], atol=3e-3)
    assert "Hand-eye (camera in the frame of the flange, eye in hand)" in " ".join(str(result).split())
    assert result.to_json()["hand_eye"]["xyz_mm"] == pytest.approx(1e3 * found.T[:3, 3])
    text = result.files("results")[Path("results/hand_eye.calib")]
    numbers = {line.split(":")[0].strip(): float(line.split(":")[1]) for line in text.splitlines()[-4:]}
    R = Rotation.from_quat([numbers[c] for c in "xyzw"]).as_matrix()
    np.testing.assert_allclose(R, found.T[:3, :3], atol=1e-8)
    assert "calibration_type: eye_in_hand" in text
    nominal = result.hand_eye_nominal
    np.testing.assert_allclose(nominal.T[:3, 3], HAND_EYE[:3, 3], atol=4 * max(nominal.std_errors))
    assert max(nominal.std_errors) < 3e-4
    assert "With the nominal arm" in result.files("results")[Path("results/hand_eye_nominal.calib")]
    assert result.to_json()["hand_eye_nominal"]["xyz_mm"] == pytest.approx(1e3 * nominal.T[:3, 3])


@pytest.mark.parametrize(("camera", "parent"), [("in hand", "measured"), ("to base", "base_link")])
def test_the_camera_is_a_frame_of_the_calibrated_urdf(tmp_path: Path, camera: str, parent: str) -> None:
    (tmp_path / "arm.urdf").write_text(new_urdf(ur5e()))
    table = written(tmp_path, seen(camera == "in hand"))
    problem = new_problem(tmp_path / "arm", urdf=tmp_path / "arm.urdf", data=table, camera=camera)
    given = replace(problem.robot, base=Placement(np.linalg.inv(TARGET), "pose"), tool=Placement(HAND_EYE, "pose"))
    joints = {j.get("name"): j for j in ElementTree.fromstring(problem.calibrated_urdf(given)).iter("joint")}
    joint = joints["casadical_camera_joint"]
    assert joint.find("parent").get("link") == parent
    xyz, rpy = (np.array(joint.find("origin").get(key).split(), dtype=float) for key in ("xyz", "rpy"))
    true = HAND_EYE if camera == "in hand" else TARGET
    np.testing.assert_allclose(frame(Rotation.from_euler("xyz", rpy).as_matrix(), xyz), true, atol=1e-9)


def test_errors_of_a_camera_that_stands_are_of_its_place_not_of_the_base() -> None:
    found = identify(ur5e(), replace(seen(False, poses=40), camera="to base"), ["placement"])
    names = [f"base_{c}" for c in ("x", "y", "z", "rx", "ry", "rz")]
    at = [found.names.index(name) for name in names]
    rng, C = np.random.default_rng(0), found.covariance[np.ix_(at, at)]
    values = found.estimate[at] + rng.multivariate_normal(np.zeros(6), C, size=800)
    T = [np.linalg.inv(found.robot.with_values(dict(zip(names, v, strict=True))).base.T) for v in values]
    assert hand_eye_of(found).std_errors == pytest.approx(np.std(T, axis=0)[:3, 3], rel=0.1)


@pytest.mark.parametrize(("late", "step"), [(0.07, 0.05), (-0.04, 0.05), (0.0, 0.05), (0.07, 0.5)])
def test_images_and_readings_of_a_moving_arm_have_one_clock(late: float, step: float) -> None:
    """Readings at the times of their rows, images taken later; stations far apart in time stay as they are."""
    rng, time = np.random.default_rng(2), step * np.arange(200)
    speed, phase = rng.uniform(0.5, 1.5, 6), rng.uniform(0, 6, 6)

    def path(t: np.ndarray) -> np.ndarray:
        return np.array([0.2, -1.2, 1.4, -1.6, -1.5, 0.1]) + 0.3 * np.sin(np.outer(t, speed) + phase)

    given = replace(ur5e(), base=Placement(np.linalg.inv(TARGET), "pose"), tool=Placement(HAND_EYE, "pose"))
    p, R = predicted(given, Measurements(path(time + late), "position", position=np.zeros((200, 3))))
    p, R = p + rng.normal(0, 1e-3, p.shape), R @ Rotation.from_rotvec(rng.normal(0, 1e-3, p.shape)).as_matrix()
    m = Measurements(path(time), "pose", position=p, orientation=R, conditions={"time_s": time})
    read = as_poses(m, ur5e(), False, "in hand")
    if not late or step > 0.2:
        assert (read.clock_offset, read.clock_in_words) == (0.0, "")
        np.testing.assert_array_equal(read.q, m.q)
        return
    assert read.clock_offset == pytest.approx(late, abs=2e-3)
    np.testing.assert_allclose(read.q, path(time + read.clock_offset), atol=1e-4)
    assert ("ms after" if late > 0 else "ms before") in read.clock_in_words

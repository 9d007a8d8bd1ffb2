"""Drivers' files are read back and composed by scipy's rotations; the inverse kinematics is checked by the model."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from command_line import main as run
from controller_arms import nominal_path, planted, poses
from scipy.spatial.transform import Rotation

from casadical.core.basics import InputError
from casadical.export import Sources, inverse_kinematics
from casadical.export.controller.commands import own_robots
from casadical.export.controller.inverse import Postures
from casadical.export.model_file import driver_file
from casadical.project.new import new_problem
from casadical.project.new.dh_table import robot_text
from casadical.robot.robot_file import read_robot, write_robot


def origin(xyz, rpy):
    T = np.eye(4)
    T[:3, 3], T[:3, :3] = xyz, Rotation.from_euler("xyz", rpy).as_matrix()
    return T


def turned(angle):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", angle).as_matrix()
    return T


def rigid(name):
    """The planted robot without springs, in its own base frame."""
    real = planted(name)
    return own_robots(Sources(real, read_robot(nominal_path(name))))[0]


def stiff(robot):
    return replace(robot, joints=tuple(replace(j, compliance=None) for j in robot.joints))


def model_pose(robot, q):
    T = np.eye(4)
    p, R = robot.pose(q, robot.parameters.values)
    T[:3, 3], T[:3, :3] = p.full()[:, 0], R.full()
    return T


def test_the_ur_drivers_yaml_has_the_calibrated_kinematics():
    real, nominal = planted("ur10"), read_robot(nominal_path("ur10"))
    text, lost = driver_file(Sources(real, nominal), "ur", "calib_1")
    read = yaml.safe_load(text)["kinematics"]
    assert read.pop("hash") == "calib_1"
    assert list(read) == ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"]
    own = stiff(rigid("ur10"))
    for q in poses(own, 20):
        T = np.eye(4)
        for link, angle in zip(read.values(), q, strict=True):
            T = T @ origin([link[k] for k in "xyz"], [link[k] for k in ("roll", "pitch", "yaw")]) @ turned(angle)
        assert np.allclose(T @ own.tool.T, model_pose(own, q), atol=1e-12)
    assert "without them the point is off by" in lost[1]


def test_a_ur_yaml_is_read_as_it_was_written(tmp_path):
    """`new --dh`: the poses are those that scipy composes from the file; another arm's YAML is refused."""
    real, nominal = planted("ur10"), read_robot(nominal_path("ur10"))
    path = tmp_path / "arm.yaml"
    path.write_text(driver_file(Sources(real, nominal), "ur", "calib_1")[0])
    links = yaml.safe_load(path.read_text())["kinematics"]
    new_problem(tmp_path / "arm", dh=path)
    assert "calib_1" in (tmp_path / "arm" / "robot.toml").read_text()
    read = stiff(read_robot(tmp_path / "arm" / "robot.toml"))
    for q in poses(read, 20):
        T = np.eye(4)
        for name, angle in zip(list(links)[:6], q, strict=True):
            T = T @ origin([links[name][k] for k in "xyz"], [links[name][k] for k in ("roll", "pitch", "yaw")])
            T = T @ turned(angle)
        assert np.allclose(T, model_pose(read, q), atol=1e-9)
    path.write_text("kinematics:\n  shoulder: {x: 1}\n")
    with pytest.raises(InputError, match=r"shoulder.*of another arm give --urdf"):
        robot_text(path, "arm", "modified")


def test_the_nominal_yaml_is_the_makers():
    """The UR10's published origins [m]: https://github.com/UniversalRobots/Universal_Robots_ROS2_Description."""
    nominal = read_robot(nominal_path("ur10"))
    read = yaml.safe_load(driver_file(Sources(nominal, nominal), "ur")[0])["kinematics"]
    xyz = [[read[link][k] for k in "xyz"] for link in read]
    assert xyz == pytest.approx(
        np.array([[0, 0, 0.1273], [0, 0, 0], [-0.612, 0, 0], [-0.5723, 0, 0.163941], [0, -0.1157, 0], [0, 0.0922, 0]])
    )
    assert [read[link]["roll"] for link in read][:5] == pytest.approx([0, np.pi / 2, 0, 0, np.pi / 2])
    rows = csv.reader(driver_file(Sources(nominal, nominal), "standard_dh")[0].splitlines())
    assert [[float(v) for v in row[2:4]] for row in rows if row[0].isdecimal()] == pytest.approx(
        np.array([[127.3, 0], [0, -612], [0, -572.3], [163.941, 0], [115.7, 0], [92.2, 0]])
    )


@pytest.mark.parametrize("name", ["ur10", "kr210"])
def test_the_standard_table_has_the_calibrated_kinematics(name):
    real, nominal = planted(name), read_robot(nominal_path(name))
    rows = list(csv.reader(driver_file(Sources(real, nominal), "standard_dh")[0].splitlines()))
    numbers = np.array([[float(v) for v in row[1:5]] for row in rows[1:7]])
    base, tool = (
        origin(np.array(v[:3]) / 1e3, np.deg2rad(v[3:])) for v in ([float(x) for x in row[1:7]] for row in rows[7:])
    )
    own = stiff(rigid(name))
    for q in poses(own, 20):
        T = base
        for (theta, d, a, alpha), angle in zip(numbers, q, strict=True):
            T = T @ turned(np.deg2rad(theta) + angle) @ origin([a / 1e3, 0, d / 1e3], [np.deg2rad(alpha), 0, 0])
        assert np.allclose(T @ tool, model_pose(own, q), atol=2e-8)


def test_other_robots_and_forms_are_refused():
    real = planted("hh800")
    with pytest.raises(InputError, match="four-bar"):
        driver_file(Sources(real, read_robot(nominal_path("hh800"))), "ur")
    kuka = read_robot(nominal_path("kr210"))
    with pytest.raises(InputError, match="those of a UR"):
        driver_file(Sources(kuka, kuka), "ur")
    with pytest.raises(InputError, match="allowed: ur, standard_dh"):
        driver_file(Sources(kuka, kuka), "yaml")


def test_the_command_says_what_is_left_out(tmp_path, monkeypatch, capfd):
    write_robot(planted("ur10"), tmp_path / "real.toml")
    given = ("export", "model", tmp_path / "real.toml", "--nominal", nominal_path("ur10"))
    for form in ("ur", "modified_dh", "xacro"):
        out = tmp_path / form
        assert run(monkeypatch, *given, "--to", form, "--out", out, "--json", tmp_path / "s.json", "--overwrite") == 0
        assert "LEFT OUT compliance of joints 2, 3, 4, 5" in capfd.readouterr().out
        assert json.loads((tmp_path / "s.json").read_text())["form"] == form


@pytest.mark.parametrize("name", ["kr210", "hh800"])
def test_the_inverse_of_the_calibrated_robot_reaches_poses(name):
    real = planted(name)
    q = poses(real, 40)
    goal = np.array([model_pose(real, row) for row in q])
    start = q + np.random.default_rng(0).uniform(-0.05, 0.05, q.shape)
    found = inverse_kinematics(real, goal[:, :3, 3], goal[:, :3, :3], start)
    regular = ~found.singular
    assert regular.mean() > 0.7
    assert found.reached[regular].all()
    reached = np.array([model_pose(real, row) for row in found.q])
    assert np.abs(reached - goal)[found.reached].max() < 2e-6
    only = inverse_kinematics(real, goal[:, :3, 3], None, start)
    assert np.linalg.norm(only.q - start, axis=1).mean() < np.linalg.norm(found.q - start, axis=1).mean()
    assert only.reached.mean() > 0.9


def test_a_wrist_that_is_nearly_straight_is_singular():
    real = planted("kr210")
    q = np.deg2rad([[10, -60, 60, 20, wrist, 0] for wrist in (3, 12)])
    goal = np.array([model_pose(real, row) for row in q])
    assert inverse_kinematics(real, goal[:, :3, 3], goal[:, :3, :3], q).singular.tolist() == [True, False]


def test_the_nearest_solution_has_the_whole_turns_that_its_range_allows():
    """Joint 1 turns from -140 to 140 deg: what came before at 225 deg goes on at -135."""
    robot = read_robot(nominal_path("kr210"))
    q = np.deg2rad([-135, -60, 60, 20, 40, 100])
    postures = Postures(robot, np.eye(4))
    found = postures.nearest(model_pose(robot, q)[None], (q + 2 * np.pi * np.eye(6)[0])[None])[0]
    np.testing.assert_allclose(found, q, atol=1e-6)
    assert postures.why_not == ""
    bent = Postures(read_robot(nominal_path("ur10")), np.eye(4)).why_not
    assert "miss each other by 116 mm" in bent  # its d5


def test_an_inverse_out_of_reach_says_so():
    real = planted("kr210")
    q = poses(real, 1)
    goal = model_pose(real, q[0])
    far = inverse_kinematics(real, goal[:3, 3] + [9, 0, 0], goal[None, :3, :3], q[0])
    assert not far.reached[0]
    assert far.rest_m[0] > 1
    assert np.isfinite(far.q).all()
    with pytest.raises(InputError, match=r"expected \(k, 3\)"):
        inverse_kinematics(real, np.zeros((2, 3)), np.zeros((1, 3, 3)), q[0])

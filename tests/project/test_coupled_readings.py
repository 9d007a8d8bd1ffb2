"""Joints without an encoder: mimic and passive joints follow others, a locked one stands still."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from casadical import InputError, calibrate, read_problem, read_robot, read_urdf, select_poses
from casadical.core.parts import Coupling
from casadical.identification.accuracy import predicted
from casadical.project.new import new_problem
from casadical.robot.robot_file import write_robot

HEAD = """\
casadical = 1
name = "palletiser"
[base]
unknown = "pose"
[tool]
xyz_mm = [80, 30, 40]
unknown = "position"
[[joint]]
d_mm = 300
limits_deg = [-170, 170]
[[joint]]
alpha_deg = 90
a_mm = 100
limits_deg = [-60, 80]
[[joint]]
a_mm = 500
limits_deg = [-90, 60]
[[joint]]
a_mm = 450
"""
LAST = """\
[[joint]]
alpha_deg = 90
limits_deg = [-170, 170]
"""
WRIST = "follows = [[2, -1], [3, -1.0]]\nat_deg = 10\n"
PROBLEM = """\
casadical = 1
title = "palletiser"
data = "synthetic"
methods = ["KM"]
[[measurements]]
file = "poses.csv"
"""


def folder_with(folder: Path, wrist: str, columns: list[str]) -> Path:
    """A problem of a palletiser, whose table has these columns of readings."""
    (folder / "robot.toml").write_text(HEAD + wrist + LAST)
    (folder / "problem.toml").write_text(PROBLEM)
    robot = read_robot(folder / "robot.toml")
    rng = np.random.default_rng(2)
    q = np.deg2rad(rng.uniform([-90, -50, -80, -90, -90], [90, 70, 50, 90, 90], (60, 5)))
    q = robot.coupled(q)
    built = robot.with_values({"a2": 0.501, "theta3": 0.002, "base_x": 0.2})
    p = np.array([np.asarray(built.position(row, built.parameters.values)).ravel() for row in q])
    table = pd.DataFrame(np.rad2deg(q), columns=[f"q{i}_deg" for i in range(1, 6)])[columns]
    table[["x_mm", "y_mm", "z_mm"]] = 1e3 * p + rng.normal(0, 0.02, p.shape)
    table.to_csv(folder / "poses.csv", index=False)
    return folder


OTHERS = ["q1_deg", "q2_deg", "q3_deg", "q5_deg"]


def test_a_passive_wrist_has_no_column(tmp_path: Path) -> None:
    problem = read_problem(folder_with(tmp_path, WRIST, OTHERS))
    q = np.concatenate([m.q for _, m in problem.parts()])
    np.testing.assert_allclose(q[:, 3], np.deg2rad(10) - q[:, 1] - q[:, 2], atol=1e-12)
    found = calibrate(problem)
    assert found.accuracies["KM"]["report"]["calibrated"].mean < 6e-5
    assert found.identification.robot.parameters["a2"].value == pytest.approx(0.501, abs=1e-4)
    write_robot(found.identification.robot, tmp_path / "again.toml")
    again = read_robot(tmp_path / "again.toml").joints[3].coupling
    assert again.follows == ((2, -1.0), (3, -1.0))
    assert again.at == pytest.approx(np.deg2rad(10))


def test_a_locked_joint_stands_where_the_file_says(tmp_path: Path) -> None:
    problem = read_problem(folder_with(tmp_path, "at_deg = 25\n", OTHERS))
    assert all(np.allclose(m.q[:, 3], np.deg2rad(25)) for _, m in problem.parts())


def test_a_locked_joint_that_moves_is_refused(tmp_path: Path) -> None:
    folder = folder_with(tmp_path, "at_deg = 25\n", [*OTHERS[:3], "q4_deg", "q5_deg"])
    read_problem(folder)  # logged, and where it should be
    table = pd.read_csv(folder / "poses.csv")
    table.loc[4, "q4_deg"] = 26.0
    table.to_csv(folder / "poses.csv", index=False)
    message = r"row 6, column q4: 26 deg, and by the robot file joint 4 is locked at 25 deg: no pose can be computed"
    with pytest.raises(InputError, match=message):
        read_problem(folder)


def test_a_joint_follows_only_joints_with_readings(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"joint\[4\]\.follows: joint 7; allowed: 1, 2, 3, 5"):
        folder_with(tmp_path, "follows = [[7, 1.0]]\n", OTHERS)


@pytest.mark.parametrize("follows", ["[2]", "[[2]]", "[[2, 'x']]", "3", "[['a', 1.0]]", "[[2.5, 1.0]]"])
def test_what_is_no_list_of_pairs_is_refused(follows: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"joint\[4\]\.follows"):
        folder_with(tmp_path, f"follows = {follows}\n", OTHERS)


URDF = """\
<robot name="column">
  <link name="a"/><link name="b"/><link name="c"/><link name="d"/>
  <joint name="lift" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.5" effort="1" velocity="1"/></joint>
  <joint name="second" type="prismatic"><parent link="b"/><child link="c"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.5" effort="1" velocity="1"/><mimic joint="lift" multiplier="0.5" offset="0.1"/></joint>
  <joint name="turn" type="revolute"><parent link="c"/><child link="d"/><origin xyz="0.1 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
</robot>
"""


@pytest.mark.parametrize("readings", [None, Coupling(((2, 1.0), (3, -1.0)), 0.2)])
def test_chosen_poses_are_coupled(tmp_path: Path, readings: Coupling | None) -> None:
    (tmp_path / "robot.toml").write_text(HEAD + WRIST + LAST)
    robot = read_robot(tmp_path / "robot.toml")
    a, b, third, *others = robot.joints
    robot = replace(robot, joints=(a, b, replace(third, readings=readings), *others))
    J = robot.readings_of(select_poses(robot, None, 8, pool=30, restarts=1, free=["geometry"]).q)
    np.testing.assert_allclose(J[:, 3], np.deg2rad(10) - J[:, 1] - J[:, 2], atol=1e-12)


def test_mimic_of_a_urdf_is_read(tmp_path: Path) -> None:
    pytest.importorskip("yourdfpy")
    (tmp_path / "robot.urdf").write_text(URDF)
    robot = read_urdf(tmp_path / "robot.urdf")
    assert [j.coupling for j in robot.joints] == [None, Coupling(((1, 0.5),), 0.1), None]
    np.testing.assert_allclose(robot.coupled([[0.2, 9.0, 0.3]]), [[0.2, 0.2, 0.3]])


def lift_urdf(jaw: str = "") -> str:
    """A column of stages s1 and s2, driven by a motor beside it, then joints t1 and t2 that turn."""

    def joint(name: str, kind: str, parent: str, child: str, axis: str, mimic: str = "") -> str:
        limit = '<limit lower="-2" upper="2" effort="1" velocity="1"/><origin xyz="0.2 0 0"/>'
        ends = f'<parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>'
        return f'<joint name="{name}" type="{kind}">{ends}{limit}{mimic}</joint>'

    chain = [
        joint("motor", "prismatic", "a", "m", "0 0 1"),
        joint("s1", "prismatic", "a", "b", "0 0 1", '<mimic joint="motor" multiplier="0.5"/>'),
        joint("s2", "prismatic", "b", "c", "0 0 1", '<mimic joint="motor" multiplier="0.25" offset="0.1"/>'),
        joint("t1", "revolute", "c", "d", "0 0 1"),
        joint("t2", "revolute", "d", "e", "0 1 0"),
    ]
    links = "abcdem" + "f" * bool(jaw)
    return f'<robot name="lift">{"".join(f"<link name={q!r}/>" for q in links)}{"".join(chain)}{jaw}</robot>'


@pytest.mark.parametrize(("heading", "unit"), [("motor", 1.0), ("motor [mm]", 1e3), ("Motor pos (cm)", 100.0)])
def test_a_leader_beside_the_chain_drives_its_followers(heading: str, unit: float, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    motor, (t1, t2) = rng.uniform(0.2, 1, 30), rng.uniform(-1.5, 1.5, (2, 30))
    h = 0.5 * motor + 0.25 * motor + 0.1  # of the closed form: the tip turns about points 0.2 m apart
    p = np.column_stack([0.6 + 0.2 * np.cos(t1), 0.2 * np.sin(t1), h])
    (tmp_path / "lift.urdf").write_text(lift_urdf())
    table = pd.DataFrame({heading: unit * motor, "t1": t1, "t2": t2, "x_m": p[:, 0], "y_m": p[:, 1], "z_m": p[:, 2]})
    table.round(9).to_csv(tmp_path / "poses.csv", index=False)
    problem = new_problem(tmp_path / "arm", urdf=tmp_path / "lift.urdf", data=tmp_path / "poses.csv")
    q = problem.whole[0].q
    np.testing.assert_allclose(q[:, 1], 0.25 * motor + 0.1, atol=1e-8)
    np.testing.assert_allclose(q[:, 0], 0.5 * motor, atol=1e-8)
    np.testing.assert_allclose(predicted(problem.robot, problem.whole[0])[0] - p, 0, atol=1e-7)


def test_the_one_missing_column_is_named_with_the_way_to_leave_a_gripper_out(tmp_path: Path) -> None:
    jaw = (
        '<joint name="jaw" type="prismatic"><parent link="e"/><child link="f"/><axis xyz="0 1 0"/>'
        '<limit lower="0" upper="0.04" effort="1" velocity="1"/></joint>'
    )
    (tmp_path / "lift.urdf").write_text(lift_urdf(jaw))
    (tmp_path / "poses.csv").write_text("motor,t1,t2,x_m,y_m,z_m\n" + "0.5,0.1,0.2,0.3,0.1,0.2\n" * 3)
    with pytest.raises(InputError, match=r"readings of joint 5 'jaw' \(prismatic\); .*--tip-link e; .*<mimic>"):
        new_problem(tmp_path / "arm", urdf=tmp_path / "lift.urdf", data=tmp_path / "poses.csv")

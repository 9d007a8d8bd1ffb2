"""A robot on a platform that tilts: gravity's direction from an inclinometer or an accelerometer at its base."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from casadical import InputError, identify, read_problem, read_robot
from casadical.core.transforms import rot_x, rot_y
from casadical.identification.accuracy import errors, predicted
from casadical.identification.pose_selection.planning import plan
from casadical.measurements.measurements import unmeasured
from casadical.measurements.reading import from_table
from casadical.robot.robot_file import to_toml

ROBOT = """\
casadical = 1
name = "arm on a platform"
[base]
unknown = "pose"
[tool]
xyz_mm = [150, 0, 80]
unknown = "position"
[gravity]
frame = "logged"
[[joint]]
d_mm = 300
limits_deg = [-170, 170]
body = { mass_kg = 20, com_mm = [0, 0, -50] }
[[joint]]
alpha_deg = -90
limits_deg = [-120, 60]
stiffness_Nm_per_rad = 60000
body = { mass_kg = 15, com_mm = [250, 0, 0] }
[[joint]]
a_mm = 500
limits_deg = [-120, 120]
stiffness_Nm_per_rad = 40000
body = { mass_kg = 8, com_mm = [150, 0, 0] }
"""
READINGS = ["q1_deg", "q2_deg", "q3_deg"]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "robot.toml").write_text(ROBOT)
    return tmp_path / "robot.toml"


@pytest.fixture
def table(file: Path) -> pd.DataFrame:
    """Each pose by a robot of its own whose gravity is written into its file, the base tilted by up to 25 degrees."""
    robot, rng = read_robot(file), np.random.default_rng(0)
    q, tilt = rng.uniform(-1, 1, (60, 3)), rng.uniform(-25, 25, (60, 2))
    points = []
    for reading, (x, y) in zip(q, np.deg2rad(tilt), strict=True):
        turn = np.array(rot_x(x) @ rot_y(y))[:3, :3]
        there = replace(robot, gravity_frame="base", gravity=turn.T @ np.array([0, 0, -9.80665]))
        points.append(predicted(there.with_values({"c2": 1 / 30000}), unmeasured(reading[None]))[0][0])
    found = pd.DataFrame(np.rad2deg(q), columns=READINGS).assign(tilt_x_deg=tilt[:, 0], tilt_y_deg=tilt[:, 1])
    found[["x_mm", "y_mm", "z_mm"]] = 1e3 * np.array(points) + rng.normal(0, 0.01, (60, 3))
    return found


def accelerometer(table: pd.DataFrame) -> pd.DataFrame:
    """The same tilts as an accelerometer in the base frame reads them, in its own unit."""
    x, y = np.deg2rad(table[["tilt_x_deg", "tilt_y_deg"]].to_numpy()).T
    turns = [np.array(rot_x(a) @ rot_y(b))[:3, :3] for a, b in zip(x, y, strict=True)]
    down = np.array([1023 * turn.T @ [0, 0, -1] for turn in turns])
    return table.drop(columns=["tilt_x_deg", "tilt_y_deg"]).assign(
        gravity_x=down[:, 0], gravity_y=down[:, 1], gravity_z=down[:, 2]
    )


@pytest.mark.parametrize("logged", [pd.DataFrame, accelerometer], ids=["inclinometer", "accelerometer"])
def test_the_load_turns_with_the_base(file: Path, table: pd.DataFrame, logged) -> None:
    robot, m = read_robot(file), from_table(logged(table), 3)
    found = identify(robot, m)
    assert errors(found.robot, m).mean() < 2e-5
    assert found.robot.parameters["c2"].value == pytest.approx(1 / 30000, rel=0.02)
    # Taken for a base that stands still, the same data are deflected the wrong way.
    still = identify(replace(robot, gravity_frame="base"), m)
    assert errors(still.robot, m).mean() > 1e-4


def test_the_file_says_it_again(file: Path, tmp_path: Path) -> None:
    robot = read_robot(file)
    (tmp_path / "again.toml").write_text(to_toml(robot))
    assert read_robot(tmp_path / "again.toml").gravity_frame == "logged"
    assert robot.conditions == ("gravity_x", "gravity_y", "gravity_z")
    # Where nothing was logged, it stands level.
    level = replace(robot, gravity_frame="base")
    q = unmeasured(np.array([[0.3, -0.4, 0.8]]))
    assert predicted(robot, q)[0] == pytest.approx(predicted(level, q)[0], abs=1e-12)


def test_a_table_that_does_not_say_it_is_refused(file: Path, table: pd.DataFrame) -> None:
    bare = table.drop(columns=["tilt_x_deg"])
    bare.to_csv(file.parent / "poses.csv", index=False)
    with pytest.raises(InputError, match="log tilt_x_deg and tilt_y_deg of its base, or gravity_x"):
        read_problem(file, tables=[file.parent / "poses.csv"])
    table.to_csv(file.parent / "poses.csv", index=False)
    (kept,) = read_problem(file, tables=[file.parent / "poses.csv"]).sets["identify"]
    assert {"gravity_x", "tilt_x_deg"} <= kept.conditions.keys()


def test_poses_are_planned_for_a_level_base(file: Path, table: pd.DataFrame) -> None:
    planned = plan(read_robot(file), 6, measured=from_table(table, 3), order=False).selection
    assert planned is not None
    assert planned.m.conditions["gravity_z"] == pytest.approx(-1)


def test_an_accelerometer_that_reads_nothing_is_refused_with_its_row(table: pd.DataFrame) -> None:
    dead = accelerometer(table)
    dead.loc[4, ["gravity_x", "gravity_y", "gravity_z"]] = 0.0
    with pytest.raises(InputError, match=r"row 6.*all zero"):
        from_table(dead, 3)

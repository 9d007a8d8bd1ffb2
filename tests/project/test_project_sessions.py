"""A problem folder with a table for each session."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from casadical import InputError, calibrate, read_problem, read_robot
from casadical.identification.pose_selection.planning import plan
from casadical.project.acceptance.verification import verify
from casadical.project.check.check import precheck
from casadical.project.problem import read_campaign

ROBOT = """\
casadical = 1
name = "three turning joints"
[base]
unknown = "pose"
[tool]
xyz_mm = [200, 0, 50]
unknown = "position"
[[joint]]
limits_deg = [-170, 170]
[[joint]]
alpha_deg = 90
a_mm = 100
limits_deg = [-90, 90]
[[joint]]
alpha_deg = 90
a_mm = 300
limits_deg = [-170, 170]
"""
PROBLEM = """\
casadical = 1
title = "two sessions"
data = "synthetic"
methods = ["KM"]
[[measurements]]
file = "May.csv"
session = "May"
[[measurements]]
file = "June.csv"
session = "June"
[sets]
seed = 0
identify = 0.7
report = 0.3
[sessions]
zeros = "shared"
"""


def table(robot, q: np.ndarray, seed: int) -> pd.DataFrame:
    p = np.array([np.asarray(robot.position(row, robot.parameters.values)).ravel() for row in q])
    found = pd.DataFrame(np.rad2deg(q), columns=["q1_deg", "q2_deg", "q3_deg"])
    found[["x_mm", "y_mm", "z_mm"]] = 1e3 * p + np.random.default_rng(seed).normal(0, 0.02, p.shape)
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "robot.toml").write_text(ROBOT)
    (tmp_path / "problem.toml").write_text(PROBLEM)
    robot = read_robot(tmp_path / "robot.toml")
    built = robot.with_values({"a1": 0.101, "theta2": 0.002, "base_x": 0.3, "base_rz": 0.2})
    moved = robot.with_values({"a1": 0.101, "theta2": 0.002, "base_x": -1.0, "base_ry": 0.3, "tool_y": 0.01})
    q = np.random.default_rng(3).uniform(-1.4, 1.4, (80, 3))
    table(built, q[:40], 1).to_csv(tmp_path / "May.csv", index=False)
    table(moved, q[40:], 2).to_csv(tmp_path / "June.csv", index=False)
    return tmp_path


def test_sessions_are_calibrated_together_and_the_file_holds_the_first(folder: Path) -> None:
    found = calibrate(folder)
    sets = found.accuracies["KM"]
    assert all(states["calibrated"].mean < 6e-5 for states in sets.values())

    found.write(folder / "out")
    again = read_robot(folder / "out" / "KM.robot.toml")
    assert again.effects == ()
    assert again.parameters["a1"].value == pytest.approx(0.101, abs=5e-5)


def test_a_session_that_only_held_out_poses_have_is_refused(folder: Path) -> None:
    (folder / "problem.toml").write_text(
        PROBLEM.replace("seed = 0\nidentify = 0.7\nreport = 0.3", 'column = "set"').replace('zeros = "shared"', "")
    )
    for name, word in (("May", "identify"), ("June", "report")):
        pd.read_csv(folder / f"{name}.csv").assign(set=word).to_csv(folder / f"{name}.csv", index=False)
    with pytest.raises(InputError, match="session 'June' has poses of the set 'report' only"):
        calibrate(folder)


def test_what_is_anew_is_one_of_two_words(folder: Path) -> None:
    (folder / "problem.toml").write_text(PROBLEM.replace('"shared"', '"free"'))
    with pytest.raises(InputError, match=r"sessions\.zeros"):
        read_problem(folder)


@pytest.mark.slow
def test_sessions_are_known_to_the_check_the_verification_and_the_plan(folder: Path) -> None:
    both = pd.concat([pd.read_csv(folder / f"{name}.csv").assign(session=name) for name in ("May", "June")])
    both.to_csv(folder / "both.csv", index=False)
    # Taken for one session, base and tool moved between them contradict the robot.
    both.drop(columns="session").to_csv(folder / "one.csv", index=False)
    robot = folder / "robot.toml"
    assert precheck(robot, tables=[folder / "both.csv"]).ok
    assert not precheck(robot, tables=[folder / "one.csv"]).ok

    calibrate(robot, tables=[folder / "both.csv"]).write(folder / "out")
    calibrated = folder / "out" / "KM.robot.toml"
    assert verify(calibrated, folder / "both.csv").valid
    with pytest.raises(InputError, match="does not fit"):
        verify(calibrated, folder / "one.csv")

    nominal, m = read_robot(robot), read_campaign(robot, folder / "both.csv", read_robot(robot))
    further = plan(nominal, 5, measured=m, order=False).selection
    assert further is not None
    # Further poses are measured in the last session.
    assert set(further.m.conditions["session_June"]) == {1.0}

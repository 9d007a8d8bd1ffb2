"""How a controller counts its joints (`readings` of a robot file) holds in every command."""

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd
import pytest
import tomlkit
from command_line import ROOT, main, own_planar

from casadical import calibrate, read_problem, read_robot, read_urdf, write_robot
from casadical.core.parts import Coupling, Placement
from casadical.export.controller.inverse import Postures
from casadical.export.mjcf.mjcf import mjcf
from casadical.measurements.columns import Source
from casadical.measurements.logs.reading import read_log
from casadical.project.check.repair import repaired_columns
from casadical.project.check.slip_fit import Fit, Hypothesis
from casadical.project.problem import read_campaign, read_campaign_robot, read_problem_robot
from casadical.robot.robot_file import to_toml
from casadical.robot.urdf import new_urdf


def counted(q: np.ndarray) -> np.ndarray:
    """The controller's readings [deg] of the rows' angles q, shape (n, 2): q2 = -J2 - J1 + 20 deg."""
    return np.column_stack([q[:, 0], 20 - q[:, 1] - q[:, 0]])


def arms(folder: Path) -> tuple[Path, Path]:
    """The planar arm, and the same arm of which the table has the readings of another controller."""
    plain, other = own_planar(folder / "plain"), own_planar(folder / "other")
    table = pd.read_csv(other / "poses.csv")
    table[["q1_deg", "q2_deg"]] = counted(table[["q1_deg", "q2_deg"]].to_numpy())
    table.to_csv(other / "poses.csv", index=False)
    document = tomlkit.parse((other / "robot.toml").read_text())
    document["joint"][1].update({"readings": [[2, -1], [1, -1]], "offset_deg": 20})
    (other / "robot.toml").write_text(tomlkit.dumps(document))
    return plain, other


def test_tables_correction_c_and_later_commands_take_the_controllers_readings(tmp_path, monkeypatch, capfd):
    plain, other = arms(tmp_path)
    figures, corrected = [], []
    program = np.random.default_rng(0).uniform(-60, 60, (6, 2))
    for folder, q in ((plain, program), (other, counted(program))):
        out = folder / "results"
        calibrate(folder).write(out)
        found = json.loads((out / "result.json").read_text())["methods"]["KM"]["sets"]["report"]
        pd.DataFrame(q, columns=["q1_deg", "q2_deg"]).to_csv(folder / "program.csv", index=False)
        target = folder / "corrected.csv"
        assert main(monkeypatch, "correct", out, folder / "program.csv", "--nominal", folder, "--out", target) == 0
        corrected.append(pd.read_csv(target)[["q1_deg", "q2_deg"]].to_numpy())
        assert main(monkeypatch, "verify", out, folder / "poses.csv", "--json", folder / "v.json") == 0
        figures.append((found["mean_mm"], json.loads((folder / "v.json").read_text())["found_rms_mm"]))
    assert figures[1] == pytest.approx(figures[0], rel=1e-6)
    assert np.abs(corrected[0] - program).max() > 0.01
    assert np.abs(corrected[1] - counted(corrected[0])).max() < 1e-4
    c = (other / "c", "--nominal", other / "robot.toml")
    assert main(monkeypatch, "export", "c", other / "results", "--out", *c) == 0
    assert "q2 = -J1 -J2 +20 deg" in " ".join(capfd.readouterr().out.split())
    by_c = other / "by_c.csv"
    assert main(monkeypatch, "correct", other / "c", other / "program.csv", "--out", by_c) == 0
    assert np.abs(pd.read_csv(by_c)[["q1_deg", "q2_deg"]].to_numpy() - corrected[1]).max() < 2e-3


def test_a_diagnosed_robot_reads_later_tables_as_the_problem_does(tmp_path, monkeypatch, capfd):
    """Columns in another unit, of which the robot file says nothing."""
    _, other = arms(tmp_path)
    table = pd.read_csv(other / "poses.csv")
    table["q1_deg"] = np.deg2rad(table["q1_deg"])
    table.to_csv(other / "poses.csv", index=False)
    problem = (other / "problem.toml").read_text().replace("[sets]", 'columns = { q1_rad = "q1_deg" }\n[sets]')
    (other / "problem.toml").write_text(problem)
    found, table = tmp_path / "found", other / "poses.csv"
    assert main(monkeypatch, "diagnose", other, "--effects", "backlash", "--out", found, "-q") == 0
    later = table.rename(tmp_path / "later.csv")
    assert main(monkeypatch, "verify", found / "diagnosed.robot.toml", later) == 0
    assert "STILL VALID" in capfd.readouterr().out


def test_a_log_is_in_readings(tmp_path: Path) -> None:
    """Angles and speeds are those of the rows, and the power of the drives is the same."""
    _, other = arms(tmp_path)
    time = np.arange(0, 4, 0.01)
    q = np.rad2deg(np.column_stack([np.sin(time), np.cos(2 * time)]))
    J, force = counted(q), np.column_stack([np.cos(time), np.sin(3 * time)])
    names = ["time", "joint1_position_deg", "joint2_position_deg", "joint1_torque", "joint2_torque"]
    pd.DataFrame(np.column_stack([time, J, force]), columns=names).to_csv(tmp_path / "log.csv", index=False)
    log = read_log(tmp_path / "log.csv", read_problem(other).robot)
    assert np.rad2deg(log.position) == pytest.approx(q, abs=1e-6)
    power = (np.gradient(np.deg2rad(J), axis=0) * force).sum(axis=1)
    assert (np.gradient(log.position, axis=0) * log.torque).sum(axis=1) == pytest.approx(power, abs=1e-9)


def test_a_lost_reading_loses_its_row_alone(tmp_path: Path) -> None:
    _, other = arms(tmp_path)
    robot = read_problem(other).robot
    table = pd.read_csv(other / "poses.csv").astype(object)
    table.loc[3, "q2_deg"], table.loc[5, "q2_deg"] = "", "n/a"
    table.to_csv(other / "later.csv", index=False)
    assert read_campaign(other, other / "later.csv", robot, later=True, words=True).lost == (5, 7)


def test_a_plan_is_in_readings_and_the_file_keeps_them(tmp_path, monkeypatch):
    _, other = arms(tmp_path)
    robot = read_problem(other).robot
    q = np.random.default_rng(1).uniform(-1, 1, (4, 2))
    assert robot.variables_of(robot.readings_of(q)) == pytest.approx(q)
    assert np.rad2deg(robot.readings_of(q)) == pytest.approx(counted(np.rad2deg(q)))
    (tmp_path / "again.toml").write_text(to_toml(robot))
    assert read_robot(tmp_path / "again.toml").readings_in_words == "q2 = -J1 -J2 +20 deg"
    lower, upper = robot.reading_limits
    inside = robot.readings_of(np.random.default_rng(2).uniform(*robot.limits, (500, 2)))
    assert ((inside > lower) & (inside < upper)).all()
    assert main(monkeypatch, "plan", other, "-n", "12", "--out", tmp_path / "next.csv", "-q") == 0
    planned = pd.read_csv(tmp_path / "next.csv")
    model = robot.position(
        robot.variables_of(np.deg2rad(planned[["q1_deg", "q2_deg"]].to_numpy()))[0], robot.parameters.values
    )
    nominal = planned[["nominal_x_mm", "nominal_y_mm", "nominal_z_mm"]].to_numpy()[0]
    assert 1e3 * np.array(model).ravel() == pytest.approx(nominal, abs=1e-3)


def test_a_configuration_is_that_of_the_controllers_readings() -> None:
    """Axes 1 and 5 are reversed: the sign of axis 5 is the controller's, where the arm stands is not changed."""
    plain = replace(read_problem_robot(ROOT / "problems" / "kr210").rigid, tool=Placement(np.eye(4)))
    reversed_ = [i in (0, 4) for i in range(6)]
    joints = zip(plain.joints, reversed_, strict=True)
    turned = replace(
        plain,
        joints=tuple(replace(j, readings=Coupling(((i, -1.0),))) if r else j for i, (j, r) in enumerate(joints, 1)),
    )
    q = np.random.default_rng(0).uniform(*plain.limits, (50, 6))
    J = q * np.where(reversed_, -1, 1)
    before, after = (Postures(robot, np.eye(4)).sides(at) for robot, at in ((plain, q), (turned, J)))
    assert (after[:, :2] == before[:, :2]).all()
    assert (after[:, 2] == (J[:, 4] < 0)).all()
    T = np.eye(4)
    p, T[:3, :3] = plain.pose(q[0], plain.parameters.values)
    T[:3, 3] = np.array(p).ravel()
    found = Postures(turned, np.eye(4)).solutions(T, tuple(after[0].tolist()), lambda _: (), ())
    assert np.abs(found - J[0]).max(axis=1).min() < 1e-6


PALLETISER = """<robot name="p"><link name="base"/><link name="l1"/><link name="l2"/><link name="l3"/>
<link name="hand"/>
<joint name="turn" type="revolute"><parent link="base"/><child link="l1"/><origin xyz="0 0 .4"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="1" velocity="1"/><calibration rising="0.5"/></joint>
<joint name="lift" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz=".2 0 0"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="wrist" type="revolute"><parent link="l2"/><child link="l3"/><origin xyz=".9 0 0"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/><mimic joint="lift" multiplier="-1"/></joint>
<joint name="end" type="fixed"><parent link="l3"/><child link="hand"/><origin xyz=".3 0 .1"/></joint></robot>"""
URDF = """gravity = { frame = "logged" }
drive = { friction_Nm = 1.5 }
payload = { mass_kg = 2, com_mm = [0, 0, 50] }
width = { body = { mass_share = 0.1 } }
masses = "estimated"
joint = [{ name = "lift", readings = [[2, -1]], offset_deg = 90 }]
"""


def test_a_urdf_says_in_problem_toml_what_it_has_no_place_for(tmp_path: Path, monkeypatch) -> None:
    pytest.importorskip("yourdfpy", reason="the extra urdf is not installed")
    (tmp_path / "arm.urdf").write_text(PALLETISER)
    (tmp_path / "problem.toml").write_text(
        f'casadical = 1\ntitle = "t"\nrobot = "arm.urdf"\n[urdf]\ntip_link = "hand"\n{URDF}'
    )
    robot = read_campaign_robot(tmp_path)
    assert (robot.gravity_frame, robot.drive.friction, robot.body_width.mass_share, robot.masses) == (
        *("logged", 1.5, 0.1, "estimated"),
    )
    flange = robot.tool.T  # the payload's centre is given in the tip link
    assert robot.payload.com == pytest.approx(flange[:3, :3] @ [0, 0, 0.05] + flange[:3, 3])
    assert robot.readings_in_words == "q2 = -J2 +90 deg"
    assert any("<calibration> of turn" in note for note in robot.notes)
    # A passive joint has no column, which a repair would have to change.
    known = {name: Source(name) for name in ("q1_rad", "q2_rad")}
    assert repaired_columns(Fit(Hypothesis.none(3).at("sign", 1, -1), 0.0), robot, known) == {}
    # The URDF itself is read as the folder beside it says; a new one keeps names, limits and <mimic>.
    assert read_campaign_robot(tmp_path / "arm.urdf").readings_in_words == robot.readings_in_words
    (tmp_path / "new.urdf").write_text(new_urdf(robot))
    again = read_urdf(tmp_path / "new.urdf", tip_link="measured")
    assert [j.name for j in again.joints] == ["turn", "lift", "wrist"]
    assert again.joints[2].coupling.follows == ((2, -1.0),)
    assert np.array(again.limits) == pytest.approx(np.array(robot.limits))
    write_robot(robot, tmp_path / "robot.toml")
    for nominal in (tmp_path, tmp_path / "arm.urdf"):
        c = (tmp_path / "c", "--nominal", nominal, "--overwrite", "-q")
        assert main(monkeypatch, "export", "c", tmp_path / "robot.toml", "--out", *c) == 0
    assert [node.get("name") for node in ET.fromstring(mjcf(robot).text).iter("joint")][1:] == ["turn", "lift", "wrist"]

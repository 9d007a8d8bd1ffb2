"""How a controller counts its joints (`readings` of a robot file) holds in every command."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tomlkit
from command_line import main, own_planar

from casadical import calibrate, read_problem, read_robot
from casadical.robot.robot_file import to_toml


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

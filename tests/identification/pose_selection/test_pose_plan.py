"""The command: what it writes, prints and refuses."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from arms import elbow, positions, readings
from command_line import main

from casadical import read_measurements, write_robot
from casadical.core.transforms import frame
from casadical.identification.pose_selection.selection import travel

ROOT = Path(__file__).parents[3]


def run(monkeypatch, *words) -> int:
    return main(monkeypatch, "plan", *words)


@pytest.fixture
def robot_file(tmp_path) -> Path:
    path = tmp_path / "arm.toml"
    write_robot(elbow(), path)
    return path


def test_a_plan_is_written_and_can_be_measured(monkeypatch, tmp_path, capsys, robot_file) -> None:
    out = tmp_path / "plans" / "next.csv"
    room = tmp_path / "room.toml"
    room.write_text("casadical = 1\nfloor_mm = 0\n", encoding="utf-8")
    words = (robot_file, "-n", 22, "--for", "backlash@2", "--room", room, "--target-mm", "0.05", "--out", out)
    assert run(monkeypatch, *words) == 0
    text = capsys.readouterr().out
    assert "22 measurements for elbow" in text
    assert "enough for 0.05 mm" in text
    assert "backlash@2.half" in text
    assert "That is the error of the robot itself; an instrument of that noise will read" in " ".join(text.split())
    plan = pd.read_csv(out)
    assert plan["pose"].tolist() == list(range(1, 23))
    assert set(plan["approach2"]) == {-1, 1}
    assert plan["nominal_z_mm"].min() >= 0
    errors = pd.read_csv(out.with_suffix(".expected.csv"))
    assert errors.expected_std_error.notna().sum() > 20
    error_map = pd.read_csv(out.with_suffix(".map.csv"))
    figures = json.loads(out.with_suffix(".json").read_text(encoding="utf-8"))
    rms = np.sqrt(np.mean(error_map.expected_error_mm**2))
    assert figures["expected_error_mm"] == pytest.approx(rms, rel=1e-4)
    assert figures["expected_reading_mm"] == pytest.approx(np.sqrt(rms**2 + 3 * 0.02**2), rel=1e-4)
    # Measured at these readings, the file goes straight into an identification.
    robot = elbow()
    q = np.deg2rad(plan[[f"q{j}_deg" for j in range(1, 7)]].to_numpy())
    xyz = 1e3 * positions(robot, q, 0, 2e-5).position
    plan[["x_mm", "y_mm", "z_mm"]] = xyz
    plan.to_csv(tmp_path / "measured.csv", index=False)
    assert len(read_measurements(tmp_path / "measured.csv", 6)) == 22
    shuffled = np.random.default_rng(0).permutation(22)
    assert travel(robot, q) < travel(robot, q[shuffled])


@pytest.mark.slow
def test_payloads_of_the_measured_poses_are_planned_where_effects_are_to_be_told(monkeypatch, tmp_path) -> None:
    practice = ROOT / "data" / "campaigns" / "practice" / "kr210-P05.csv"
    words = (ROOT / "problems" / "kr210", "-n", 10, "--measured", practice, "--no-order", "--out")
    assert run(monkeypatch, *words, tmp_path / "told.csv", "--for", "gravity_compensator@2") == 0
    assert set(pd.read_csv(tmp_path / "told.csv")["payload_kg"]) == {0, 120}
    assert run(monkeypatch, *words, tmp_path / "plain.csv") == 0
    assert set(pd.read_csv(tmp_path / "plain.csv")["payload_kg"]) == {120}


def write_measured(path: Path, count: int, noise: float) -> None:
    """A campaign of the elbow arm, with noise of each coordinate [m]."""
    q = readings(elbow(), count, 3)
    table = pd.DataFrame(np.rad2deg(q), columns=[f"q{j}_deg" for j in range(1, 7)])
    table[["x_mm", "y_mm", "z_mm"]] = 1e3 * positions(elbow(), q, 0, noise).position
    table.to_csv(path, index=False)


def test_a_plan_continues_from_a_file(monkeypatch, tmp_path, capsys, robot_file) -> None:
    write_measured(tmp_path / "measured.csv", 15, 5e-5)
    out = tmp_path / "next.csv"
    assert run(monkeypatch, robot_file, "-n", 6, "--measured", tmp_path / "measured.csv", "--out", out) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "6 measurements for elbow, after 15 measured ones" in text
    noise = float(text.split("from noise of ")[1].split(" mm")[0])
    assert 0.02 < noise < 0.1  # 0.05 was planted; few degrees of freedom
    assert len(pd.read_csv(out)) == 6


@pytest.mark.slow
def test_a_plan_is_made_with_what_a_calibration_wrote(monkeypatch, tmp_path, capsys) -> None:
    tool = replace(elbow().tool, T=frame(np.eye(3), np.array([0.25, 0.08, 0.12])))
    results = tmp_path / "results"
    results.mkdir()
    write_robot(elbow(tool=tool), results / "SKCM.robot.toml", "Calibrated.")
    assert run(monkeypatch, results, "-n", 15, "--out", tmp_path / "next.csv") == 0
    assert f"Planned with the robot of {results}" in capsys.readouterr().out.replace("\n", "")
    plan = pd.read_csv(tmp_path / "next.csv")
    q = np.deg2rad(plan[[f"q{j}_deg" for j in range(1, 7)]].to_numpy())
    where = 1e3 * positions(elbow(tool=tool), q, 0, 0.0).position
    np.testing.assert_allclose(plan[["nominal_x_mm", "nominal_y_mm", "nominal_z_mm"]], where, atol=2e-3)
    write_robot(elbow(), results / "KM.robot.toml")
    assert run(monkeypatch, results, "-n", 15, "--out", tmp_path / "next.csv") == 2
    assert "2 calibrated robots; give the one to plan with" in capsys.readouterr().err.replace("\n", " ")


def test_without_a_number_it_is_the_stopping_rule(monkeypatch, tmp_path, capsys, robot_file) -> None:
    write_measured(tmp_path / "measured.csv", 20, 2e-5)
    out = tmp_path / "course.csv"
    words = ("--measured", tmp_path / "measured.csv", "--noise-mm", "0.02", "--target-mm", "0.02", "--out", out)
    assert run(monkeypatch, robot_file, *words) == 0
    text = " ".join(capsys.readouterr().out.split())
    course = pd.read_csv(out)
    assert course.poses.tolist() == list(range(20, 121))
    enough = int(course.poses[course.expected_error_mm <= 0.02].iloc[0])
    assert f"{enough} poses are enough for 0.02 mm" in text
    assert "From " in text
    assert [p.name for p in tmp_path.glob("*.csv")].count("plan.csv") == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("-n", "3"), "3 poses give 9 numbers"),
        (("-n", "20", "--for", "rust"), "no effect 'rust'"),
        (("-n", "3", "--for", "backlash"), "3 poses give 9 numbers, but"),
        (("-n", "20", "--payloads", "1;2"), "allowed: numbers by commas"),
        (("-n", "6", "--measured", "none.csv"), "none.csv: no such file"),
    ],
)
def test_faults_end_in_a_message(monkeypatch, tmp_path, capsys, robot_file, words, message) -> None:
    assert run(monkeypatch, robot_file, *words, "--out", tmp_path / "x.csv") == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "x.csv").exists()

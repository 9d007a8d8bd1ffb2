"""The first hour: every table as people bring it reaches a calibrated robot by the README's commands, none edited."""

from __future__ import annotations

import io
import json
from pathlib import Path

import first_hour
import numpy as np
import pytest
from command_line import main

from casadical import read_robot
from casadical.identification import errors
from casadical.measurements.reading import read_measurements


def walk(monkeypatch: pytest.MonkeyPatch, folder: Path, table: Path) -> dict[str, object]:
    """new, check --repair, calibrate; the figures of the result."""
    arm, out = folder / "arm", folder / "results"
    assert main(monkeypatch, "new", arm, "--dh", folder / "dh.csv", "--data", table, "--yes", "--quiet") == 0
    assert main(monkeypatch, "check", arm, "--repair", "--quiet") == 0
    assert main(monkeypatch, "calibrate", arm, "--out", out, "--quiet") == 0
    return json.loads((out / "result.json").read_text())["methods"]["KM"]


@pytest.mark.parametrize("name", first_hour.TABLES)
def test_any_table_reaches_a_calibrated_robot(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = walk(monkeypatch, tmp_path, first_hour.write(tmp_path, name, *first_hour.measured(80)))
    assert found["sets"]["report"]["mean_mm"] < 0.12


def test_the_integrators_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """German, decimal commas, a sign, a left-handed frame, bad rows and rows without numbers, all at once."""
    q, p = first_hour.measured(110)
    clean = first_hour.write(tmp_path, "einheiten.csv", q[90:], p[90:])
    q, p = q[:90].copy(), p[:90] * [1, -1, 1]
    q[:, 1] *= -1
    p[[3, 40, 71]] += [[0, 35, 0], [120, 0, 0], [0, 0, -60]]
    p[15, 2] = np.nan
    table = first_hour.write(tmp_path, "messung.csv", q, p)
    (tmp_path / "dh.csv").write_text(first_hour.DH.replace("-90,130", "-130,130"))
    found = walk(monkeypatch, tmp_path, table)
    assert {out["row"] for out in found["left_out"]} <= {8, 45, 76}
    robot = read_robot(tmp_path / "results" / "KM.robot.toml")
    # Poses that were never given, in the frame that the slip had turned.
    m = read_measurements(clean, 6)
    assert float(np.median(errors(robot, m))) < 2e-4


def test_a_question_is_asked_and_nobody_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    q, p = first_hour.measured(40)
    names = [f"{w}{k} [deg]" for w in "AJ" for k in range(1, 7)] + ["X mm", "Y mm", "Z mm"]
    table = tmp_path / "two.csv"
    table.write_text(first_hour.table(names, np.column_stack([q, q]), p))
    (tmp_path / "dh.csv").write_text(first_hour.DH)
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    assert main(monkeypatch, "new", tmp_path / "arm", "--dh", tmp_path / "dh.csv", "--data", table) == 2
    printed = capfd.readouterr()
    assert "Which columns are the joint readings?" in printed.err
    assert "--yes takes the first choice" in printed.err
    assert not (tmp_path / "arm").exists()

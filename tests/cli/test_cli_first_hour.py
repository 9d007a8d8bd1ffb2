"""The first hour: every table as people bring it reaches a calibrated robot by the README's commands, none edited."""

import io
import json
from pathlib import Path

import first_hour
import numpy as np
import pytest
from command_line import main

NAMES = [f"J{k} (deg)" for k in range(1, 7)] + ["Measured X", "Measured Y", "Measured Z"]


def worst_day(folder: Path) -> list[object]:
    """German, cp1252, decimal commas, a row of units; three reflectors unnamed, two slips, bad rows, no masses."""
    q, p, _ = first_hour.nested(30)
    p[[7, 40, 71]] += [[0, 35, 0], [120, 0, 0], [0, 0, -60]]
    p[20, 1] = np.nan
    names = [f"Achse {k}" for k in range(1, 7)] + [f"Messwert {c}" for c in "XYZ"]
    slipped = q * [1, -1, 1, 1, 1, 1] + [0, 0, 90, 0, 0, 0]
    head, *lines = first_hour.table(names, slipped, p, ";", ",", "Punkt Nr.").splitlines()
    text = ["Messprotokoll Prüfstand", "", head, ";".join(["-", *["°"] * 6, *["mm"] * 3]), *lines]
    (folder / "messung.csv").write_bytes("\r\n".join(text).encode("cp1252"))
    (folder / "dh.csv").write_text(first_hour.DH.replace("-90,130", "-130,130").replace("-150,60", "-150,150"))
    q, p = first_hour.measured(112)
    later = q[100:] * [1, -1, 1, 1, 1, 1] + [0, 0, 90, 0, 0, 0]
    (folder / "ten.csv").write_bytes(first_hour.table(names, later, p[100:], ";", ",").encode("cp1252"))
    return ["--dh", folder / "dh.csv", "--data", folder / "messung.csv"]


def slips_and_a_link_in_metres(folder: Path) -> list[object]:
    """A sign, a left-handed frame; one link of 0.7 among hundreds of millimetres."""
    q, p = first_hour.measured(112)
    q, p = q * [1, 1, -1, 1, 1, 1], p * [1, -1, 1]
    (folder / "measured.csv").write_text(first_hour.table(NAMES, q[:90], p[:90]))
    (folder / "ten.csv").write_text(first_hour.table(NAMES, q[100:], p[100:]))
    wide = first_hour.DH.replace("700", "0.7").splitlines()
    (folder / "dh.csv").write_text("\n".join(line.rsplit(",", 2)[0] for line in wide) + "\n")
    return ["--dh", folder / "dh.csv", "--data", folder / "measured.csv"]


def a_urdf(folder: Path) -> list[object]:
    """A researcher's URDF without masses, and what numpy.savetxt writes."""
    pytest.importorskip("yourdfpy", reason="the extra urdf is not installed")
    q, p = first_hour.measured(112)
    (folder / "arm.urdf").write_text(first_hour.urdf())
    first_hour.write(folder, "researcher.txt", q[100:], p[100:]).rename(folder / "ten.csv")
    return ["--urdf", folder / "arm.urdf", "--data", first_hour.write(folder, "researcher.txt", q[:90], p[:90])]


@pytest.mark.slow
@pytest.mark.parametrize("given", [worst_day, slips_and_a_link_in_metres, a_urdf], ids=lambda g: g.__name__)
def test_the_hard_cases_are_calibrated_by_the_readmes_commands(given, tmp_path, monkeypatch):
    """Four commands, nothing edited; the accuracy is judged on poses that the calibration never saw."""
    arm, out = tmp_path / "arm", tmp_path / "results"
    options = given(tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert main(monkeypatch, "new", arm, *options, "--yes", "-q") == 0
    assert main(monkeypatch, "check", arm, "--repair", "-q") == 0
    assert main(monkeypatch, "calibrate", arm, "--method", "KM", "--out", out, "-q") == 0
    figures = tmp_path / "verified.json"
    later = ("verify", out / "KM.robot.toml", tmp_path / "ten.csv", "--json", figures, "-q")
    assert main(monkeypatch, *later, "--promised-mm", "0.15") == 0
    assert json.loads(figures.read_text())["found_rms_mm"] < 0.12
    assert {path: path.read_bytes() for path in before} == before


def test_what_was_understood_of_a_table_is_printed_as_a_table(tmp_path, monkeypatch, capfd):
    q, p = first_hour.measured(40)
    table = first_hour.write(tmp_path, "messung.csv", q, p)
    assert main(monkeypatch, "new", tmp_path / "arm", "--dh", tmp_path / "dh.csv", "--data", table, "--yes") == 0
    shown = capfd.readouterr().out
    assert "Table(" not in shown
    assert "Words(" not in shown
    assert [line for line in shown.splitlines() if line.startswith("q4_deg") and "Achse 4" in line], shown


def test_a_question_is_asked_and_nobody_answers(tmp_path, monkeypatch, capfd):
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

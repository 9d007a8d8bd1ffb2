"""Bad rows of a table cannot hide: they are left out, named everywhere, and a result that they ruin is refused."""

import json
from pathlib import Path

import first_hour
import numpy as np
import pandas as pd
import pytest
from command_line import main, own_planar

from casadical import calibrate, read_problem
from casadical.core.reporting.blocks import Table, mm
from casadical.core.reporting.result import plain_text
from casadical.identification import errors
from casadical.project.acceptance.certificate import certificate
from casadical.project.check.check import precheck
from casadical.project.new import new_problem
from casadical.project.problem import read_campaign

# Rows of the file (headings in line 4), as they are in the set that is fitted with seed 0.
SPOILED = {6: 40.0, 9: 120.0, 20: 15.0, 33: 300.0}


def arm(folder: Path, spoiled: dict[int, float]) -> Path:
    """A problem folder whose table has rows that are off by so many millimetres."""
    q, p = first_hour.measured(90)
    for row, off in spoiled.items():
        p[row - 5, 1] += off
    table = first_hour.write(folder, "messung.csv", q, p)
    new_problem(folder / "arm", dh=folder / "dh.csv", data=table)
    return folder / "arm"


@pytest.mark.slow
def test_clean_data_lose_nothing(tmp_path: Path) -> None:
    """The same digits as plain least squares."""
    clean = arm(tmp_path, {})
    auto, linear = calibrate(clean), calibrate(clean, loss="linear")
    assert auto.to_json() == linear.to_json()
    assert auto.identification.loss == "linear"


@pytest.mark.slow
def test_the_forecast_is_without_rows_that_are_far_off(tmp_path: Path) -> None:
    (tmp_path / "clean").mkdir()
    clean, spoiled = precheck(arm(tmp_path / "clean", {})), precheck(arm(tmp_path, dict.fromkeys(SPOILED, 900.0)))
    assert spoiled.ok
    told = clean.outlooks[-1].held_out, spoiled.outlooks[-1].held_out
    assert told[1] == pytest.approx(told[0], rel=0.2)
    assert any("the accuracy to expect is without them" in f.text for f in spoiled.findings)


def test_rows_that_are_metres_off_are_an_error_until_they_are_left_out(tmp_path: Path) -> None:
    folder = arm(tmp_path, {6: 2300.0, 20: 60.0})
    (error,) = precheck(folder).of_level("error")
    assert "Rows 6 lie further off than half the reach" in error.text
    assert "(leave_out = [6] in problem.toml, under [[measurements]])" in error.text
    text = (folder / "problem.toml").read_text()
    (folder / "problem.toml").write_text(text.replace('file = "poses.csv"', 'file = "poses.csv"\nleave_out = [6]', 1))
    assert precheck(folder).ok


def test_every_row_left_out_is_named(tmp_path: Path) -> None:
    folder = arm(tmp_path, SPOILED)
    found = calibrate(folder)
    fitted = {int(row) for m in found.problem.sets["identify"] for row in m.row}
    expected = set(SPOILED) & fitted
    assert len(expected) >= 2
    assert {out.row for out in found.identification.left_out} == expected
    for out in found.identification.left_out:
        assert 1e3 * out.error == pytest.approx(SPOILED[out.row], abs=0.5)
    listed = found.to_json()["methods"]["KM"]
    assert {entry["row"] for entry in listed["left_out"]} == expected
    assert listed["sets"]["identify"]["n"] == len(fitted) - len(expected)
    assert listed["sets"]["identify"]["max_mm"] < 0.3
    page = [b for s in found.page().sections for b in s.blocks if isinstance(b, Table)]
    for tables in (found.blocks(), page):
        (rows,) = [b.rows for b in tables if isinstance(b, Table) and b.title.startswith("Rows left out")]
        assert {int(row[1]) for row in rows} == expected
    said = " ".join(str(getattr(b, "text", "")) for b in found.brief())
    assert all(f"row {row} (" in said for row in set(SPOILED))  # held-out ones are named, too
    warned = " ".join(f.text for f in precheck(folder).findings if f.topic == "rows")
    assert all(f"{row} (" in warned for row in expected - {20})


@pytest.mark.parametrize(("column", "off", "cause"), [("y_mm", 0.9, "y"), ("y_mm", -90.0, "y"), ("q2_deg", 9.0, "q2")])
def test_a_typing_error_in_a_held_out_row_is_in_no_figure(tmp_path: Path, column: str, off: float, cause: str) -> None:
    """Every figure is that of the other held-out rows by the clean table's robot; asked for, the row counts."""
    folder = own_planar(tmp_path / "arm")
    clean = calibrate(folder)
    held, robot = clean.problem.sets["report"][0], clean.robot
    row = int(held.row[4])
    table = pd.read_csv(folder / "poses.csv")
    table.loc[row - 2, column] += off  # the first row stands in line 2 of the file
    table.to_csv(folder / "poses.csv", index=False)
    found = calibrate(folder)
    e = 1e3 * np.delete(errors(robot, held), 4)
    told = found.to_json()["methods"]["KM"]["sets"]["report"]
    assert (told["n"], told["mean_mm"], told["max_mm"]) == pytest.approx((14, e.mean(), e.max()))
    assert [(out["row"], out["column"]) for out in told["left_out"]] == [(row, cause)]
    said = " ".join(plain_text(found.brief()).split())
    assert f"row {row} (" in said
    assert f"mm in {cause})" in said
    page = found.page()
    assert [tile.value for tile in page.tiles][1:] == [mm(1e-3 * v) for v in (e.mean(), np.quantile(e, 0.95), e.max())]
    found.write(tmp_path / "results")
    stated = certificate(tmp_path / "results", problem=folder)
    assert 1e3 * stated.after.worst < 1.5 * e.max()
    assert (stated.after.n, [out.row for out in stated.left_out]) == (14, [row])
    assert calibrate(folder, loss="linear").to_json()["methods"]["KM"]["sets"]["report"]["n"] == 15


@pytest.mark.slow
def test_worse_than_before_is_an_error_with_its_remedy(tmp_path, monkeypatch, capfd):
    (tmp_path / "clean").mkdir()
    fitted = read_problem(arm(tmp_path / "clean", {})).sets["identify"][0].row
    folder = arm(tmp_path, {int(row): 30.0 + 5 * k for k, row in enumerate(fitted[::8])})
    text = (folder / "problem.toml").read_text()
    (folder / "problem.toml").write_text(f"geometry_prior = false\n{text}")
    out = tmp_path / "out"
    assert main(monkeypatch, "calibrate", folder, "--loss", "linear", "--out", out) == 4
    message = " ".join(capfd.readouterr().err.split())
    assert "arm: held-out poses are worse after the calibration" in message
    assert "use --loss huber, or name them in leave_out" in message
    assert not out.exists()


def test_rows_without_numbers_are_left_out_by_new_and_named(tmp_path: Path) -> None:
    q, p = first_hour.measured(60)
    p[[7, 30], [0, 2]] = np.nan
    table = first_hour.write(tmp_path, "messung.csv", q, p)
    problem = new_problem(tmp_path / "arm", dh=tmp_path / "dh.csv", data=table)
    assert {12, 35}.isdisjoint(int(row) for parts in problem.sets.values() for m in parts for row in m.row)
    # The table that was given is the problem's own, whatever its name: its rows are left out there, too.
    read = read_campaign(tmp_path / "arm", table.rename(tmp_path / "given.csv"), problem.robot)
    assert {12, 35}.isdisjoint(read.row.tolist())
    text = (tmp_path / "arm" / "problem.toml").read_text()
    assert "12, # a cell is no number" in text
    assert json.dumps("Messwert X [mm]") in text


@pytest.mark.slow
def test_a_calibration_that_hardly_helps_says_which_data_would(tmp_path: Path) -> None:
    """Few poses near the robot's rest, of a robot of which only the DH table is known."""
    q, _ = first_hour.measured(90)
    q = 0.1 * q[:30]
    noise = np.random.default_rng(0).normal(0, 0.5, (30, 3))
    table = first_hour.write(
        tmp_path, "messung.csv", q, first_hour.positions(q, first_hour.ROWS, first_hour.TOOL) + noise
    )
    new_problem(tmp_path / "arm", dh=tmp_path / "dh.csv", data=table)
    said = " ".join(" ".join(str(getattr(b, "text", "")) for b in calibrate(tmp_path / "arm").brief()).split())
    assert "The nominal geometry is right as far as these poses tell: only the frames were found. To learn more" in said
    assert "would need wider ranges of all joints (less than half of the limits is covered)." in said
    assert "equally good" not in said


def test_check_looks_at_the_compliance_that_calibrate_tries(tmp_path: Path) -> None:
    """Of a robot file that declares none, or some: no warning that there is none, and what the poses tell of it."""
    folder = arm(tmp_path, {})
    file = folder / "robot.toml"
    for text in (file.read_text(), file.read_text().replace("[[joint]]\n", "[[joint]]\ncompliant = true\n")):
        file.write_text(text)
        found = precheck(folder)
        assert "c2" in next(view.names for view in found.outlooks if view.method == "SKCM")
        assert not any("no compliance is identifiable" in finding.text for finding in found.findings)

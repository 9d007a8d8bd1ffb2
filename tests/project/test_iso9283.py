"""A test by ISO 9283: figures equal to a sheet that was computed by hand, the cube's poses, and bad tables."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from command_line import ROOT, main

from casadical import InputError, read_robot
from casadical.identification.accuracy import predicted
from casadical.identification.pose_selection.workspace import Workspace
from casadical.measurements.measurements import unmeasured
from casadical.project.acceptance.iso9283 import evaluated_table, planned_test, poses_in

ROBOT = ROOT / "problems" / "ur10e" / "robot.toml"
# The sheet, in mm: visits of P1, commanded to (100, 200, 300), and of P2, commanded to (0, 0, 0).
SHEET = """test,pose,cycle,path,group,cx_mm,cy_mm,cz_mm,x_mm,y_mm,z_mm
accuracy,1,1,0,0,100,200,300,100.3,200.0,300.0
accuracy,1,2,0,0,100,200,300,100.1,200.0,300.0
accuracy,1,3,0,0,100,200,300,100.2,200.3,300.0
accuracy,1,4,0,0,100,200,300,100.2,199.7,300.0
accuracy,2,1,0,0,0,0,0,0.0,0.0,1.0
accuracy,2,2,0,0,0,0,0,0.0,0.0,1.2
directions,1,1,1,0,100,200,300,100.0,200.0,300.0
directions,1,2,1,0,100,200,300,100.0,200.2,300.0
directions,1,1,2,0,100,200,300,100.3,200.1,300.4
directions,1,1,3,0,100,200,300,100.0,200.1,300.1
directions,2,1,1,0,0,0,0,0.0,0.0,1.0
directions,2,1,2,0,0,0,0,0.0,0.2,1.0
drift,1,1,0,0,100,200,300,100.1,200,300
drift,1,2,0,0,100,200,300,100.1,200,300
drift,1,1,0,1,100,200,300,100.4,200,300
drift,1,2,0,1,100,200,300,100.2,200,300
drift,1,1,0,2,100,200,300,100.2,200,300
drift,1,2,0,2,100,200,300,100.2,200,300
"""


@pytest.fixture
def sheet(tmp_path):
    path = tmp_path / "sheet.csv"
    path.write_text(SHEET)
    return path


def test_the_figures_are_those_of_a_sheet_by_hand(sheet):
    found = evaluated_table(sheet, read_robot(ROBOT))
    first, second = found.accuracy
    # P1: mean (100.2, 200, 300); l = .1, .1, .3, .3; mean .2; S = sqrt(4 x .01 / 3) = .11547; RP = .2 + 3 S.
    assert pytest.approx(0.2) == 1e3 * first.AP
    np.testing.assert_allclose(1e3 * np.array(first.parts), [0.2, 0, 0], atol=1e-9)
    assert pytest.approx(0.2 + 3 * np.sqrt(0.04 / 3)) == 1e3 * first.RP
    # P2: mean z 1.1; l = .1, .1; S = 0.
    assert pytest.approx(1.1) == 1e3 * second.AP
    assert pytest.approx(0.1) == 1e3 * second.RP
    # Means of the paths: (100, 200.1, 300), (100.3, 200.1, 300.4), (100, 200.1, 300.1): .5 apart at most.
    assert {k: 1e3 * apart for k, apart in found.directions.items()} == pytest.approx({1: 0.5, 2: 0.2})
    # AP .1, .3, .2: dAP .2. RP 0, then l = .1, .1 and S = 0, then 0: dRP .1.
    assert found.drift is not None
    np.testing.assert_allclose(1e3 * np.array(found.drift), [0.2, 0.1], atol=1e-9)
    assert found.table().rows[0] == ("P1", "4", "0.200", "+0.2000", "+0.0000", "+0.0000", "0.546", "0.500")
    assert found.model is None
    assert found.notes == ("fewer visits than the 30 of the standard at P1, P2",)
    # One path and one group of visits tell neither a variation nor a drift.
    kept = [row for row in SHEET.splitlines() if row.split(",")[3] in "path 0 1" and row.split(",")[4] in "group 0"]
    sheet.write_text("\n".join(kept))
    found = evaluated_table(sheet, read_robot(ROBOT))
    assert (found.directions, found.drift) == ({}, None)


def test_the_poses_lie_on_the_diagonals_ten_per_cent_from_the_ends():
    p = poses_in(np.zeros(3), 1.0)
    ends = np.linalg.norm(p[1:], axis=1)
    np.testing.assert_allclose(ends, (0.5 - 0.1) * np.sqrt(3))
    assert np.linalg.matrix_rank(p[1:]) == 2
    assert not p[0].any()


def test_a_planned_test_is_reached_in_one_orientation_and_comes_back(tmp_path, monkeypatch, capfd):
    robot, plan = read_robot(ROBOT), tmp_path / "plan.csv"
    assert main(monkeypatch, "plan", ROBOT, "--iso9283", "--cube-mm", "400", "--out", plan, "--quiet") == 0
    table = pd.read_csv(plan, keep_default_na=False)
    assert len(table) == 30 * 5 + 3 * 3 * 30 + 49 * 10
    one = table.drop_duplicates("pose").sort_values("pose")
    centre, side = 1e-3 * one[["cx_mm", "cy_mm", "cz_mm"]].to_numpy()[0], 0.4
    q = np.deg2rad(one[[f"q{j}_deg" for j in range(1, 7)]].to_numpy(dtype=float))
    p, R = predicted(robot, unmeasured(q))
    np.testing.assert_allclose(p, poses_in(centre, side) @ robot.base.T[:3, :3].T + robot.base.T[:3, 3], atol=2e-6)
    np.testing.assert_allclose(R, np.broadcast_to(R[0], R.shape), atol=2e-6)
    assert Workspace().allows(robot, q).all()
    # Measured: 0.3 mm off in x of the base, and 10 um of scatter.
    rng = np.random.default_rng(1)
    command = table[["cx_mm", "cy_mm", "cz_mm"]].to_numpy() + [0.3, 0, 0] + 0.01 * rng.normal(size=(len(table), 3))
    world = command @ robot.base.T[:3, :3].T + 1e3 * robot.base.T[:3, 3]
    path, kept = tmp_path / "measured.csv", tmp_path / "iso.json"
    table.assign(x_mm=world[:, 0], y_mm=world[:, 1], z_mm=world[:, 2]).to_csv(path, index=False)
    assert main(monkeypatch, "verify", ROBOT, path, "--iso9283", "--json", kept) == 0
    assert "AP 0.3" in capfd.readouterr().out
    told = json.loads(kept.read_text())
    assert [row["n"] for row in told["poses"]] == [30] * 5
    assert all(abs(row["AP_mm"] - 0.3) < 0.01 for row in told["poses"])
    assert told["model_rms_mm"] == pytest.approx(0.3, abs=0.01)
    assert told["dAP_mm"] < 0.02


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("accuracy,", "accurate,", "'accurate'; allowed: accuracy, directions, drift"),
        ("199.7", "", "row"),
        ("cx_mm", "c_mm", "cx_mm or cx_m is missing"),
        ("accuracy,2,2,0,0,0,0,0,0.0,0.0,1.2\n", "", "RP needs 2 or more"),
        ("accuracy,", "drift,", "no visit of the test 'accuracy'"),
    ],
)
def test_a_table_that_is_no_test_is_refused(sheet, old, new, words):
    sheet.write_text(SHEET.replace(old, new))
    with pytest.raises(InputError, match=re.escape(words)):
        evaluated_table(sheet, read_robot(ROBOT))


def test_positions_of_another_frame_are_said(sheet):
    table = pd.read_csv(sheet)
    table.assign(x_mm=table["x_mm"] + 3000).to_csv(sheet, index=False)
    assert "instrument stood elsewhere" in evaluated_table(sheet, read_robot(ROBOT)).notes[-1]


def test_no_cube_within_reach_is_refused():
    with pytest.raises(InputError, match="no cube of 3000 mm is within its reach"):
        planned_test(read_robot(ROBOT), 3.0)

"""One reader: every command says the same of the same file, rows count as in the file, problem.toml names columns."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import run

from casadical import InputError, read_measurements, read_problem
from casadical.measurements.arrangement import joined, long
from casadical.measurements.array_files import _columns
from casadical.measurements.columns import Columns
from casadical.measurements.raw_table import read_table
from casadical.measurements.table_form import decoded
from casadical.project.check.check import precheck
from casadical.project.new import new_problem
from casadical.project.problem import read_campaign

ROOT = Path(__file__).parents[2]
PLANAR = ROOT / "problems" / "planar"
CAMPAIGN = ROOT / "data" / "planar" / "planar.csv"
POINT = {"x_mm": "X", "y_mm": "Y", "z_mm": "Z"}
HEAD = 'casadical = 1\ntitle = "t"\n'


def folder_with(tmp_path: Path, text: str, problem: str = '[[measurements]]\nfile = "poses.csv"\n') -> Path:
    (tmp_path / "robot.toml").write_text((PLANAR / "robot.toml").read_text())
    (tmp_path / "problem.toml").write_text(HEAD + problem)
    (tmp_path / "poses.csv").write_text(text)
    return tmp_path


WRONG = {
    "nothing": ("", "not a readable CSV table: it is empty"),
    "a header": ("q1_deg,q2_deg,x_mm\n", "a header but no rows"),
    "a cell too many": ("q1_deg,q2_deg,x_mm,y_mm,z_mm\n1,2,3,4,5,\n", "row 2 has 6 cells, the header 5"),
    "a name twice": ("q1_deg,q2_deg,x_mm, x_mm\n1,2,3,4\n", "column 'x_mm' is there twice"),
    "an open quote": ('q1_deg,q2_deg\n"1,2\n', "not a readable CSV table: row 2: unexpected end of data"),
}


@pytest.mark.parametrize("name", WRONG)
def test_every_command_says_the_same_of_the_same_file(name: str, tmp_path: Path) -> None:
    text, words = WRONG[name]
    folder = folder_with(tmp_path, text)
    path = folder / "poses.csv"
    said = []
    for act in (
        lambda: read_problem(folder),
        lambda: read_campaign(folder, path, read_problem(PLANAR).robot),
        lambda: read_measurements(path, 2),
        lambda: new_problem(tmp_path / "made", dh=path),
    ):
        with pytest.raises(InputError) as refused:
            act()
        said.append(str(refused.value))
    said += [f.text for f in precheck(folder).findings if f.topic == "reading"]
    assert len(said) == 5
    assert set(said) == {f"{path}: {said[0].removeprefix(f'{path}: ')}"}
    assert words in said[0]


def test_rows_count_as_in_the_file(tmp_path: Path) -> None:
    """Blank lines and cells over several lines included."""
    path = tmp_path / "blank.csv"
    path.write_text('q1_deg,x_mm,y_mm,z_mm,remark\n\n10,1,2,3,"two\nlines"\n  \n20,4,5,6,\n30,bad,8,9,\n')
    assert read_table(path).line == (3, 6, 7)
    with pytest.raises(InputError, match=r"blank\.csv: row 7, column 'x_mm': 'bad' is not a finite number"):
        read_measurements(path, 1)
    path.write_text(path.read_text().replace("bad", "7"))
    assert read_measurements(path, 1).row.tolist() == [3, 6, 7]


@pytest.mark.parametrize("prefix", [b"", b"\xef\xbb\xbf"], ids=["plain", "with a byte order mark"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"], ids=["unix", "windows", "old mac"])
def test_what_spreadsheets_write_reads_alike(prefix: bytes, end: str, tmp_path: Path) -> None:
    path = tmp_path / "planar.csv"
    path.write_bytes(prefix + CAMPAIGN.read_text().replace("\n", end).encode())
    ours, theirs = read_measurements(path, 2), read_measurements(CAMPAIGN, 2)
    assert all(np.array_equal(getattr(ours, name), getattr(theirs, name)) for name in ("q", "row"))


def renamed(tmp_path: Path) -> tuple[Path, Path]:
    """A problem whose tables have other headers, and a campaign with these headers."""
    table = pd.read_csv(CAMPAIGN).rename(columns=POINT)
    named = ", ".join(f'{ours} = "{theirs}"' for ours, theirs in {**POINT, "payload_kg": "load"}.items())
    folder = folder_with(
        tmp_path,
        table.assign(load=1.0).to_csv(index=False),
        f'[[measurements]]\nfile = "poses.csv"\ncolumns = {{ {named} }}\n',
    )
    table.to_csv(tmp_path / "campaign.csv", index=False)
    return folder, tmp_path / "campaign.csv"


def test_a_campaign_is_understood_as_the_problems_own_tables_are(tmp_path: Path) -> None:
    folder, campaign = renamed(tmp_path)
    robot = read_problem(folder).robot
    plain = read_measurements(CAMPAIGN, 2)
    m = read_campaign(folder, campaign, robot)
    assert m.position is not None
    assert np.array_equal(m.position, plain.position)
    assert "payload_kg" not in m.conditions  # the campaign has no column "load"; the problem's own table has
    assert read_campaign(folder, folder / "poses.csv", robot).conditions["payload_kg"].tolist() == [1.0] * len(m)
    assert np.array_equal(read_campaign(folder, CAMPAIGN, robot).position, plain.position)  # our own names need no map
    assert not read_campaign(folder, campaign, robot, readings_only=True).position.any()


def test_a_plan_takes_the_headers_of_the_problem(tmp_path: Path) -> None:
    folder, campaign = renamed(tmp_path)
    for name, path in (("a", campaign), ("b", CAMPAIGN)):
        if name == "b":
            (folder / "problem.toml").write_text(HEAD)
        done = run("plan", "--isolability", "-q", folder, path, "--json", tmp_path / f"{name}.json")
        assert (done.returncode, done.stderr) == (0, "")
    first, second = (json.loads((tmp_path / f"{name}.json").read_text()) for name in "ab")
    assert first | {"campaign": ""} == second | {"campaign": ""}
    with pytest.raises(InputError, match="a calibration needs at least one table"):
        read_problem(folder)


@pytest.mark.parametrize("order", ["le", "be"])
@pytest.mark.parametrize("text", ["q1_deg,x_mm\n1,2\n", "\u4e00" * 40 + "a" * 80, "x" * 400 + "\u4e00" * 300])
def test_utf_16_without_its_mark_is_told_by_where_the_zeros_are(order: str, text: str) -> None:
    assert decoded(text.encode(f"utf-16-{order}")) == (text, f"utf-16-{order}")


def test_a_control_character_in_a_heading_is_refused(tmp_path):
    (tmp_path / "poses.csv").write_text("q1_deg,x\x1b[31m_mm\n1,2\n")
    with pytest.raises(InputError, match=r"poses\.csv: the heading of column 2 holds the control character '\\x1b'"):
        read_measurements(tmp_path / "poses.csv", 1)


def test_a_column_without_a_cell_is_there_but_empty(tmp_path):
    (tmp_path / "poses.csv").write_text("q1_deg,q2_deg,x_mm,y_mm,z_mm\n,1,2,3,4\nnan,5,2,3,5\n")
    with pytest.raises(InputError, match=r"^poses\.csv: column q1_deg is empty; each of its rows needs a number$"):
        read_measurements(tmp_path / "poses.csv", 2)
    with pytest.raises(InputError, match="column q1_deg is empty"):
        Columns.of_file(read_table(tmp_path / "poses.csv")).si("q1", ["_deg", "_rad"])


def test_two_files_are_joined_by_their_numbers_or_put_below_each_other(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("point,q1_deg\n1,10\n2,20\n3,30\n")
    (tmp_path / "b.csv").write_text("point,x_mm\n3,300\n1,100\n2,200\n")
    one, other = (read_table(tmp_path / name) for name in ("a.csv", "b.csv"))
    both = joined([one, other]).frame
    assert both[["q1_deg", "x_mm"]].astype(float).to_numpy().tolist() == [[10, 100], [20, 200], [30, 300]]
    assert joined([one, one]).frame["q1_deg"].astype(float).tolist() == [10, 20, 30, 10, 20, 30]


def test_columns_of_an_array_have_its_name_or_a_number() -> None:
    assert [[*_columns(name, np.arange(4.0))] for name in ("alpha", "")] == [["alpha"], ["column 1"]]
    assert [*_columns("", np.zeros((4, 2)))] == ["column 1", "column 2"]


def test_two_files_are_joined_by_the_nearest_times(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time_s,q1_deg\n" + "".join(f"{k}.0,{10 * k}\n" for k in range(1, 6)))
    (tmp_path / "b.csv").write_text("time_s,x_mm\n" + "".join(f"{0.5 * k + 0.1:.1f},{k}.25\n" for k in range(20)))
    both = joined([read_table(tmp_path / name) for name in ("a.csv", "b.csv")]).frame
    assert both["q1_deg"].astype(float).tolist() == [10, 20, 30, 40, 50]
    assert both["x_mm"].astype(float).tolist() == [2.25, 4.25, 6.25, 8.25, 10.25]


def test_points_that_stand_still_are_no_targets_where_some_were_not_seen(tmp_path: Path) -> None:
    at = np.random.default_rng(0).uniform(-1, 1, (60, 9)) * np.repeat([1.0, 1e-5], [3, 6])
    at += [0.0, 0.0, 0.0, 2.9, 0.8, -0.5, 2.7, 0.0, -0.5]
    at[:4, 3:6] = at[3:6, 6:] = 0.0
    names = [f"{point}{c}_m" for point in ("", "base2_", "base3_") for c in "xyz"]
    pd.DataFrame(at, columns=names).to_csv(tmp_path / "a.csv")
    assert "tool" not in long(read_table(tmp_path / "a.csv")).frame

"""A fleet of simulated arms: rows, what stands out, what a type shares; and its command on a real local cluster."""

import json
import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import run
from fleet_plants import planar

from casadical.core.reporting.blocks import Table, Words
from casadical.fleet.result import MIN_LABEL_DISTANCE, fleet_of, name_of_type
from casadical.fleet.run import run_fleet
from casadical.fleet.store import add, fingerprint, one_robot, rows
from casadical.measurements.kinds.position import Position

pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six arms of one drawing, one with later campaigns, and one that is no robot."""
    folder = tmp_path_factory.mktemp("plant")
    for k in range(6):
        planar(folder / f"arm{k}", k, campaigns=3 if k == 5 else 0)
    later = pd.read_csv(folder / "arm5" / "campaigns" / "2026-03-01.csv")
    later[["x_mm", "y_mm", "z_mm"]] *= 1e-3  # metres under the old heading
    later.to_csv(folder / "arm5" / "campaigns" / "2026-04-01.csv", index=False)
    slip = (folder / "arm5" / "campaigns" / "2026-02-01.csv").read_text().splitlines()
    slip[4] = "l" + slip[4]
    (folder / "arm5" / "campaigns" / "2026-05-01.csv").write_text("\n".join(slip))
    (folder / "broken").mkdir()
    (folder / "broken" / "problem.toml").write_text("casadical = 1\n")
    return folder


@pytest.fixture(scope="module")
def store(plant: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with the rows of all."""
    store = tmp_path_factory.mktemp("done") / "fleet.parquet"
    store.mkdir()
    for folder in sorted(plant.iterdir()):
        add(store, one_robot(str(folder), False))
    return store


@pytest.fixture
def good(store: Path) -> pd.DataFrame:
    """Rows of the robots that were calibrated."""
    whole, damaged = rows(store)
    assert damaged == []
    return whole[whole["status"] == "ok"].sort_values("robot", ignore_index=True)


def test_what_is_done_is_not_done_again_and_one_bad_robot_stops_nobody(plant, store, tmp_path):
    here = tmp_path / "plant"
    shutil.copytree(plant, here)
    shutil.rmtree(here / "broken")
    place = Path(shutil.copytree(store, tmp_path / "fleet.parquet"))
    before = rows(place)[0].set_index("robot")["finished"]
    (here / "arm0").rename(here / "left arm")
    fleet = run_fleet([here], place, with_diagnosis=False)
    after = fleet.robots.set_index("robot")["finished"]
    assert fleet.computed == 0
    assert set(after.index) == {"left arm", *(f"arm{k}" for k in range(1, 6))}
    assert (after["left arm"], after["arm1"]) == (before["arm0"], before["arm1"])
    assert fleet.notes == ("left arm has the files of arm0, whose folder is not there: taken for it, renamed",)


def test_a_fleet_of_rows(store: Path) -> None:
    assert set(pd.read_parquet(store)["robot"]) == {"broken", *(f"arm{k}" for k in range(6))}
    found = fleet_of(rows(store)[0], computed=7)
    figures, said = found.to_json(), " ".join(b.text for b in found.blocks() if isinstance(b, Words))
    assert "6 of 7 robots calibrated" in said
    assert "7 computed now, 0 from the store." in said
    by_name = {r["robot"]: r for r in figures["robots"]}
    assert by_name["broken"]["status"] == "failed"
    assert "title: is missing" in by_name["broken"]["error"]
    assert by_name["arm5"]["changes"].startswith("lengths, a jump since 2026-02-01: ")
    assert by_name["arm5"]["campaigns"] == 4
    assert "2026-04-01.csv is left out: 2026-04-01.csv: positions" in by_name["arm5"]["notes"]
    assert "2026-05-01.csv is left out: 2026-05-01.csv: row 5, column 'q1_deg': 'l" in by_name["arm5"]["notes"]
    assert all(by_name[f"arm{k}"]["after_mm"] < 0.1 < by_name[f"arm{k}"]["before_mm"] for k in range(6))
    every = next(b for s in found.page().sections for b in s.blocks if getattr(b, "title", "").startswith("Mean err"))
    assert every.columns.index("error") < every.columns.index("before")


@pytest.mark.slow
def test_the_command_on_a_worker_of_this_machine(plant: Path, tmp_path: Path) -> None:
    files = ("--json", tmp_path / "fleet.json", "--report", tmp_path / "fleet.html")
    options = ("--store", tmp_path / "fleet.parquet", "--workers", 1, "--no-diagnose", *files)
    command = run("fleet", plant, *options, width=120)
    assert command.returncode == 0, command.stderr
    assert "6 of 7 robots calibrated" in command.stdout
    assert "7 computed now, 0 from the store." in command.stdout.replace("\n", " ")
    assert "2026-04-01.csv is left out" in command.stdout.replace("\n", " ")
    assert json.loads((tmp_path / "fleet.json").read_text())["computed"] == 7
    assert "Map of accuracies" in (tmp_path / "fleet.html").read_text()


@pytest.mark.slow
def test_a_worker_that_is_killed_midway_loses_nothing(plant: Path, tmp_path: Path) -> None:
    import psutil

    killed: list[int] = []

    def kill(text: str) -> None:
        workers = []
        for p in psutil.Process().children(recursive=True):
            with suppress(psutil.Error):  # one that has just ended has no command line
                workers += [p] if "spawn_main" in " ".join(p.cmdline()) else []
        if text.startswith("robot 1 ") and workers:
            killed.append(workers[0].pid)
            workers[0].kill()

    found = run_fleet([plant], tmp_path / "fleet.parquet", workers=2, with_diagnosis=False, show=kill)
    assert killed
    assert sorted(found.robots["status"]) == ["failed", *["ok"] * 6]


def test_tables_and_robots_elsewhere_count_as_the_robots_own(plant: Path, tmp_path: Path) -> None:
    """A table beside the folders, as of problems that share a folder of data."""
    folder = tmp_path / "arm"
    shutil.copytree(plant / "arm0", folder)
    (tmp_path / "tables").mkdir()
    table, drawn = tmp_path / "tables" / "poses.csv", tmp_path / "robot.toml"
    (folder / "poses.csv").rename(table)
    (folder / "robot.toml").rename(drawn)
    text = (folder / "problem.toml").read_text().replace('"poses.csv"', '"../tables/poses.csv"')
    (folder / "problem.toml").write_text(text.replace("casadical = 1", 'casadical = 1\nrobot = "../robot.toml"'))
    found = [fingerprint(folder)]
    for path in (table, drawn):
        path.write_text(path.read_text() + "\n")
        found.append(fingerprint(folder))
    assert len(set(found)) == 3
    assert fingerprint(folder) == found[-1]


def test_a_bug_in_one_robot_is_a_row(plant: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(Position, "numbers", property(lambda _: 1 / 0))
    row = one_robot(str(plant / "arm0"), False)
    assert row["status"] == "bug"
    assert "ZeroDivisionError" in row["error"]


def test_robots_that_stand_out(good: pd.DataFrame) -> None:
    assert fleet_of(good).outliers == ()
    good.loc[good["robot"] == "arm3", "after_mm"] = 0.5
    assert fleet_of(good).outliers == ("arm3",)
    few, many = (
        next(b for b in fleet_of(some).blocks() if isinstance(b, Table) and b.title.startswith("Types"))
        for some in (good, pd.concat([good] * 4, ignore_index=True))
    )
    assert ["95 % below" in t.columns for t in (few, many)] == [False, True]  # no column that is empty
    assert many.rows[0][-1] == "0.5000"  # one in six has 0.5


def test_what_is_odd_about_campaigns_is_printed(good: pd.DataFrame) -> None:
    twice, outlier = "two campaigns of one day, both used: b", "b: 1 pose left out as outliers"
    good["notes"] = [f"{outlier}; {twice}", outlier, *good["notes"][2:]]
    (table,) = (b for b in fleet_of(good).blocks() if isinstance(b, Table) and b.title.startswith("Odd about"))
    assert table.rows[0] == ("arm0", twice)
    assert "arm1" not in {row[0] for row in table.rows}
    assert "arm5" not in {row[0] for row in table.rows}  # among those to check first


def test_a_type_has_one_name_in_all_outputs(good: pd.DataFrame) -> None:
    found = fleet_of(good.assign(type_name=[f"Planar arm SN {9 - k}" for k in range(len(good))]))
    assert {*found.robots["type_name"]} == {"Planar arm SN"}
    assert name_of_type(["b", "a", "b"]) == "b"
    assert name_of_type(["UR10e-2", "UR10e-1"]) == "UR10e-1"


def test_a_course_without_days_is_not_drawn_among_days_and_what_grew_is_named(good):
    days, none = [20000.0, 20030.0, 20060.0], float("nan")
    lives = {
        "arm0": ([none, *days[1:]], [0.02, 0.02, 0.05]),
        "arm1": ([none] * 3, [0.02] * 3),
        "arm2": (days, [0.02] * 3),
    }
    for k, column in enumerate(("days", "left_mm")):
        good[column] = [lives.get(n, (v, v))[k] for n, v in zip(good["robot"], good[column], strict=True)]
    good.loc[good["robot"].isin(list(lives)), "campaigns"] = 3
    good["left_free"] = [np.full(len(left), 40.0) for left in good["left_mm"]]
    found = fleet_of(good)
    drawn = {s.facts[0]: list(s.x) for s in found.figures()["trends"].series if s.facts}
    assert drawn["arm0"] == ["2024-11-03", "2024-12-03"]
    assert drawn["arm2"][0] == "2024-10-04"
    assert "arm1" not in drawn
    names = found.figures()["trends"].marks
    assert names[0].text == "arm0"  # from the top down, in the order of the lines' ends
    assert {a.text for a in names} >= {"arm0", "arm2", "arm5"}
    heights = [a.y for a in names]
    assert max(np.diff(heights)) <= -0.99 * MIN_LABEL_DISTANCE * max(good["left_mm"].map(np.nanmax))
    assert min(heights) >= 0
    to_check = next(b for b in found.blocks() if isinstance(b, Table) and "note" in b.columns)
    (step,) = found.next  # for the one with the greatest error
    assert (len(to_check.rows) > 1, to_check.rows[0][0] in step.text) == (True, True)
    assert {r[0]: r[-1] for r in to_check.rows}["arm0"].startswith("the last campaign leaves 0.050 mm per coordinate")
    for few in (3.0, float("nan")):  # so few degrees of freedom tell nothing, nor does a row without them
        assert fleet_of(good.assign(left_free=[np.full(len(left), few) for left in good["left_mm"]])).grown == {}
    assert fleet_of(good.drop(columns="left_free")).grown == {}
    undated = fleet_of(good[good["robot"] == "arm1"])
    assert [list(s.x) for s in undated.figures()["trends"].series] == [[1, 2, 3]]

"""A fleet of simulated arms: rows, what stands out, what a type shares; and its command on a real local cluster."""

import json
import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import run
from fleet_plants import A1, planar

from casadical import InputError, plot, read_robot
from casadical.core.reporting.blocks import Table, Words
from casadical.fleet.hierarchy import Common, common_of, population_of
from casadical.fleet.result import MIN_LABEL_DISTANCE, Fleet, fleet_of, name_of_type, trends
from casadical.fleet.run import EMPTY_ROW, add, fingerprint, one_robot, records, rows, run_fleet
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
    assert [(c.count, c.faults[0][0]) for c in fleet.commons] == [(6, "a1")]


def test_a_fleet_of_rows(store: Path) -> None:
    assert set(pd.read_parquet(store)["robot"]) == {"broken", *(f"arm{k}" for k in range(6))}
    found = fleet_of(rows(store)[0], computed=7)
    figures, said = found.to_json(), " ".join(b.text for b in found.blocks() if isinstance(b, Words))
    assert "6 of 7 robots calibrated" in said
    assert "7 computed now, 0 from the store." in said
    assert "a1 is +0.4" in said
    by_name = {r["robot"]: r for r in figures["robots"]}
    assert by_name["broken"]["status"] == "failed"
    assert "title: is missing" in by_name["broken"]["error"]
    assert figures["types"][0]["corrections"]["a1"].startswith("[[joint]] 2: a_mm = 400.4")
    assert by_name["arm5"]["changes"].startswith("lengths, a jump since 2026-02-01: ")
    assert by_name["arm5"]["campaigns"] == 4
    assert "2026-04-01.csv is left out: 2026-04-01.csv: positions" in by_name["arm5"]["notes"]
    assert "2026-05-01.csv is left out: 2026-05-01.csv: row 5, column 'q1_deg': 'l" in by_name["arm5"]["notes"]
    assert all(by_name[f"arm{k}"]["after_mm"] < 0.1 < by_name[f"arm{k}"]["before_mm"] for k in range(6))
    every = next(b for s in found.page().sections for b in s.blocks if getattr(b, "title", "").startswith("Mean err"))
    assert every.columns.index("error") < every.columns.index("before")
    ((_, prior),) = found.prior_files("priors").items()
    assert "6 robots of one fleet" in prior


@pytest.mark.slow
def test_the_command_on_a_worker_of_this_machine(plant: Path, tmp_path: Path) -> None:
    files = ("--json", tmp_path / "fleet.json", "--report", tmp_path / "fleet.html", "--priors", tmp_path / "priors")
    options = ("--store", tmp_path / "fleet.parquet", "--workers", 1, "--no-diagnose", *files)
    command = run("fleet", plant, *options, width=120)
    assert command.returncode == 0, command.stderr
    assert "6 of 7 robots calibrated" in command.stdout
    assert "7 computed now, 0 from the store." in command.stdout.replace("\n", " ")
    assert "\n    [[joint]] 2: a_mm = 400.4" in command.stdout
    assert "2026-04-01.csv is left out" in command.stdout.replace("\n", " ")
    assert json.loads((tmp_path / "fleet.json").read_text())["computed"] == 7
    assert "Map of accuracies" in (tmp_path / "fleet.html").read_text()
    (prior,) = (tmp_path / "priors").glob("*.robot.toml")
    common = read_robot(prior)
    assert common.parameters["a1"].value == pytest.approx(A1, abs=2e-4)
    assert common.knowledge is not None
    assert common.knowledge.robots == 6


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


def packed(H: list[np.ndarray]) -> list[np.ndarray]:
    """Lower triangles, as a store has them."""
    return [one[np.tril_indices(len(one))] for one in H]


def test_means_and_spreads_of_a_fleet_are_found() -> None:
    """Of 200 robots with a correlated measurement each; two parameters, one with a common departure."""
    rng = np.random.default_rng(0)
    mean, spread = np.array([0.3, 0.0, 0.0]), np.array([0.2, 0.05, 0.4])
    H, b = [], []
    for _ in range(200):
        J = rng.normal(size=(6, 3))
        theta = mean + spread * rng.normal(size=3)
        y = J @ theta + 0.1 * rng.normal(size=6)
        H.append(J.T @ J / 0.01)
        b.append(J.T @ y / 0.01)
    found, C, tau = population_of(packed(H), np.array(b), np.full(3, 3.0))
    error = np.sqrt(np.diag(C))
    assert np.abs(found - mean).max() < 0.1
    assert (np.abs(found - mean) < 4 * error).all()
    assert tau == pytest.approx(spread, rel=0.25)
    alone = np.mean([np.diag(np.linalg.inv(one)) for one in H], axis=0)
    assert error == pytest.approx(np.sqrt((spread**2 + alone) / 200), rel=0.3)


def test_the_spread_of_five_exact_robots_is_that_of_a_sample() -> None:
    """Over one less than their number, for they make the mean."""
    values = np.random.default_rng(2).normal(size=(5, 4))
    H = np.array([np.eye(4) * 1e8] * 5)
    _, _, tau = population_of(packed(H), 1e8 * values, np.full(4, 30.0))
    np.testing.assert_allclose(tau, values.std(axis=0, ddof=1), rtol=1e-2)


def test_the_spread_of_few_robots_is_near_that_of_like_parameters() -> None:
    """Six robots, noise as great as the spread 0.05: alone, some spreads come out as nothing."""
    rng = np.random.default_rng(0)
    theta = 0.05 * rng.normal(size=(6, 12))
    y = theta + 0.05 * rng.normal(size=theta.shape)
    H, b, wide = packed([400 * np.eye(12)] * 6), 400 * y, np.full(12, 1.0)
    alone, pooled = population_of(H, b, wide)[2], population_of(H, b, wide, groups=["length"] * 12)[2]
    assert alone.min() < 0.01
    assert pooled.min() > 0.025
    assert pooled.max() < 0.1


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
    with pytest.raises(InputError, match="5 are needed"):
        common_of(records(good.iloc[:4]))


def test_what_is_odd_about_campaigns_is_printed(good: pd.DataFrame) -> None:
    twice, outlier = "two campaigns of one day, both used: b", "b: 1 pose left out as outliers"
    good["notes"] = [f"{outlier}; {twice}", outlier, *good["notes"][2:]]
    (table,) = (b for b in fleet_of(good).blocks() if isinstance(b, Table) and b.title.startswith("Odd about"))
    assert table.rows[0] == ("arm0", twice)
    assert "arm1" not in {row[0] for row in table.rows}
    assert "arm5" not in {row[0] for row in table.rows}  # among those to check first


def test_a_type_has_one_name_in_all_outputs(good: pd.DataFrame) -> None:
    found = fleet_of(good.assign(type_name=[f"Planar arm SN {9 - k}" for k in range(len(good))]))
    ((_, text),) = found.prior_files("priors").items()
    assert 'name = "Planar arm SN"' in text
    assert {found.commons[0].name, *found.robots["type_name"]} == {"Planar arm SN"}
    assert name_of_type(["b", "a", "b"]) == "b"
    assert name_of_type(["UR10e-2", "UR10e-1"]) == "UR10e-1"


def test_what_a_type_shares_is_the_same_in_any_order_of_parameters_and_whatever_few_robots_identified() -> None:
    """Of a store, whose rows are read one by one."""
    rng = np.random.default_rng(0)
    names, rows_ = ["a1", "a2", "d3"], []
    for k in range(12):
        J = rng.normal(size=(8, 3))
        H, b = J.T @ J / 0.01, J.T @ (J @ np.array([0.3, -0.2, 0.1]) + 0.1 * rng.normal(size=8)) / 0.01
        order = [2, 0, 1] if k else [0, 1, 2]
        rows_.append({
            **EMPTY_ROW, "type": "t", "type_name": "arm", "names": [names[i] for i in order], "score": b[order],
            "information": packed([H[np.ix_(order, order)]])[0], "spread": [1.0] * 3, "scale": [1e-3] * 3,
            "identified": ["a1", "a2"] + ["d3"] * (k < 6),
        })  # fmt: skip
    found = common_of(rows_)
    assert found.names == ("a1", "a2")
    assert found.mean == pytest.approx([0.3, -0.2], abs=0.1)
    assert common_of(row | {"identified": names} for row in rows_).mean == pytest.approx([0.3, -0.2, 0.1], abs=0.1)


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


def test_departures_of_lengths_angles_and_curves_are_in_mm_and_mrad() -> None:
    scale = np.array([1e-3, 1e-3, 6e-5, 1e-6])
    names = ("a1", "alpha2", "joint_error_curve.c1_q1", "c2")
    common = Common(
        "t", "arm", 9, names, np.array([0.3, 0.4, 2.0, 1.5]), np.full(4, 0.01), np.full(4, 0.1), scale, np.eye(4)
    )
    good = pd.DataFrame([{**EMPTY_ROW, "robot": "arm", "type": "t"}])
    figure = plot(Fleet(good, (common,), ()), "common/t")
    assert list(figure.data[0].x) == pytest.approx([0.3, 0.4, 0.12, 1.5])
    assert figure.layout.xaxis.title.text == "common departure [mm or mrad]"
    assert list(figure.data[0].customdata[3]) == ["c2", "+1.5 urad/(N m) +/- 0.01"]


def test_joints_that_yield_are_one_sentence_and_lengths_another() -> None:
    figures = np.array([[0.3, -0.2, 2.0, 1.5], [0.01] * 4, [0.1] * 4, [1e-3, 1e-3, 1e-6, 1e-6]])
    common = Common("ab", "arm", 9, ("a1", "d4", "c1", "c2"), *figures, 1e-4 * np.eye(4), frozenset({"c2"}))
    good = pd.DataFrame({name: [] for name in EMPTY_ROW}).astype({"robot": str, "notes": str, "changes": str})
    words = [b.text for b in Fleet(good, (common,), ()).blocks() if isinstance(b, Words) and b.kind == "warning"]
    assert [text.split(": ", 1)[1] for text in words] == [
        "a1 is +0.3 mm +/- 0.01, d4 -0.2 mm +/- 0.01 from the drawing: correct the drawing, or the set-up of the "
        "instrument.",
        "c1 is +2 urad/(N m) +/- 0.01, c2 +1.5 um/N +/- 0.01 from the drawing: their joints yield otherwise than it "
        "says; correct the compliances in the robot file.",
    ]


def test_of_many_robots_those_that_changed_or_grew_are_named() -> None:
    names = [f"arm{k}" for k in range(14)]
    lives = {"campaigns": 2, "days": [[19000.0, 19400.0]] * 14, "left_mm": [[0.05, 0.06]] * 14}
    good = pd.DataFrame({"robot": names, "changes": ["a crash"] * 2 + [""] * 12, **lives})
    assert sorted(mark.text for mark in trends(good, {"arm5"}).marks) == ["arm0", "arm1", "arm5"]
    assert sorted(mark.text for mark in trends(good[:9], ()).marks) == names[:9]

"""One result of a calibrated problem: printed, kept and shown on a page with the same figures."""

import dataclasses
import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "studies"))
from types import SimpleNamespace

import arms
import users

from casadical import Calibration, InputError, calibrate, read_problem, read_robot, report
from casadical.core.reporting.blocks import Table, Words
from casadical.core.reporting.result import plain_text
from casadical.diagnosis.localisation import Localisation
from casadical.identification import errors, residual_mm
from casadical.identification.accuracy import Accuracy
from casadical.project.calibration import accuracy_without_prior
from casadical.project.calibration_page import _errors_of, residual_localisation
from casadical.project.new import new_problem
from casadical.project.outcome import changed_readings, report_blocks
from casadical.project.planning import declared_kinds_and_noise

ROOT = Path(__file__).parents[2]
PLANAR = ROOT / "problems" / "planar"


def test_a_problem_that_was_read_gives_what_its_folder_gives(calibrated) -> None:
    problem = read_problem(PLANAR)
    found = calibrate(problem)
    assert found.to_json() == calibrated("planar").to_json()
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.networks = None  # type: ignore[misc]
    with pytest.raises(InputError, match="seed 3: this problem is split"):
        calibrate(problem, seed=3)


def test_as_text_it_is_what_the_command_prints(calibrated) -> None:
    printed = "".join(line.rstrip() + "\n" for line in str(calibrated("planar")).splitlines())
    text, _, _ = (ROOT / "tests" / "cli" / "planar.txt").read_text().partition("\nNext, ")  # of the command alone
    assert printed == text.rstrip("\n") + "\n"


def test_every_table_that_is_printed_stands_on_the_page(calibrated) -> None:
    """Cell by cell; of the parameters the page shows those that were held, too."""
    c = calibrated("hh800")
    page = [b for s in c.page().sections for b in s.blocks if isinstance(b, Table)]
    tables = [b for b in c.blocks() if isinstance(b, Table)]
    assert len(tables) == 4 + 1 + 2 + 1 + 1  # sets, networks, paper, parameters, held
    for table in tables:
        same = next(t for t in page if t.columns == table.columns and set(table.rows) <= set(t.rows))
        assert (same == table) or "All parameters" in same.title
    sentences = {b.text for s in c.page().sections for b in s.blocks if isinstance(b, Words)}
    assert {b.text for b in c.blocks() if isinstance(b, Words) and b.kind == "verdict"} <= sentences


def test_the_papers_tables_hold_one_standard_deviation(calibrated) -> None:
    """The sample's, of identifications and of networks as they were trained, from the errors of each pose."""
    c = calibrated("hh800")
    table = next(b for b in c.blocks() if isinstance(b, Table) and "validation" in b.title)
    assert "n - 1" in table.title
    m = c.problem.sets["report"][0]
    left = {method: 1e3 * errors(result.robot, m) for method, result in c.identifications.items()}
    for method, r in c.networks.results.items():
        rest = residual_mm(c.robot, m) - r.compensator.trained.output_mm(m.q)
        left[method] = np.linalg.norm(rest, axis=1)
    rows = {row[0].rstrip("*"): row for row in table.rows}
    assert rows.keys() == {"before", *left}
    for method, e in left.items():
        assert rows[method][2:5] == tuple(f"{v:.4f}" for v in (e.mean(), e.max(), e.std(ddof=1)))


def test_what_is_written_is_fitted_to_all_poses_and_judged_before(tmp_path: Path) -> None:
    """One of three times the poses; the held-out errors are those of the fit that has not seen them."""
    folder = tmp_path / "planar"
    shutil.copytree(PLANAR, folder)
    text = (folder / "problem.toml").read_text().replace("../../data", str(ROOT / "data"))

    def found(sets: str) -> Calibration:
        (folder / "problem.toml").write_text(
            re.sub(r"\[sets\]\n(.+\n)*", f"[sets]\nidentify = {0.7 if sets else 1}\n{sets}\n", text)
        )
        return calibrate(folder)

    judged, again, every = (found(s) for s in ("report = 0.3", "report = 0.3\nrefit = true", ""))
    same, more, whole = (c.parameters.values for c in (again.robot, again.written_robot, every.robot))
    assert again.to_json()["methods"]["KM"]["sets"] == judged.to_json()["methods"]["KM"]["sets"]
    np.testing.assert_array_equal(same, judged.robot.parameters.values)
    np.testing.assert_allclose(more, whole, atol=1e-9)
    assert abs(more - same).max() > 1e-6
    assert "fitted again, to all 40 poses" in str(again)
    assert "fitted again" not in str(judged)
    files = {path.name: content for path, content in again.files("results").items()}
    assert files["KM.parameters.csv"] == again.written["KM"].parameters.to_csv(index=False)
    told = json.loads(files["result.json"])
    assert told["refit_poses"] == 40
    assert told["methods"]["KM"]["parameters"] == again.written["KM"].to_json()["parameters"]


@pytest.mark.slow
def test_compliance_that_the_fitted_poses_are_too_few_for_shows_in_all(tmp_path: Path) -> None:
    """Fifty lengths by three wires, two of them wrong, of an arm that sags: there the compliant fit does not end."""
    user = replace(users.drawn(413), slips={"rows": 2})
    users.written(tmp_path, user, users.table(user, user.q, user.seen, wrong=True))
    users.robot_file(tmp_path, user)
    (table,) = (path for path in tmp_path.glob("table0*"))
    found = calibrate(new_problem(tmp_path / "arm", dh=tmp_path / "dh.csv", data=table))
    assert found.identification.method == "SKCM"
    assert {out.row for out in found.identification.left_out} == {10, 24}
    assert found.accuracies["SKCM"]["report"]["calibrated"].mean < 1e-4


def test_files_are_written_all_or_none(calibrated, tmp_path: Path) -> None:
    c = calibrated("planar")
    (tmp_path / "taken" / "KM.parameters.csv").mkdir(parents=True)
    with pytest.raises(InputError, match=r"KM\.parameters\.csv: is a folder"):
        c.write(tmp_path / "taken")
    assert [p.name for p in (tmp_path / "taken").iterdir()] == ["KM.parameters.csv"]
    c.write(tmp_path / "kept")
    assert sorted(p.name for p in (tmp_path / "kept").iterdir()) == [
        "KM.parameters.csv",
        "KM.robot.toml",
        "result.json",
    ]
    assert json.loads((tmp_path / "kept" / "result.json").read_text()) == json.loads(json.dumps(c.to_json()))
    m = c.problem.sets["report"][0]
    again = errors(read_robot(tmp_path / "kept" / "KM.robot.toml"), m).mean()
    assert again == pytest.approx(c.accuracies["KM"]["report"]["calibrated"].mean, abs=1e-9)


def test_a_logged_payload_that_the_robot_file_does_not_know_is_said(tmp_path: Path) -> None:
    given = ROOT / "problems" / "ur10e"
    campaign = (ROOT / "data" / "campaigns" / "practice" / "ur10e-P03.csv").read_text()
    (tmp_path / "poses.csv").write_text(campaign.replace("payload_kg", "Traglast [kg]"))
    (tmp_path / "problem.toml").write_text(
        'casadical = 1\ntitle = "t"\ndata = "synthetic"\nmethods = ["SKCM"]\n[[measurements]]\nfile = "poses.csv"\n'
        'columns = { payload_kg = "Traglast [kg]" }\n'
    )
    robot = (given / "robot.toml").read_text()
    (tmp_path / "robot.toml").write_text(robot)
    said = "the robot file has no [payload]"
    known = calibrate(tmp_path)
    assert said not in plain_text(known.brief())
    # A heading of which payload_kg was made is used; it is no column of its own.
    assert "Traglast" not in re.sub(r"\s+", " ", str(known))
    (tmp_path / "robot.toml").write_text(re.sub(r"\[payload\]\n(?:.+\n)+", "", robot))
    assert said in re.sub(r"\s+", " ", plain_text(calibrate(tmp_path).brief()))


def test_readings_that_problem_toml_makes_are_said_with_the_result() -> None:
    problem = read_problem(PLANAR)
    made = {
        "q1_deg": {"from": "Achse 1", "times": -1.0},
        "q2_deg": {"from": "Achse 2", "plus": 90.0},
        "q3_deg": {"from": "Achse 3", "times": 57.29577951},
        "q4_mm": {"from": "column_m", "times": 0.5, "plus": -0.706},
        "q5_deg": {"from": "Achse 5", "times": 0.5, "add": {"Achse 2": -2.0}, "rows": -1},
        "x_mm": {"from": "X", "times": -1.0},
    }
    (words,) = report_blocks(
        replace(problem, tables=({"file": "poses.csv", "columns": made},)), {}, block="made_readings"
    )
    assert "q1 = -'Achse 1', q2 = 'Achse 2' +90, q4 = 0.5 x 'column_m' -0.706, " in words.text
    assert "q5 = 0.5 x 'Achse 5' - 2 x 'Achse 2', 1 row above. " in words.text
    assert "Achse 3" not in words.text
    assert changed_readings(problem) == []


@pytest.mark.parametrize(
    ("before", "after", "n", "words"),
    [
        (1.228, 1.484, 11, "is 1.484 mm with KM, 1.228 mm before: these poses cannot tell which is better; if"),
        (1.484, 1.228, 11, "is 1.228 mm with KM, 1.484 mm before: these poses cannot tell which is better; if"),
        (1.228, 1.484, 80, "grows from 1.228 mm to 1.484 mm with KM (21 % more)"),
        (1.484, 1.228, 80, "falls from 1.484 mm to 1.228 mm with KM (17 % less)"),
        (1.0, 1.0, 80, "is 1.000 mm with KM, 1.000 mm before: these poses cannot tell which is better."),
        (1.0e-6, 1.26e-6, 80, "is 0.0000 mm, before and with KM."),  # exact data
    ],
)
def test_a_difference_within_its_uncertainty_is_none(calibrated, before, after, n, words) -> None:
    """Errors scatter by 0.7 mm: 0.256 mm are twice their standard error at 2 (2 0.7 / 0.256)^2 poses."""
    problem = calibrated("planar").problem
    std = 0.7e-3 * (before > 0.1)
    placed, found = (Accuracy(n, 1e-3 * mean, 3e-3, std, 2e-3, 3e-3) for mean in (before, after))
    states = {"KM": {"report": {"nominal": placed, "placed": placed, "calibrated": found}}}
    said = " ".join(plain_text(report_blocks(problem, states, block="verdict")).split())
    assert f"the mean position error {words}" in said
    assert ("if this difference stays, some 49 more would." in said) == (n == 11)


def test_an_error_is_localised_in_positions_of_one_set_only(calibrated) -> None:
    planar = calibrated("planar")
    assert isinstance(residual_localisation(planar.identification), Localisation)
    result = planar.identification
    (m,) = result.measurements
    distances = replace(m, kind="distance", position=None, distance=np.ones(len(m)), target=np.zeros((len(m), 3)))
    for sets in ((m, m), (distances,)):
        assert residual_localisation(replace(result, measurements=sets)) is None
    # It was made ten times better, so no data are asked for.
    assert not report_blocks(planar.problem, planar.accuracies, block="no_better", last=result)


def test_too_few_poses_without_the_prior_are_no_error(calibrated) -> None:
    planar = calibrated("planar")
    used = dict(planar.problem.parts())
    assert accuracy_without_prior(planar.problem, planar.identifications, used) is not None
    few = replace(planar.problem, sets={**planar.problem.sets, "identify": (planar.problem.sets["identify"][0][:2],)})
    assert accuracy_without_prior(few, planar.identifications, used) is None


def test_of_many_poses_some_tell_where_the_error_lies(calibrated) -> None:
    planar = calibrated("planar")
    result = planar.identification
    ways = {row.part for row in dict(residual_localisation(result).tables())["approach"].itertuples()}
    (m,) = result.measurements
    many = m[np.tile(np.arange(len(m)), 1 + 5000 // len(m))]
    sets = (replace(many, row=np.arange(len(many))),)
    result = replace(result, measurements=sets, outliers=(), problem=replace(result.problem, sets=sets))
    found = dict(residual_localisation(result).tables())
    for name in ("regions", "time", "approach"):
        assert set(found[name].groupby("by").poses.sum()) <= {4999, 5000}  # the first was approached from nowhere
    assert {row.part for row in found["approach"].itertuples()} == ways
    assert "5000 of the poses it was identified from" in report([replace(planar, identifications={"KM": result})])


def test_a_plan_takes_the_kind_of_a_table_that_says_none(tmp_path: Path) -> None:
    robot = read_problem(PLANAR).robot
    data = PLANAR.parents[1] / "data" / "planar" / "planar.csv"
    text = (PLANAR / "problem.toml").read_text().replace("../../data/planar/planar.csv", str(data))
    for name, kind in (("said", 'kind = "position"'), ("read", "")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "problem.toml").write_text(text.replace('kind = "position"', kind))
        shutil.copy(PLANAR / "robot.toml", tmp_path / name)
        assert declared_kinds_and_noise(tmp_path / name, robot)[0] == ("position",)


def test_a_robot_that_is_as_its_drawing_needs_no_calibration(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    first, second = rng.uniform(-np.pi, np.pi, (2, 40))
    x, y = (0.4 * f(first) + 0.3 * f(first + second) + rng.normal(0, 5e-5, 40) for f in (np.cos, np.sin))
    columns = [np.rad2deg(first), np.rad2deg(second), 1e3 * x, 1e3 * y, rng.normal(0, 0.05, 40)]
    np.savetxt(
        tmp_path / "poses.csv",
        np.column_stack(columns),
        "%.6f",
        ",",
        header="q1_deg,q2_deg,x_mm,y_mm,z_mm",
        comments="",
    )
    shutil.copy(PLANAR / "robot.toml", tmp_path)
    text = (PLANAR / "problem.toml").read_text().replace("../../data/planar/planar.csv", "poses.csv")
    (tmp_path / "problem.toml").write_text(text)
    printed = plain_text(calibrate(tmp_path).brief())
    assert len(printed.splitlines()) <= 25 - 6  # the command adds blank lines, files and what to run next
    said = " ".join(printed.split())
    assert "only the frames were found, and nominal and calibrated robot are equally good to within" in said
    assert "keep the nominal robot" not in said


def test_errors_have_directions_where_positions_were_measured() -> None:
    arm = arms.six_axis()
    q = arms.readings(arm, 5, 0)
    placed, ball = arms.positions(arm, q, 1), arms.distances(arm, q, np.ones(3), 1)
    assert _errors_of("before", arm, placed).vector.shape == (5, 3)
    assert _errors_of("before", arm, ball).vector is None


@pytest.mark.parametrize(("written", "words"), [(False, "--out results"), (True, "casadical diagnose arm")])
def test_a_result_that_is_not_kept_is_kept_next(written: bool, words: str, monkeypatch) -> None:
    even = SimpleNamespace(mean=1e-4)
    monkeypatch.setattr("casadical.project.calibration.judged_on", lambda _: ("", even, even, True))
    assert words in Calibration.next_command(SimpleNamespace(accuracies={}), Path("arm"), written=written).code

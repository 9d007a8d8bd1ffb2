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
import users

from casadical import Calibration, InputError, calibrate, read_problem, read_robot
from casadical.core.telling.blocks import Table, Words
from casadical.core.telling.result import plain_text
from casadical.identification import errors, residual_mm
from casadical.project.new import new_problem

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


def test_the_last_method_counts(calibrated) -> None:
    c = calibrated("hh800")
    assert list(c.identifications) == ["KM", "SKCM"]
    assert c.identification is c.identifications["SKCM"]
    assert c.robot is c.identification.robot


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
    table = users.written(tmp_path, "table", user, users.table(user, user.q, user.seen, wrong=True))
    users.robot_file(tmp_path, user)
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


def test_a_robot_that_is_not_from_a_urdf_has_none_to_write(calibrated) -> None:
    c = calibrated("planar")
    with pytest.raises(InputError, match="its robot is not from a URDF"):
        c.problem.calibrated_urdf(c.robot)


def test_brackets_stay_in_the_text_and_nothing_is_cut() -> None:
    """A console of rich takes [mm] for a style unless it is told not to."""
    table = Table("Error [mm]", ("a [bold]", "why", "n"), [("x[red]", "because " * 30, "1.5")], frozenset({2}))
    text = plain_text([Words("[b]first[/b]", "title"), table, Words("last")], width=60)
    for part in ("[b]first[/b]", "Error [mm]", "a [bold]", "x[red]", "1.5"):
        assert part in text
    assert len(re.findall("because", text)) == 30
    assert text.splitlines()[1].strip() == ""
    assert max(map(len, text.splitlines())) <= 60


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


def test_a_robot_file_that_is_missing_is_not_called_bad_toml(tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        read_robot(tmp_path / "none.toml")
    assert str(refused.value).endswith("none.toml: no such file")
    assert "TOML:" not in str(refused.value)

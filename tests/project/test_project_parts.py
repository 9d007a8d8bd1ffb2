"""Parts of a problem folder's checks, plans and words that whole commands show only now and then."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from casadical import InputError, Measurements, report
from casadical.diagnosis.localisation import Localisation
from casadical.project.calibration import accuracy_without_prior
from casadical.project.calibration_page import residual_localisation
from casadical.project.check.findings import MAX_SCATTER_TO_NOISE, far_rows, outlook_findings
from casadical.project.check.information import outlook
from casadical.project.check.result import Precheck
from casadical.project.check.slip_fit import Hypothesis
from casadical.project.check.slips import outside
from casadical.project.new.texts import Given, with_measured
from casadical.project.outcome import changed_readings, report_blocks
from casadical.project.planning import declared_kinds_and_noise, plan
from casadical.project.problem import read_problem

if TYPE_CHECKING:
    from casadical.project.check.information import Outlook
    from casadical.project.problem import Problem

PLANAR = Path(__file__).parents[2] / "problems" / "planar"
DATA = PLANAR.parents[1] / "data" / "planar" / "planar.csv"


@pytest.fixture(scope="module")
def planar() -> Problem:
    return read_problem(PLANAR)


@pytest.fixture(scope="module")
def seen(planar: Problem) -> Outlook:
    return outlook(planar.robot, planar.sets["identify"], ["kinematic"], "KM", noise=2e-5)


def test_a_forecast_is_the_same_every_time_and_that_of_seed_zero(planar: Problem, seen: Outlook) -> None:
    again = outlook(planar.robot, planar.sets["identify"], ["kinematic"], "KM", noise=2e-5, seed=0)
    assert seen.accuracy == again.accuracy
    other = outlook(planar.robot, planar.sets["identify"], ["kinematic"], "KM", noise=2e-5, seed=1)
    assert seen.accuracy != other.accuracy  # other poses of the task
    assert seen.accuracy == pytest.approx(other.accuracy, rel=0.1)


def test_a_misfit_is_more_than_four_times_the_noise(planar: Problem, seen: Outlook) -> None:
    def misfits(scatter: float) -> list[str]:
        found = outlook_findings(replace(seen, scatter=scatter), planar.robot, 1e-4)
        return [f.topic for f in found if f.topic == "misfit"]

    assert MAX_SCATTER_TO_NOISE == 4
    assert misfits(4e-4) == []
    assert misfits(4.01e-4) == ["misfit"]


def test_no_accuracy_is_promised_from_too_few_numbers(seen: Outlook) -> None:
    few = replace(seen, numbers=seen.unknowns)
    none = replace(seen, names=(), errors=np.zeros(0))
    told = Precheck(PLANAR, (), outlooks=(replace(seen, method="A"), replace(few, method="B"), none)).to_json()[
        "methods"
    ]
    assert told["A"]["expected_accuracy_mm"] == pytest.approx(1e3 * seen.accuracy)
    assert told["B"]["expected_accuracy_mm"] is None
    assert told["KM"]["expected_accuracy_mm"] is None


def test_readings_a_hundredth_beyond_the_limits_are_within(planar: Problem) -> None:
    robot = planar.robot
    lower, upper = np.array([(j.lower, j.upper) for j in robot.joints]).T
    nothing = Hypothesis.none(robot.n)
    for q, wanted in ((upper + 0.005, False), (upper + 0.02, True), (lower - 0.005, False), (lower - 0.02, True)):
        assert outside(nothing, robot, np.tile(q, (20, 1))) is wanted


def test_each_measured_point_has_a_table_of_its_own() -> None:
    text = 'name = "r"\n\n[tool]\nxyz_mm = [1, 2, 3]\nunknown = "position"\n\n[base]\nrx = 1\n\n[[joint]]\na_mm = 4\n'
    tables = "".join(
        f'[[tool]]  # measured point {n}\nname = "{n}"\nxyz_mm = [1, 2, 3]\nunknown = "position"\n\n'
        for n in ("A", "B")
    )
    assert (
        with_measured(text, Given(tools=["A", "B"])) == f'name = "r"\n\n{tables}[base]\nrx = 1\n\n[[joint]]\na_mm = 4\n'
    )


def test_the_forecast_of_a_plan_goes_twenty_poses_beyond_it(planar: Problem) -> None:
    found = plan(planar.robot, 6, order=False)
    assert found.forecast.poses[-1] == 26


def test_too_few_poses_without_the_prior_are_no_error(calibrated: Any) -> None:
    planar = calibrated("planar")
    assert accuracy_without_prior(planar.problem, planar.identifications) is not None
    few = replace(planar.problem, sets={**planar.problem.sets, "identify": (planar.problem.sets["identify"][0][:2],)})
    assert accuracy_without_prior(few, planar.identifications) is None


def test_of_many_poses_some_tell_where_the_error_lies(calibrated: Any) -> None:
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


def test_an_error_is_localised_in_positions_of_one_set_only(calibrated: Any) -> None:
    planar = calibrated("planar")
    assert isinstance(residual_localisation(planar.identification), Localisation)
    result = planar.identification
    (m,) = result.measurements
    distances = replace(m, kind="distance", position=None, distance=np.ones(len(m)), target=np.zeros((len(m), 3)))
    for sets in ((m, m), (distances,)):
        assert residual_localisation(replace(result, measurements=sets)) is None
    # It was made ten times better, so no data are asked for.
    assert not report_blocks(planar.problem, planar.accuracies, block="no_better", last=result)


def test_readings_that_problem_toml_makes_are_said_with_the_result(planar: Problem) -> None:
    made = {
        "q1_deg": {"from": "Achse 1", "times": -1.0},
        "q2_deg": {"from": "Achse 2", "plus": 90.0},
        "q3_deg": {"from": "Achse 3", "times": 57.29577951},
        "q4_mm": {"from": "column_m", "times": 0.5, "plus": -0.706},
        "q5_deg": {"from": "Achse 5", "times": 0.5, "add": {"Achse 2": -2.0}, "rows": -1},
        "x_mm": {"from": "X", "times": -1.0},
    }
    (words,) = report_blocks(
        replace(planar, tables=({"file": "poses.csv", "columns": made},)), {}, block="made_readings"
    )
    assert "q1 = -'Achse 1', q2 = 'Achse 2' +90, q4 = 0.5 x 'column_m' -0.706, " in words.text
    assert "q5 = 0.5 x 'Achse 5' - 2 x 'Achse 2', 1 row above. " in words.text
    assert "Achse 3" not in words.text
    assert changed_readings(planar) == []


@pytest.mark.parametrize("key", ["identify", "train", "choose", "report"])
def test_a_set_of_no_poses_is_refused(key: str, tmp_path: Path) -> None:
    shutil.copy(PLANAR / "robot.toml", tmp_path)
    table = f'casadical = 1\n[[measurements]]\nfile = "{DATA}"\n[sets]\n{key} = 0\n'
    (tmp_path / "problem.toml").write_text(table)
    with pytest.raises(InputError, match=rf"sets\.{key} = 0"):
        read_problem(tmp_path)


def test_a_plan_takes_the_kind_of_a_table_that_says_none(tmp_path: Path) -> None:
    robot = read_problem(PLANAR).robot
    text = (PLANAR / "problem.toml").read_text().replace("../../data/planar/planar.csv", str(DATA))
    for name, kind in (("said", 'kind = "position"'), ("read", "")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "problem.toml").write_text(text.replace('kind = "position"', kind))
        shutil.copy(PLANAR / "robot.toml", tmp_path / name)
        assert declared_kinds_and_noise(tmp_path / name, robot)[0] == ("position",)


@pytest.mark.parametrize("far", [8, 9])
def test_eight_rows_that_are_far_off_are_named(far: int) -> None:
    problem = read_problem(PLANAR)
    sets = [m for name in ("identify", "report") for m in problem.sets[name]]
    q, p = (np.concatenate([getattr(m, name) for m in sets]) for name in ("q", "position"))
    away = np.random.default_rng(1).normal(size=(far, 3))
    p[:far] += 0.03 * away / np.linalg.norm(away, axis=1)[:, None]
    (found,) = far_rows(problem.robot, Measurements(q=q, kind="position", position=p))
    assert found.text.count(" mm)") == 8
    assert (" mm) ... are" in found.text) == (far > 8)

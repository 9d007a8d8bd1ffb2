"""What a change is said to mean, and how it is drawn."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lives import as_built, changed, measured

from casadical import plot
from casadical.fleet.campaigns import name_of
from casadical.fleet.changes import MEANINGS, Change, times_in_words
from casadical.fleet.comparison import compare, courses_of
from casadical.fleet.estimates import estimate
from casadical.fleet.evidence import RELATIVE_FREQUENCY, Candidate

ZERO = Candidate("joint_zero", 2, ("theta2",), np.ones((1, 1)), np.array([3e-4]))
JUMP = Change(ZERO, "jump", 1, (1, 1), 1.0, 1.0, 9.0, (), (), np.zeros((2, 2)))


def test_a_drift_of_a_zero_is_no_crash() -> None:
    assert JUMP.words == "the zero of joint 2 is another: a crash, a slipped belt or a lost reference"
    drift = replace(JUMP, course="drift").words
    assert "crash" not in drift
    assert "wear" in drift


def test_each_kind_of_change_has_words_for_the_courses_that_it_may_have() -> None:
    for kind in RELATIVE_FREQUENCY:
        possible = {course for course, *_ in courses_of(kind, np.arange(4) / 12, dated=True)}
        assert possible == {course for course, words in MEANINGS.items() if kind in words}


def test_a_change_is_drawn_in_the_unit_of_its_parameter() -> None:
    pytest.importorskip("plotly")

    robot, built = as_built(np.random.default_rng(1))
    truths = (built, built, changed(built, theta5=5e-4))
    figures = plot(compare([estimate((robot, measured(t, k)), str(k)) for k, t in enumerate(truths)]))
    figure = figures["change/joint_zero@5"]
    assert figure.layout.yaxis.title.text == "zero of joint 5 [deg]"
    (drawn,) = figure.data
    assert drawn.y == pytest.approx([0.0, 0.0, np.rad2deg(5e-4)], abs=5e-3)
    assert (drawn.error_y.array[1:] > 0.001).all()
    assert (drawn.error_y.array < 0.01).all()


def test_odds_beyond_all_measure_are_not_counted() -> None:
    assert [times_in_words(odds * np.log(10)) for odds in (2, 99, 8871)] == ["100", "1e99", "more than 1e100"]


def test_a_robot_is_called_by_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = tmp_path / "R-1207"
    tables = [own / "campaigns" / f"2026-0{k}.csv" for k in (1, 2)]
    monkeypatch.chdir(tmp_path)
    assert name_of(tables) == "R-1207"
    assert name_of(tables, own) == "R-1207"
    assert name_of(tables, tmp_path / "ur10e") == "R-1207"
    assert name_of([tmp_path / "1.csv", tmp_path / "2.csv"], tmp_path / "ur10e") == "ur10e"
    assert name_of([own / "2026-01" / "KM.robot.toml", own / "2026-02"]) == "R-1207"

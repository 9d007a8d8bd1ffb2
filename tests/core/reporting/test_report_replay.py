"""Measured poses replayed in MuJoCo, as the report of a diagnosis shows them."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from casadical.core.reporting.blocks import Table, Words
from casadical.core.reporting.drawing import draw
from casadical.core.reporting.figure import Figure
from casadical.diagnosis.diagnose import diagnose
from casadical.export.mjcf.replay import replay_blocks, replay_figure, stage_names
from casadical.identification.accuracy import errors
from casadical.identification.identification import identify
from casadical.project.problem import read_problem


@pytest.fixture(scope="module")
def blocks(diagnosis):
    pytest.importorskip("mujoco", reason="mujoco is not installed: nothing was replayed")
    return [*replay_blocks(diagnosis)]


def test_the_figure_shows_geometry_and_cause_shrink_the_gap_towards_the_noise(diagnosis, blocks) -> None:
    figure = draw(next(b for b in blocks if isinstance(b, Figure)))
    nominal, geometry, cause = figure.data[0].x
    assert nominal > 10 * geometry
    assert cause < 0.7 * geometry
    floor = next(s.x0 for s in figure.layout.shapes)
    assert floor == pytest.approx(1e3 * diagnosis.gap.floor)
    assert 0.7 * floor < cause < 1.5 * floor
    assert list(figure.layout.yaxis.ticktext)[-1] == "with backlash@5"
    table = next(b for b in blocks if isinstance(b, Table))
    assert [float(row[2]) for row in table.rows] == pytest.approx([nominal, geometry, cause], rel=2e-3)


def test_geometry_in_the_engine_is_that_of_casadical_on_the_same_poses(diagnosis, blocks) -> None:
    """By its own split and fit, without the module that replays."""
    case = diagnosis.case
    m = case.m[case.inliers]
    parts = m.split({"identify": 2 / 3, "report": 0.332}, 0)
    fit = identify(case.given, parts["identify"], ("kinematic", "compliance"), loss="huber", priors=True, screen=False)
    figure = draw(next(b for b in blocks if isinstance(b, Figure)))
    assert figure.data[0].x[1] == pytest.approx(1e3 * np.mean(errors(fit.robot, parts["report"])), abs=1e-4)


def test_a_cause_without_a_counterpart_is_no_stage(diagnosis) -> None:
    pytest.importorskip("mujoco", reason="mujoco is not installed: nothing was replayed")
    from casadical.export.mjcf.replay import replay_diagnosis

    found = replay_diagnosis(diagnosis)
    assert stage_names(found)[-1] == "with backlash@5"
    lost = replace(found, stages=(*found.stages[:2], replace(found.stages[2], lacking=("backlash@5",))))
    assert len(stage_names(lost)) == 2
    assert len(replay_figure(lost, 1e-5).series[0].x) == 2


def test_a_robot_without_a_cause_is_replayed_as_calibrated(blocks) -> None:
    problem = read_problem(Path(__file__).parents[3] / "problems" / "planar")
    words, *_ = replay_blocks(diagnose(problem.robot, [*problem.sets["identify"]], ["backlash"], laws=False))
    assert ", as calibrated by " in words.text
    assert ", as diagnosed by " in blocks[0].text


def test_without_mujoco_one_sentence_says_how_to_get_it(diagnosis, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    (only,) = replay_blocks(diagnosis)
    assert isinstance(only, Words)
    assert "pip install 'casadical[mujoco]'" in only.text

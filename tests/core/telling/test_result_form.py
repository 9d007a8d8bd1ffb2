"""Every result is told in one form; what shows it is made of that form."""

import json
from pathlib import Path

import pytest

import casadical
from casadical.blind_check.own_robot import RobotCheck
from casadical.blind_check.scoring import Score
from casadical.cli import app
from casadical.core.telling.blocks import Figure, Table, Words
from casadical.core.telling.result import Result, Shown
from casadical.diagnosis.motion.replay import Replay as MotionReplay
from casadical.diagnosis.motion.result import LogDiagnosis
from casadical.export.c.tape_program import Operations
from casadical.export.c.write import Export
from casadical.export.controller.programs.program import CorrectedProgram
from casadical.export.mjcf.replay import Replay
from casadical.fleet.changes import Comparison
from casadical.fleet.touches import Touches
from casadical.pose_selection.plan import MeasurementPlan
from casadical.project.acceptance.acceptance import Acceptance
from casadical.project.acceptance.certificate import Certificate
from casadical.project.acceptance.iso9283 import Iso9283
from casadical.project.check import precheck
from casadical.project.diagnosis import CampaignDiagnosis, diagnose_campaign, read_campaigns

ROOT = Path(__file__).parents[3]
PLANAR = ROOT / "problems" / "planar"
# Made elsewhere in the tests, where their own words and figures are compared: they cost too much to be made here.
COSTLY = {Comparison, Replay, casadical.Fleet, casadical.Discovery, Iso9283, Touches, Certificate}
COSTLY |= {Score, LogDiagnosis, MotionReplay, CorrectedProgram}


@pytest.fixture(scope="module")
def results(calibrated, diagnosis):
    calibration = calibrated("planar")
    identification = calibration.identification
    robot, poses = identification.given, identification.used[0]
    (campaign,) = read_campaigns(PLANAR)
    return [
        calibration,
        identification,
        diagnosis,
        diagnose_campaign(campaign),
        precheck(PLANAR),
        casadical.isolability(robot, poses, ["backlash"]),
        MeasurementPlan(casadical.pose_selection.forecast(robot, 12, pool=100)),
        casadical.Verification("arm", 1e-4, 1.1e-4, 1.3e-4, 10, (), seen=1e-3),
        RobotCheck("arm", 24, 1e-5, 2, (), (), {}, (), {}),
        casadical.robot_model(PLANAR / "robot.toml", "mjcf"),
        Export(
            Path("c"),
            ("arm.c", "manifest.json"),
            (),
            {"rest_um_worst": 0.5},
            Operations("correct", {"multiplications": 3}),
        ),
    ]


def kinds(base: type) -> set[type]:
    return {base, *(kind for child in base.__subclasses__() for kind in kinds(child))}


def test_every_kind_of_result_is_made_here_or_where_it_is_costly(results) -> None:
    assert app.registered_commands
    assert {*COSTLY, Score, CampaignDiagnosis} <= kinds(Result)
    every = kinds(Result) - {Result, Acceptance}
    assert every == {type(result) for result in results} | COSTLY
    for kind in every:
        own = {name for base in kind.__mro__ if base not in (Result, Shown, object) for name in vars(base)}
        assert own & {"blocks", "report"}, kind
        assert own & {"derived", "to_json"}, kind


def test_each_has_blocks_json_files_and_a_notebook_s_form(results, tmp_path) -> None:
    for result in results:
        blocks, data = result.blocks(), result.to_json()
        assert blocks, type(result)
        assert all(isinstance(block, Words | Table | Figure) for block in blocks)
        assert json.loads(json.dumps(data, allow_nan=False)).keys() == data.keys()
        files = result.files(tmp_path)
        assert files, type(result)
        assert {path.parent for path in files} == {tmp_path}
        assert all(files.values())
        words = next(block.text for block in blocks if isinstance(block, Words) and block.text)
        if not isinstance(result, casadical.Calibration):  # in a notebook it is brief
            assert words.split()[0].replace("&", "&amp;") in result._repr_html_()

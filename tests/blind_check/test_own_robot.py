"""A robot of one's own under the check: its file as the physics takes it, what it cannot have, and the whole way."""

import json
from dataclasses import replace
from io import StringIO
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest
from checks import ROOT, Here
from marks import MUJOCO
from typer.testing import CliRunner

from casadical.blind_check.generation import Plan, campaign_of, record
from casadical.blind_check.mujoco_physics import LISTED, UNLISTED, Plant, campaign, draw_effect, positions
from casadical.blind_check.mujoco_physics.cause import placed, reflector, settle
from casadical.blind_check.mujoco_physics.hidden import impossible
from casadical.blind_check.mujoco_physics.plant import unfolded
from casadical.blind_check.mujoco_physics.stops import Stops, draw_poses
from casadical.blind_check.own_robot import check_robot, subject_of
from casadical.cli import app
from casadical.core.basics import ConvergenceError, InputError
from casadical.core.parts import Coupling
from casadical.project.problem import read_campaign, read_campaign_robot
from casadical.robot.robot import Robot

SHOWN = ["q1_mm", "q2_mm", "q3_deg", "q4_deg"]
# Two slides, then two hinges, with masses; no robot of the repository has a slide.
GANTRY = """
casadical = 1
name = "Gantry"

[base]
unknown = "pose"

[tool]
xyz_mm = [120, 0, 80]
unknown = "position"

[payload]
mass_kg = 5
com_mm = [50, 0, 40]

[[joint]]
type = "prismatic"
limits_mm = [0, 2000]
compliant = true
stiffness_N_per_m = 4e6
body = { mass_kg = 60, com_mm = [0, 30, 100] }

[[joint]]
alpha_deg = -90
a_mm = 50
type = "prismatic"
limits_mm = [200, 1200]
compliant = true
stiffness_N_per_m = 5e6
body = { mass_kg = 40, com_mm = [10, 0, -80] }

[[joint]]
a_mm = 200
alpha_deg = 20
limits_deg = [-170, 170]
compliant = true
stiffness_Nm_per_rad = 2e5
body = { mass_kg = 12, com_mm = [100, 0, 0] }

[[joint]]
alpha_deg = 90
a_mm = 300
limits_deg = [-120, 120]
compliant = true
stiffness_Nm_per_rad = 1e5
body = { mass_kg = 5, com_mm = [0, 0, 50] }
"""


@pytest.fixture
def gantry(tmp_path: Path) -> Path:
    (tmp_path / "gantry.toml").write_text(GANTRY)
    return tmp_path / "gantry.toml"


def robot_of(name: str, gantry: Path) -> Robot:
    return read_campaign_robot(gantry if name == "gantry" else ROOT / "problems" / name)


def stops_of(plant: Plant, n: int, payload_kg: float) -> Stops:
    q = draw_poses(plant, n, np.random.default_rng(0), plant.ranges, unfolded(plant))
    return Stops(q, 30.0 * np.arange(n), np.zeros(n), np.full(n, payload_kg), np.ones_like(q))


@pytest.mark.parametrize("name", ["planar", "hh800", "kr210", "wam", "ur5", "panda_1", "gantry"])
def test_the_drawing_has_the_kinematics_of_the_file(name: str, gantry: Path) -> None:
    robot = robot_of(name, gantry)
    turned = tuple(replace(j, theta=j.theta + 0.01 * k) for k, j in enumerate(robot.joints) if j.kind == "revolute")
    robot = replace(robot, joints=turned) if len(turned) == robot.n else robot
    plant = subject_of(robot)[0].nominal
    at = stops_of(plant, 6, 0.0)
    springs = robot.parameters.select(["compliance"])
    rigid = replace(robot.with_values(dict.fromkeys(springs, 0.0)), payload=None, targets=(), tool_name="")
    expected = [rigid.position(q, rigid.parameters.values).full().ravel() for q in at.q]
    np.testing.assert_allclose(reflector(placed(plant, at, at.q)), expected, atol=1e-9)


@MUJOCO
@pytest.mark.parametrize(("name", "within_m"), [("hh800", 1.5e-6), ("wam", 1e-8), ("gantry", 1e-7)])
def test_the_engine_bends_it_as_its_weights_say(name: str, within_m: float, gantry: Path) -> None:
    plant = subject_of(robot_of(name, gantry))[0].nominal
    at = stops_of(plant, 6, plant.payload_kg)
    rest = reflector(settle(plant, at))
    np.testing.assert_allclose(positions(plant, (), at), rest, atol=within_m)
    assert np.abs(rest - reflector(placed(plant, at, at.q))).max() > 20 * within_m


@MUJOCO
@pytest.mark.parametrize("name", ["gantry", "wam", "planar"])
def test_every_effect_that_it_can_have_is_simulated(name: str, gantry: Path) -> None:
    subject = subject_of(robot_of(name, gantry))[0]
    plant, missing = subject.built(1), impossible(subject.nominal)
    assert missing.keys() < {**LISTED, **UNLISTED}.keys()
    for effect in [*LISTED, *UNLISTED]:
        if effect not in missing:
            hidden = draw_effect(plant, effect, np.random.default_rng(4))
            assert hidden.joint is None or hidden.joint in plant.turning
            assert np.isfinite(campaign(plant, [hidden], 3, seed=1)[["x_mm", "y_mm", "z_mm"]].to_numpy()).all()


def test_the_published_robots_can_have_every_effect() -> None:
    for path in (ROOT / "data" / "campaigns" / "robots").glob("*.json"):
        assert impossible(Plant.from_dict(json.loads(path.read_text()))) == {}


def test_reasons_why_an_effect_is_not_hidden(gantry: Path) -> None:
    reasons = impossible(subject_of(read_campaign_robot(ROOT / "problems" / "planar"))[0].nominal)
    assert reasons["payload_error"] == "it has no payload"
    assert reasons["backlash"] == "no revolute joint carries weight"
    assert impossible(subject_of(read_campaign_robot(gantry))[0].nominal) == {
        "joint_coupling": "it has no revolute wrist of three joints",
        "gravity_compensator": "its joint 2 lifts no arm",
        "hose_pull": "it has no six revolute joints",
    }


def test_what_is_assumed_is_said() -> None:
    subject, assumed = subject_of(read_campaign_robot(ROOT / "problems" / "ur5"))
    assert any("no stiffness in the file" in text for text in assumed)
    assert any("no payload" in text for text in assumed)
    _, of_planar = subject_of(read_campaign_robot(ROOT / "problems" / "planar"))
    assert any("masses of the links are estimates" in text for text in of_planar)
    assert subject.base_turn
    assert not subject_of(read_campaign_robot(ROOT / "problems" / "planar"))[0].base_shift


def test_gravity_of_a_base_turns_with_it(gantry: Path) -> None:
    robot = replace(read_campaign_robot(gantry), gravity_frame="base")
    plant = subject_of(robot)[0].built(7)
    np.testing.assert_allclose(plant.base[:3, :3].T @ plant.gravity, robot.gravity, atol=1e-12)
    assert np.abs(plant.gravity - robot.gravity).max() > 1e-3


def test_what_cannot_be_simulated_is_named(gantry: Path) -> None:
    robot = read_campaign_robot(gantry)
    joints = robot.joints
    follows = replace(joints[3], coupling=Coupling(((3, 1.0),)))
    for other, message in (
        (replace(robot, joints=(*joints[:3], follows)), "joint 4 follows other joints"),
        (replace(robot, gravity=np.zeros(3)), "no gravity"),
        (replace(robot, gravity_frame="logged"), "logged pose by pose"),
        (replace(robot, joints=joints[:2]), "no revolute joint"),
    ):
        with pytest.raises(InputError, match=f"Gantry: cannot be simulated: .*{message}"):
            subject_of(other)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"poses": 12}, "12 poses; a campaign of Gantry needs at least 20"),
        ({"n": 3}, "n is 3"),
        ({"noise_um": 0.0}, "noise_um is 0"),
        ({"not_logged": ["wind"]}, "wind: unknown; allowed: temperature, payload, approach, time"),
    ],
)
def test_bad_input_is_named(gantry: Path, given: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        check_robot(read_campaign_robot(gantry), **given)


@MUJOCO
def test_given_poses_are_measured_in_their_order_with_what_was_logged_of_them(gantry: Path, tmp_path: Path) -> None:
    robot = read_campaign_robot(gantry)
    q = draw_poses(subject_of(robot)[0].nominal, 25, np.random.default_rng(2), np.array([[0.2, 0.9]] * 4), None)
    given = pd.DataFrame(np.hstack([1e3 * q[:, :2], np.rad2deg(q[:, 2:])]), columns=SHOWN)
    given["time_s"] = 1.7e9 + 60.0 * np.arange(25)
    given["temperature_degC"] = np.linspace(28.0, 28.6, 25)
    given["payload_kg"], given["approach3"] = np.repeat([5.0, 0.0, 5.0, 0.0, 5.0], 5), np.tile([1, 1, 1, 1, -1], 5)
    given.sample(frac=1, random_state=0).to_csv(tmp_path / "poses.csv", index=False)
    poses = read_campaign(gantry, tmp_path / "poses.csv", robot, readings_only=True)
    subject, assumed = subject_of(robot, poses)
    assert "temperature, payload, approach, time as in the table of poses" in assumed
    assert not any("the arm warms" in text or "in turns" in text for text in assumed)
    plan = Plan("own", "own", "one", ("joint_zero_step",), 25, "approach", 1e-5, 1e-6, 3)
    _, text, secret = campaign_of(subject, plan)
    table = pd.read_csv(StringIO(text))
    for name in (*SHOWN, "temperature_degC", "payload_kg"):
        np.testing.assert_allclose(table[name], given[name], atol=1e-5)
    np.testing.assert_allclose(np.diff(table["time_s"]), 60.0)
    assert not [name for name in table if name.startswith("approach")]
    at = float(secret.hidden[0].about.rpartition("at_s ")[2])  # within the time of the table
    assert table["time_s"].quantile(0.25) < at < table["time_s"].quantile(0.75)
    logged = campaign_of(subject, replace(plan, missing=None))[1]
    np.testing.assert_array_equal(pd.read_csv(StringIO(logged))["approach3"], given["approach3"])


@MUJOCO
def test_an_arm_has_grown_from_the_first_of_the_given_poses_on(gantry: Path) -> None:
    poses = pd.DataFrame([[900.0, 700.0, 20.0, 30.0]] * 3, columns=SHOWN)
    poses["time_s"], poses["temperature_degC"] = [600.0, 1200.0, 1800.0], [20.0, 28.0, 28.0]
    subject = replace(subject_of(read_campaign_robot(gantry))[0], poses=poses)
    plan = Plan("own", "own", "one", ("thermal_growth",), 3, None, 1e-5, 1e-6, 3)
    grown = np.abs(np.subtract(*record(subject, plan)[1:3])[["x_mm", "y_mm", "z_mm"]]).max(axis=1)
    assert grown[0] == 0 < grown[1] < grown[2]


@MUJOCO
@pytest.mark.usefixtures("stubbed")
def test_campaigns_are_counted_by_what_was_answered(gantry: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every answer is a claim of a scale error of joint 1, which the robot, whose joint 1 slides, cannot have."""
    checked = check_robot(read_campaign_robot(gantry), poses=24, n=4, seed=2, not_logged=["payload"], executor=Here())
    figures = checked.to_json()["withheld"]
    assert sorted(t.kind for t in checked.outcomes)[:3] == ["none", "one", "one"]
    assert (figures["claims that are right"]["hits"], figures["claims that are right"]["n"]) == (0, 4)
    assert figures["false alarms where nothing is hidden"]["value"] == 1.0
    assert not {e for t in checked.outcomes for e in t.effects} & set(checked.not_drawn)
    for kind in (InputError, ConvergenceError):
        monkeypatch.setattr("casadical.blind_check.own_robot.campaign_of", Mock(side_effect=kind("no rest")))
        checked = check_robot(read_campaign_robot(gantry), poses=24, n=4, seed=2, executor=Here())
        assert {*checked.failed.values()} == {"not simulated: no rest"}


@MUJOCO
@pytest.mark.slow
def test_the_command_says_how_often_a_diagnosis_would_be_right(gantry: Path, tmp_path: Path) -> None:
    words = ["withheld", str(gantry), "--poses", "24", "--noise-um", "10", "-n", "4", "--seed", "2", "--workers", "1"]
    done = CliRunner().invoke(app, [*words, "--not-logged", "payload", "--json", str(tmp_path / "own.json")])
    assert done.exit_code == 0, done.output
    assert "Would a diagnosis of 24 poses of Gantry be right?" in done.output
    told = json.loads((tmp_path / "own.json").read_text())
    assert (told["poses"], told["noise_um"], told["seed"], told["not_logged"]) == (24, 10.0, 2, ["payload"])
    assert sorted(c["kind"] for c in told["campaigns"])[:3] == ["none", "one", "one"]
    assert told["withheld"]["false alarms where nothing is hidden"]["n"] == 1
    hidden = {text.partition("@")[0] for c in told["campaigns"] for text in c["hidden"]}
    assert hidden == set(told["effects"])
    assert not hidden & set(told["not_drawn"])
    assert told["failed"] == {}

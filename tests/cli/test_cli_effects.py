"""Commands that are given a robot file with effects in it."""

import json
from pathlib import Path

import pandas as pd
import pytest
from command_line import main

from casadical import diagnose, read_campaign_robot, read_measurements, read_robot, write_robot
from casadical.effects import GearEccentricity, ThermalGrowth

ROOT = Path(__file__).parents[2]
PROBLEM = ROOT / "problems" / "ur10e"
CAMPAIGN = ROOT / "data" / "campaigns" / "practice" / "ur10e-P06.csv"
HELD = "fixed at their values: friction_windup@3 (constant"


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot with what a diagnosis found, and an eccentric gear of joint 5 besides."""
    found = diagnose(read_campaign_robot(PROBLEM), read_measurements(CAMPAIGN, 6), ["friction_windup"], laws=False)
    file = tmp_path_factory.mktemp("kept") / "kept.toml"
    write_robot(found.apply(), file)
    more = found.apply().with_effect(GearEccentricity(5)).with_values({"gear_eccentricity@5.sin1": 5e-5})
    write_robot(more, file.with_name("more.toml"))
    return file


def words(capfd: pytest.CaptureFixture[str]) -> str:
    out, err = capfd.readouterr()
    return " ".join((out + err).split())


def test_calibrate_holds_them_and_keeps_them(kept, tmp_path, monkeypatch, capfd):
    problem = tmp_path / "problem"
    problem.mkdir()
    (problem / "robot.toml").write_text(kept.read_text())
    (problem / "campaign.csv").write_text(CAMPAIGN.read_text())
    text = 'casadical = 1\ntitle = "kept"\nmethods = ["SKCM"]\n[[measurements]]\nfile = "campaign.csv"\n'
    (problem / "problem.toml").write_text(text)
    assert main(monkeypatch, "calibrate", problem, "--out", tmp_path / "out") == 0
    assert HELD in words(capfd)
    before, after = read_robot(kept), read_robot(tmp_path / "out" / "SKCM.robot.toml")
    assert after.effects == before.effects
    errors = before.knowledge.std_errors  # a result's file holds the digits that are known
    assert all(
        after.effect_values[k] == pytest.approx(v, abs=1e-5 * errors[k]) for k, v in before.effect_values.items()
    )
    assert after.knowledge.std_errors.keys() == before.knowledge.std_errors.keys()
    assert after.joints[1].a != before.joints[1].a
    errors = json.loads((tmp_path / "out" / "result.json").read_text())["methods"]["SKCM"]["sets"]["report"]
    assert errors["mean_mm"] < 0.09  # 0.14 mm without what was diagnosed


@pytest.mark.slow
def test_calibrate_takes_them_as_a_prior(kept, tmp_path, monkeypatch, capfd):
    """Twenty poses: the friction of the file's joint 3 is free about its value; frozen, it is held."""
    problem = tmp_path / "problem"
    problem.mkdir()
    (problem / "robot.toml").write_text((PROBLEM / "robot.toml").read_text())
    (problem / "campaign.csv").write_text("".join(CAMPAIGN.read_text().splitlines(keepends=True)[:31]))
    text = 'casadical = 1\ntitle = "few"\nmethods = ["SKCM"]\n[[measurements]]\nfile = "campaign.csv"\n'
    (problem / "problem.toml").write_text(text)
    command = ("calibrate", problem, "--out", tmp_path / "out", "--prior", kept)
    assert main(monkeypatch, *command) == 0
    assert "friction_windup@3; 2 parameters are free about the values found there" in words(capfd)
    found = json.loads((tmp_path / "out" / "result.json").read_text())
    assert found["prior"]["effects"] == ["friction_windup@3"]
    assert not found["prior"]["same_data"]
    assert found["prior"]["without_mean_mm"] > found["methods"]["SKCM"]["sets"]["report"]["mean_mm"]
    rows = {p["name"]: p for p in found["methods"]["SKCM"]["parameters"]}
    assert rows["friction_windup@3.constant"]["status"] == "identified"
    assert main(monkeypatch, *command, "--frozen") in (0, 2)
    said = words(capfd)
    assert "friction_windup@3 held at the values found there" in said or "allowed inside these ranges only" in said
    assert main(monkeypatch, *command, "--prior-effects", "backlash") == 2
    assert "no effect 'backlash'; allowed: effects, all, friction_windup@3" in words(capfd)


@pytest.mark.slow
def test_a_diagnosis_says_what_changed_since_the_prior(kept, tmp_path, monkeypatch, capfd):
    """The same campaign again: nothing changed; the robot that is written has the friction with a standard error."""
    chosen = ["--no-laws", "--effects=backlash", "--json", tmp_path / "d.json", "--out", tmp_path / "out", "--details"]
    assert main(monkeypatch, "diagnose", PROBLEM, CAMPAIGN, *chosen, "--prior", kept) == 0
    assert "friction_windup@3: changed since then with probability 0.0" in words(capfd)
    answer = json.loads((tmp_path / "d.json").read_text())
    assert answer["prior"]["same_data"]
    assert [(c["effect"], c["joint"]) for c in answer["prior"]["changed"]] == [("friction_windup@3", 3)]
    after = read_robot(tmp_path / "out" / "diagnosed.robot.toml")
    before = read_robot(kept).knowledge.std_errors["friction_windup@3.constant"]
    assert 0 < after.knowledge.std_errors["friction_windup@3.constant"] < before
    assert main(monkeypatch, "diagnose", PROBLEM, CAMPAIGN, *chosen, "--prior", kept, "--frozen") == 0
    assert "friction_windup@3 held at the values found there" in words(capfd)


@pytest.mark.slow
def test_a_diagnosis_looks_for_what_is_not_in_the_model_yet(kept, tmp_path, monkeypatch, capfd):
    chosen = ["--no-laws", "--effects=friction_windup,backlash", "--json", tmp_path / "d.json"]
    assert main(monkeypatch, "diagnose", kept, CAMPAIGN, *chosen) == 0
    assert HELD in words(capfd)
    answer = json.loads((tmp_path / "d.json").read_text())
    assert answer["gap_mm"]["before"] < 0.065  # 0.150 without it
    assert "friction_windup@3" not in [f"{c['effect']}@{c['joint']}" for c in answer["causes"]]
    assert main(monkeypatch, "diagnose", kept, CAMPAIGN, "--effects", "friction_windup@3") == 2
    assert "friction_windup@3: robot" in words(capfd)


def test_columns_that_an_effect_follows_must_be_there(tmp_path, monkeypatch, capfd):
    write_robot(read_campaign_robot(PROBLEM).with_effect(ThermalGrowth()), tmp_path / "warm.toml")
    table = pd.read_csv(CAMPAIGN).drop(columns="temperature_degC")
    table.to_csv(tmp_path / "cold.csv", index=False)
    assert main(monkeypatch, "diagnose", tmp_path / "warm.toml", tmp_path / "cold.csv") == 2
    assert "thermal_growth of robot" in (said := words(capfd))
    assert "warmth_600s" in said
    assert "temperature_degC" in said


def test_correct_refuses_what_a_controller_cannot_follow(kept, tmp_path, monkeypatch, capfd):
    program, out = tmp_path / "program.csv", tmp_path / "corrected.csv"
    program.write_text("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n5,-80,80,-60,-80,10\n")
    given = ["correct", kept, program, "--out", out, "--nominal", PROBLEM / "robot.toml"]
    assert main(monkeypatch, *given) == 2
    said = words(capfd)
    assert "friction_windup@3: follows approach3, which a controller does not know; lost without it: 0." in said
    assert "mm at most over the learnt range" in said
    assert not out.exists()
    assert main(monkeypatch, *given, "--leave-out") == 0
    assert "LEFT OUT friction_windup@3" in words(capfd)
    assert out.exists()

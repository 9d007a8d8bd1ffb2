"""casadical diagnose --laws: what it prints and writes, and that diagnose takes its effect file."""

import json
from pathlib import Path

import pytest
from command_line import main
from numpy_physics import campaign
from numpy_physics.disturbances_rare import SlippedMark

from casadical import read_robot
from casadical.blind_check.mujoco_physics import Plant, perturb

ROOT = Path(__file__).parents[2]
PROBLEM = ROOT / "problems" / "ur10e"


@pytest.fixture
def stepped(tmp_path: Path) -> Path:
    """A campaign of a robot whose joint 2 is off by 250 urad beyond one reading."""
    drawing = json.loads((ROOT / "data" / "campaigns" / "robots" / "ur10e.json").read_text())
    plant = perturb(Plant.from_dict(drawing), 12)
    table = campaign(plant, 60, 12, disturbances=[SlippedMark(2, 250e-6)], noise_mm=0.02, approach="motion")
    table.to_csv(tmp_path / "stepped.csv", index=False)
    return tmp_path / "stepped.csv"


def test_a_law_is_printed_written_and_taken_again(stepped, tmp_path, monkeypatch, capsys):
    out, page, few = tmp_path / "out", tmp_path / "law.html", ("--effects", "gear_eccentricity")
    assert main(monkeypatch, "diagnose", PROBLEM, stepped, "--laws", *few, "--out", out, "--report", page) == 0
    said = capsys.readouterr().out
    kept = json.loads((out / "discovery.json").read_text())
    line = kept["laws"][0]["line"]
    assert f"LAW  {line}" in said
    assert line.startswith("joint 2 += ")
    assert kept["laws"][0]["driver"] == "q2"
    assert "The missing law" in page.read_text()
    assert read_robot(out / "discovered.robot.toml").effects[-1].label.startswith("law at joint 2 by q2")
    assert main(monkeypatch, "diagnose", PROBLEM, stepped, "--effects", out / "law.effect.toml") == 0
    assert "Explained: law@2" in capsys.readouterr().out


def test_a_missing_effect_file_is_named(stepped, monkeypatch, capsys):
    assert main(monkeypatch, "diagnose", PROBLEM, stepped, "--effects", stepped.parent / "none.effect.toml") == 2
    assert "none.effect.toml" in capsys.readouterr().err

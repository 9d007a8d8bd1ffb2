"""Layer by layer: the table of errors, and that a floor which a richer form goes below is no explanation."""

import re

import pytest
from cases import diagnose, robot, simulated
from numpy_physics import disturbances

from casadical.diagnosis import search
from casadical.diagnosis.cause_table import layers
from casadical.diagnosis.diagnose import Diagnosis
from casadical.diagnosis.json_answer import as_json
from casadical.diagnosis.text import page_of

TWO = (disturbances.FrictionWindup(2, 150e-6), disturbances.GearEccentricity(1, 120e-6, 0.7))
LABELS = ["friction_windup@2", "gear_eccentricity@1", "backlash@3", "frame_drift"]


@pytest.fixture(scope="module")
def both() -> Diagnosis:
    return diagnose(robot("ur10e"), simulated("ur10e", 12, *TWO), LABELS)


def test_layers_go_from_the_calibrated_robot_to_the_noise(both: Diagnosis) -> None:
    found = layers(both)
    assert [a["name"] for a in found[1:3]] == [f"+ {c}" for c in ("friction_windup@2", "gear_eccentricity@1")]
    assert (found[0]["name"], found[-1]["name"]) == ("as calibrated", "noise as the fit has it")
    means = [a["mean_mm"] for a in found]
    assert means[0] > 1.2 * means[1] > 1.44 * means[2]
    assert means[2] == pytest.approx(1e3 * both.gap.after, rel=0.05)
    assert means[3] == pytest.approx(1e3 * both.gap.floor, abs=1e-5)


def test_text_and_json_have_the_same_layers(both: Diagnosis) -> None:
    table = page_of(both).split("LAYERS")[1].splitlines()[2:6]
    given = as_json(both, "x")["layers"]
    assert [float(re.split(r"\s{2,}", line.strip())[1]) for line in table] == [round(a["mean_mm"], 3) for a in given]
    assert set(given[-1]) == {"name", "mean_mm"}


def test_a_clean_campaign_has_no_layers() -> None:
    clean = diagnose(robot("ur10e"), simulated("ur10e", 12), LABELS)
    assert (clean.verdict, layers(clean)) == ("none", [])
    assert "LAYERS" not in page_of(clean)
    assert "layers" not in as_json(clean, "x")


def test_a_floor_that_a_further_form_goes_below_explains_nothing(both, monkeypatch):
    """The second cause is there, but one cause is all that the search may take."""
    assert both.verdict == "explained"
    monkeypatch.setattr(search, "MOST_CAUSES", 1)
    cut = diagnose(robot("ur10e"), simulated("ur10e", 12, *TWO), LABELS)
    assert len(cut.causes) == 1
    assert cut.verdict == "unknown"
    assert cut.unknown_rest > 0.1
    assert len(cut.rankings) == 2

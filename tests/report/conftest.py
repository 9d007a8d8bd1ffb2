"""Reports that several tests look at, each made once."""

from __future__ import annotations

from pathlib import Path

import pytest

from casadical.diagnosis.details import analyse
from casadical.diagnosis.diagnose import diagnose
from casadical.measurements.reading import read_measurements
from casadical.project.problem import read_campaign_robot
from casadical.report import calibration_report, diagnosis_report

ROOT = Path(__file__).parents[2]
CAMPAIGN = ROOT / "data/campaigns/practice/hh800-P01.csv"


@pytest.fixture(scope="session")
def hh800(calibrated):
    """The HH800 calibrated as the command does, networks included."""
    return calibrated("hh800")


@pytest.fixture(scope="session")
def diagnosis():
    """Of a campaign with backlash in joint 5, by few candidates."""
    robot = read_campaign_robot(ROOT / "problems/hh800")
    return diagnose(robot, read_measurements(CAMPAIGN, 6), ["backlash", "friction_windup", "thermal_growth"])


@pytest.fixture(scope="session")
def details(diagnosis):
    return analyse(diagnosis)


@pytest.fixture(scope="session")
def calibration_file(hh800, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("report") / "calibration.html"
    path.write_text(calibration_report([hh800], ["casadical", "calibrate", "problems/hh800"]), encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def diagnosis_file(diagnosis, details, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("report") / "diagnosis.html"
    text = diagnosis_report(ROOT / "problems/hh800", [(CAMPAIGN, diagnosis, details)])
    path.write_text(text, encoding="utf-8")
    return path

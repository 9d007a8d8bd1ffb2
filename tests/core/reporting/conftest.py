"""Reports that several tests look at, each made once."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from casadical import report
from casadical.diagnosis.details import analyse
from casadical.diagnosis.diagnose import diagnose
from casadical.diagnosis.joint_curves import JointCurve
from casadical.diagnosis.page import diagnosis_page
from casadical.export.mjcf.replay import replay_blocks
from casadical.measurements.reading import read_measurements
from casadical.project.diagnosis import read_logs
from casadical.project.problem import read_campaign_robot

ROOT = Path(__file__).parents[3]
CAMPAIGN = ROOT / "data/campaigns/practice/hh800-P01.csv"


@pytest.fixture(scope="session")
def hh800(calibrated):
    """The HH800 calibrated as the command does, networks included."""
    return calibrated("hh800")


@pytest.fixture(scope="session")
def diagnosis():
    """Of a campaign with backlash in joint 5, by few candidates."""
    robot = read_campaign_robot(ROOT / "problems/hh800")
    return diagnose(
        robot, read_measurements(CAMPAIGN, 6), ["backlash", "friction_windup", "thermal_growth"], laws=False
    )


@pytest.fixture(scope="session")
def curves() -> tuple[JointCurve, ...]:
    """Of six joints, made up: the second alone errs, the others were not seen."""
    angle = np.linspace(-np.pi, np.pi, 181)
    error = np.where(np.abs(angle) < 2, 5e-6, 6e-5)
    joints = []
    for j in range(1, 7):
        value = (8e-5 * np.sin(17 * angle + 0.3) + 4e-5 * np.sin(34 * angle + 1.0)) * (j == 2)
        rms, lost = float(np.sqrt((value**2).mean())), 99.0 * (j == 2)
        covered = np.abs(angle) < 2
        joints.append(JointCurve(j, angle, value, error, covered, rms, 8e-6, lost, lost / 99, (16.0, 18.0)))
    return tuple(joints)


@pytest.fixture(scope="session")
def details(diagnosis, curves):
    return replace(analyse(diagnosis), curves=curves)


@pytest.fixture(scope="session")
def calibration_file(hh800, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("report") / "calibration.html"
    path.write_text(report([hh800], ["casadical", "calibrate", "problems/hh800"]), encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def diagnosis_file(diagnosis, details, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("report") / "diagnosis.html"
    page = diagnosis_page(diagnosis, CAMPAIGN.stem, details, [*replay_blocks(diagnosis)])
    text = report([page])
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def logs_file(tmp_path_factory) -> Path:
    """The replay of one real motion of a SO-101 by the response that another one has."""
    paths = [ROOT / "data" / "so101_logs" / f"{name}.csv.gz" for name in ("wave_motion", "staircase_motion")]
    campaign = read_logs(ROOT / "problems/so101/robot.toml", paths)
    assert campaign is not None
    path = tmp_path_factory.mktemp("report") / "logs.html"
    path.write_text(report([campaign.page(None, campaign.replayed())]), encoding="utf-8")
    return path

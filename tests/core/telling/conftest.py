"""Reports that several tests look at, each made once."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from casadical import report
from casadical.diagnosis.details import analyse
from casadical.diagnosis.diagnose import diagnose
from casadical.diagnosis.line_search import Line, Scan
from casadical.diagnosis.page import diagnosis_page
from casadical.diagnosis.spectrum import JointCurve, Spectrum
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
    return diagnose(robot, read_measurements(CAMPAIGN, 6), ["backlash", "friction_windup", "thermal_growth"])


@pytest.fixture(scope="session")
def curves() -> Spectrum:
    """Of six joints, made up: the second has two lines, the last was not seen."""
    angle, frequency = np.linspace(-np.pi, np.pi, 181), np.arange(0.5, 60, 0.5)
    lines = (
        Line(2, 17.0, 0.03, 8e-5, 3e-6, 0.3, 0.1, 1e-40),
        Line(2, 34.0, 0.1, 4e-5, 3e-6, 1.0, 0.1, 1e-20, (), 17.0, 2),
    )
    joints = []
    for j in range(1, 7):
        waves = [line.amplitude * np.sin(line.frequency * angle + line.phase) for line in lines]
        value = np.sum(waves, axis=0) * (j == 2)
        amplitude = 3e-6 + 7e-5 / (1 + (frequency - 17) ** 2) * (j == 2)
        scan = Scan(
            frequency,
            amplitude * (j < 6),
            np.full(len(frequency), 1e-5),
            np.full(len(frequency), 3e-5 if j < 6 else np.inf),
            33,
        )
        error, rms = np.where(np.abs(angle) < 2, 5e-6, 6e-5), float(np.sqrt((value**2).mean()))
        lost, shown = 99.0 * (j == 2), lines if j == 2 else ()
        joints.append(
            JointCurve(j, angle, value, error, np.abs(angle) < 2, rms, 8e-6, lost, lost / 99, (16.0, 18.0), shown, scan)
        )
    return Spectrum(tuple(joints), 60)


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
    path.write_text(report([campaign.page([], campaign.replayed())]), encoding="utf-8")
    return path

"""What tests of several areas share: each problem folder calibrated once a run."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from casadical import Calibration, calibrate

ROOT = Path(__file__).parents[1]


@cache
def _calibrated(name: str) -> Calibration:
    return calibrate(ROOT / "problems" / name)


@pytest.fixture(scope="session")
def calibrated():
    """A function: name of a problem folder -> its calibration as the command makes it."""
    return _calibrated

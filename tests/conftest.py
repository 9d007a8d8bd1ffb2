"""What tests of several areas share: each problem folder is calibrated once a process.

With `pytest -n 2` a file's tests stay in one process (`--dist=loadfile`), so that its fixtures are made once.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from casadical.core.subprocesses import one_thread

if TYPE_CHECKING:
    from casadical import Calibration

ROOT = Path(__file__).parents[1]

one_thread()  # processes that share the processors gain nothing by more


@cache
def _calibrated(name: str) -> Calibration:
    from casadical import calibrate  # the process that only hands tests out does without

    return calibrate(ROOT / "problems" / name)


@pytest.fixture(scope="session")
def calibrated():
    """Return the function that gives the calibration of a problem folder, by its name."""
    return _calibrated

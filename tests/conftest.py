"""What tests of several areas share: each problem folder calibrated once a run, and how processes share the tests.

With `pytest -n 2` a file's tests stay in one process, so that its fixtures are made once; so do all files whose tests
use one of the costly fixtures of a whole run. Folders that take the longest begin.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from casadical import Calibration, calibrate

ROOT = Path(__file__).parents[1]
SHARED = ("site", "calibrated", "small", "exported")  # costly, made once a process
LONGEST_FIRST = ("docs", "diagnosis", "cli", "report", "project", "blind_check", "export", "identification")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    groups: dict[Path, str] = {}
    for item in items:
        used = [name for name in SHARED if name in getattr(item, "fixturenames", ())]
        groups.setdefault(item.path, str(item.path.relative_to(ROOT)))
        groups[item.path] = used[0] if used else groups[item.path]
    for item in items:
        item.add_marker(pytest.mark.xdist_group(groups[item.path]))
    items.sort(key=lambda item: _rank(item.path.relative_to(ROOT / "tests").parts[0]))


def _rank(folder: str) -> int:
    return LONGEST_FIRST.index(folder) if folder in LONGEST_FIRST else len(LONGEST_FIRST)


@cache
def _calibrated(name: str) -> Calibration:
    return calibrate(ROOT / "problems" / name)


@pytest.fixture(scope="session")
def calibrated():
    """A function: name of a problem folder -> its calibration as the command makes it."""
    return _calibrated

"""What tests of several areas share: each problem folder calibrated once a run, and how processes share the tests.

With `pytest -n 2` a file's tests stay in one process, so that its fixtures are made once; so do all files whose tests
use one of the costly fixtures of a whole run. Folders that take the longest begin.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from casadical import Calibration

ROOT = Path(__file__).parents[1]
# Files that stay together, because a costly fixture of theirs is made once a process; mypy keeps what it found.
TOGETHER = {
    "mypy": ("house/test_house_names.py", "house/test_house_style.py"),
    "site": ("docs/test_docs_build.py", "docs/test_docs_tutorials.py"),
    "small": tuple(f"blind_check/test_{name}.py" for name in ("generation", "packed_files", "prediction", "scoring")),
    "exported": tuple(f"export/c/test_export_{name}.py" for name in ("c", "targets", "text", "write")),
}
LONGEST_FIRST = ("docs", "diagnosis", "cli", "report", "project", "blind_check", "export", "identification")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: _rank(item.path.relative_to(ROOT / "tests").parts[0]))


def _rank(folder: str) -> int:
    return LONGEST_FIRST.index(folder) if folder in LONGEST_FIRST else len(LONGEST_FIRST)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Whole files to a process: the groups of `--dist=loadgroup` are lost with pytest 9.2 (it has no `_nodeid`)."""
    from xdist.scheduler import LoadScopeScheduling

    units = {f"tests/{file}": name for name, files in TOGETHER.items() for file in files}

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            return units.get(file, file)

    return ByFile(config, log)


@cache
def _calibrated(name: str) -> Calibration:
    from casadical import calibrate  # the process that only hands tests out does without

    return calibrate(ROOT / "problems" / name)


@pytest.fixture(scope="session")
def calibrated():
    """A function: name of a problem folder -> its calibration as the command makes it."""
    return _calibrated

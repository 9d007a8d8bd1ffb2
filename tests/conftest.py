"""What tests of several areas share: each problem folder calibrated once a run, and how processes share the tests.

With `pytest -n 2` a file's tests stay in one process, so that its fixtures are made once; so do all files whose tests
use one of the costly fixtures of a whole run. Files that take the longest begin.
"""

from __future__ import annotations

import re
from collections import Counter
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from casadical.core.subprocesses import one_thread

if TYPE_CHECKING:
    from casadical import Calibration

ROOT = Path(__file__).parents[1]
# Files that stay together, because a costly fixture of theirs is made once a process.
TOGETHER = {
    "site": ("docs/test_docs_build.py", "docs/test_docs_tutorials.py"),
    "small": tuple(f"blind_check/test_{name}.py" for name in ("generation", "prediction", "scoring")),
    "diagnosed": tuple(
        f"diagnosis/test_diagnosis_{name}.py" for name in ("campaigns", "localisation", "refit")
    ),
    "calibrated": (
        *(
            f"core/telling/test_report_{name}.py"
            for name in ("browser", "figures", "notebook", "page", "parts", "replay")
        ),
        *("core/telling/test_result_form.py", "project/test_project_parts.py", "project/test_several_tables.py"),
        *(f"project/test_{name}.py" for name in ("calibration", "networks", "problems")),
    ),
    "exported": tuple(f"export/c/test_export_{name}.py" for name in ("c", "targets", "text", "write")),
}
# Files of more than 10 s, the longest first: one that begins last would leave the other processes without work.
LONGEST = tuple(
    f"{path}.py"
    for path in (
        *("docs/test_docs_build", "docs/test_docs_newcomer", "diagnosis/test_diagnosis_campaigns", "fuzz/test_fuzz"),
        *("house/test_house_names", "diagnosis/test_diagnosis_kinds", "project/test_problems", "cli/test_cli_effects"),
        *("diagnosis/test_diagnosis_laws", "diagnosis/test_diagnosis_search", "docs/test_docs_architecture"),
        *("export/controller/test_controller_commands", "core/telling/test_report_browser", "cli/test_cli_degraded"),
        *("docs/test_docs_reference", "diagnosis/test_diagnosis_held_out_gap", "blind_check/test_prediction"),
        *("fleet/test_fleet", "export/c/test_export_c", "project/check/test_slips", "effects/test_effects_plugin"),
        *("project/check/test_project_check", "export/c/test_export_targets", "diagnosis/test_diagnosis_refit"),
        *("cli/test_cli_diagnose", "cli/test_cli_docs", "pose_selection/test_pose_instruments"),
    )
)
one_thread()  # processes that share the processors gain nothing by more


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    rank = {ROOT / "tests" / file: k for k, file in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path, len(LONGEST)))


# How to get what tests are skipped for want of: a word of the reason, and what brings it.
APT = {
    "C compiler": "gcc", "gcc": "gcc", "g++": "g++", "clang": "clang", "chromium": "chromium", "cmake": "cmake",
    "nm": "binutils", "cppcheck": "cppcheck", "qemu": "qemu-system-arm",
    "arm-none-eabi": "gcc-arm-none-eabi libnewlib-arm-none-eabi",
}  # fmt: skip
EXTRAS = {
    "mujoco": "withheld", "urdf": "urdf", "plotly": "report", "jinja2": "report", "pyarrow": "fleet", "dask": "fleet",
    "starlette": "live", "rosbags": "logs", "fpdf": "certificate", "openpyxl": "xlsx", "sphinx": "docs",
}  # fmt: skip
PIP = {word: f"'casadical[{extra}]'" for word, extra in EXTRAS.items()} | {
    "playwright": "playwright", "fmpy": "fmpy", "tree-sitter": "tree-sitter tree-sitter-iec61131-3-st",
    "pinocchio": "pin", "example-robot-data": "example-robot-data",
}  # fmt: skip


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """What was missing, in how many tests, and what brings it."""
    reasons = [str(r.longrepr[2]) for r in terminalreporter.stats.get("skipped", ()) if isinstance(r.longrepr, tuple)]
    bring = [("apt-get install", w, g) for w, g in APT.items()] + [("pip install", w, g) for w, g in PIP.items()]
    found = [next((f"{how} {get}" for how, word, get in bring if _names(word, r)), r) for r in reasons]
    for what, count in Counter(found).most_common():
        terminalreporter.line(f"{count} skipped: {what}")


def _names(word: str, reason: str) -> bool:
    return re.search(rf"(?<!\w){re.escape(word)}", reason, re.IGNORECASE) is not None


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

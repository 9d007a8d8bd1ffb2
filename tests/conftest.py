"""What tests of several areas share: each problem folder calibrated once a run, and how processes share the tests.

With `pytest -n 2` a file's tests stay in one process, so that its fixtures are made once; so do all files whose tests
use one of the costly fixtures of a whole run. Files that take the longest begin.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from casadical.core.threads import one_thread

if TYPE_CHECKING:
    from casadical import Calibration

ROOT = Path(__file__).parents[1]
# Files that stay together, because a costly fixture of theirs is made once a process.
TOGETHER = {
    "mypy": ("house/test_house_names.py", "house/test_house_style.py"),
    "site": ("docs/test_docs_build.py", "docs/test_docs_tutorials.py"),
    "small": tuple(f"blind_check/test_{name}.py" for name in ("generation", "packed_files", "prediction", "scoring")),
    "diagnosed": tuple(
        f"diagnosis/test_diagnosis_{name}.py" for name in ("campaigns", "localisation", "refit", "spectrum")
    ),
    "report": tuple(f"core/telling/test_report_{name}.py" for name in ("browser", "figures", "notebook", "page")),
    "calibrated": tuple(f"project/test_{name}.py" for name in ("calibration", "networks", "problems")),
    "exported": tuple(f"export/c/test_export_{name}.py" for name in ("c", "targets", "text", "write")),
}
# Files of more than 10 s, the longest first: one that begins last would leave the other processes without work.
LONGEST = (
    *(
        "docs/test_docs_build.py",
        "docs/test_docs_newcomer.py",
        "core/telling/test_report_browser.py",
        "fuzz/test_fuzz.py",
    ),
    *("project/test_problems.py", "diagnosis/test_diagnosis_campaigns.py", "export/c/test_export_c.py"),
    *("house/test_house_names.py", "diagnosis/test_diagnosis_refit.py", "fleet/test_fleet.py", "cli/test_cli_docs.py"),
    *("project/new/test_project_new.py", "diagnosis/test_diagnosis_kinds.py", "project/check/test_slips.py"),
    *("cli/test_cli_diagnose.py", "project/test_several_targets.py", "docs/test_docs_architecture.py"),
    *("blind_check/test_prediction.py", "diagnosis/test_diagnosis_search.py", "cli/test_cli_effects.py"),
    *("export/controller/test_controller_commands.py", "report/test_report_page.py", "cli/test_cli_degraded.py"),
    *("project/check/test_project_check.py", "pose_selection/test_pose_instruments.py"),
    *("effects/test_effects_against_physics.py", "diagnosis/test_diagnosis_laws.py", "effects/test_effects_plugin.py"),
    *("effects/test_effects_signatures.py", "diagnosis/test_diagnosis_docs.py", "docs/test_docs_reference.py"),
)
one_thread()  # processes that share the processors gain nothing by more


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    rank = {ROOT / "tests" / file: k for k, file in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path, len(LONGEST)))


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

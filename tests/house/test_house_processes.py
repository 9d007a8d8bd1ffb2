"""How several processes share the tests: a file's fixtures are made once."""

import re
import subprocess
import sys

import pytest
from repository import ROOT


def test_the_tests_of_a_file_stay_in_one_process() -> None:
    pytest.importorskip("xdist")
    file = "tests/house/test_house_affected.py"
    command = [sys.executable, "-m", "pytest", "-n", "2", "-v", "-p", "no:cacheprovider", "-k", "own_tests", file]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    ran_by = re.findall(r"^\[(gw\d)\] .*PASSED", done.stdout, re.MULTILINE)
    assert len(ran_by) > 5, done.stdout
    assert len(set(ran_by)) == 1


def test_files_that_are_named_are_there(pytestconfig: pytest.Config) -> None:
    shared = pytestconfig.pluginmanager.get_plugin(str(ROOT / "tests" / "conftest.py"))
    assert shared
    named = [ROOT / "tests" / file for files in (*shared.TOGETHER.values(), shared.LONGEST) for file in files]
    assert [file for file in named if not file.exists()] == []


def test_modules_of_tests_have_names_of_their_own() -> None:
    """All folders are on one path: of two modules with the same name only one could be imported in one process."""
    files = [path for path in (ROOT / "tests").rglob("*.py") if not path.stem.startswith(("conftest", "__"))]
    names = [path.stem for path in files]
    assert len(names) > 10
    assert sorted(name for name in set(names) if names.count(name) > 1) == []

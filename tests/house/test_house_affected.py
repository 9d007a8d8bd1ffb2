"""The command that says which tests a change touches, and how several processes share the tests."""

import re
import subprocess
import sys

import pytest
from affected import affected, own_tests
from repository import ROOT


@pytest.mark.parametrize(
    ("path", "wanted"),
    [
        ("casadical/effects/play.py", ["tests/effects"]),
        ("casadical/export/c/write.py", ["tests/export/c"]),
        ("casadical/measurements/kinds/contact.py", ["tests/measurements"]),
        ("tests/cli/test_cli.py", ["tests/cli/test_cli.py"]),
        ("tests/effects/bench.py", ["tests/effects"]),
        ("tests/conftest.py", ["tests"]),
        ("casadical/__init__.py", ["tests"]),
        ("docs/plan.md", ["tests/docs"]),
        ("LICENSE", []),
    ],
)
def test_a_file_has_the_own_tests_its_folder(path: str, wanted: list[str]) -> None:
    assert own_tests(path) == wanted


def test_every_room_of_the_package_has_tests() -> None:
    rooms = {path.parent.name for path in (ROOT / "casadical").glob("*/__init__.py")}
    assert len(rooms) > 10
    assert [room for room in rooms if own_tests(f"casadical/{room}/new.py") != [f"tests/{room}"]] == []


def test_rooms_above_are_those_that_import_it() -> None:
    assert affected(["casadical/pose_selection/plan.py"], above=True) == [
        f"tests/{room}" for room in ("diagnosis", "house", "pose_selection", "project")
    ]


def test_nothing_is_named_twice_and_nothing_that_is_gone() -> None:
    assert affected(["tests/cli/test_gone.py", "tests/cli/helper.py", "tests/cli/test_cli.py"]) == [
        "tests/cli",
        "tests/house",
    ]
    assert affected(["pyproject.toml", "casadical/core/basics.py"]) == ["tests"]


def test_the_command_prints_paths() -> None:
    command = [sys.executable, "tests/affected.py", "HEAD"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    printed = done.stdout.split()
    assert printed
    assert [path for path in printed if not (ROOT / path).exists()] == []


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

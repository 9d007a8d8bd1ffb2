"""Each command ends with the one sensible next command, and that command runs where it names no file to come."""

import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from command_line import own_planar, run

# Names of what is still to be measured.
TO_COME = ("LATER.csv", "later.csv", "DAY.csv", "program.csv", "next.csv", "RESULTS", "KEYDIR")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a problem, its results, and a copy of its table."""
    folder = tmp_path_factory.mktemp("walk")
    shutil.copytree(own_planar(folder / "arm"), folder / "second")
    assert run("calibrate", "arm", "--out", "results", "--quiet", folder=folder).returncode == 0
    return folder


def next_of(printed: str) -> list[str]:
    """The words of the command that is suggested last."""
    found = re.findall(r"^Next, [^\n]*:\n((?:    .*\n?)+)", printed, re.M)
    assert len(found) == 1, printed
    return shlex.split(found[0].replace("\\\n", " "))[1:]


ROBOT = "results/KM.robot.toml"
WALK = {
    "check": ["check", "arm"],
    "calibrate": ["calibrate", "arm", "--out", "results"],
    "calibrate of two": ["calibrate", "arm", "second"],
    "verify, valid": ["verify", "results", "arm/poses.csv"],
    "verify, valid by a promise": ["verify", "arm/robot.toml", "arm/poses.csv", "--promised-mm", "100"],
    "compare, nothing changed": ["compare", ROBOT, "arm"],
    "certificate": ["certificate", "results"],
    "model of results": ["export", "model", "results", "--out", "arm.urdf", "--overwrite"],
    "model of a folder": ["export", "model", "arm", "--out", "arm.xml", "--overwrite"],
    "plan": ["plan", "arm", "--target-mm", "0.1"],
    "isolability": ["plan", "arm", "--isolability"],
    "new": ["new", "made"],
}


@pytest.mark.parametrize("name", WALK)
def test_a_command_ends_with_the_next_one_and_it_runs(name: str, place: Path) -> None:
    done = run(*WALK[name], folder=place)
    assert done.returncode in (0, 5), done.stderr
    suggested = next_of(done.stdout)
    assert suggested[0] != "casadical", suggested
    if not {*suggested} & {*TO_COME} and suggested[0] not in ("diagnose", "fleet", "plan"):  # slow ones run elsewhere
        extra = ["--json", "made.json"] if suggested[0] == "certificate" else []
        again = run(*suggested, *extra, folder=place)
        assert again.returncode in (0, 5), again.stderr


def test_what_is_not_ready_says_when_to_look_again(place: Path) -> None:
    shutil.copytree(place / "arm", place / "wrong")
    (place / "wrong" / "poses.csv").write_text("q1_deg,q2_deg,x_mm,y_mm,z_mm\n1,2,3,4,up\n")
    done = run("check", "wrong", folder=place)
    assert done.returncode == 2
    assert next_of(done.stdout) == ["check", "wrong"]


def test_a_plan_suggests_the_poses_from_which_on_ten_more_gain_little(place: Path) -> None:
    done = run("plan", "arm", "--json", "plan.json", folder=place)
    told = json.loads((place / "plan.json").read_text())["forecast"]
    error = np.array(told["expected_error_mm"])
    enough = told["poses"][np.flatnonzero(error[10:] > 0.9 * error[:-10])[0]]
    assert "Next, to choose so many:" in done.stdout
    assert next_of(done.stdout) == ["plan", "arm", "--json", "plan.json", "-n", str(enough)]

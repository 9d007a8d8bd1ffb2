"""One refusal tells all faults of all files that a command was given: robot file, problem.toml and every table."""

from pathlib import Path

import pytest
from command_line import ROOT, own_planar, run

from casadical.cli.terminal import refusal
from casadical.core.basics import MAX_FAULTS_SHOWN, Fault, FaultsError

GOOD = (ROOT / "data" / "planar" / "planar.csv").read_text().splitlines()


def broken(folder: Path) -> Path:
    """A problem each of whose files has faults, and a second table."""
    own_planar(folder)
    (folder / "poses.csv").write_text("\n".join([*GOOD[:3], "999,1,1,2,x", *GOOD[4:], "170.5,1,2,3,4"]))
    (folder / "second.csv").write_text("\n".join([*GOOD[:7], "1,2,,3,4", *GOOD[8:]]))
    problem = (folder / "problem.toml").read_text()
    (folder / "problem.toml").write_text(f"color = 3\n{problem}".replace('"KM"', '"KMX"'))
    robot = (folder / "robot.toml").read_text()
    (folder / "good.toml").write_text(robot.replace("[-180, 180]", "[-170, 170]"))
    (folder / "robot.toml").write_text(robot.replace("a_mm = 400", 'a_mm = "400"'))
    return folder


@pytest.mark.parametrize("command", ["calibrate", "diagnose"])
def test_every_file_is_told_of_at_once(tmp_path: Path, command: str) -> None:
    broken(tmp_path / "arm")
    for tables, expected in (([], ["poses.csv", "4", "z_mm"]), (["arm/second.csv"], ["second.csv", "8", "x_mm"])):
        done = run(command, "arm", *tables, folder=tmp_path)
        assert done.returncode == 2
        told = done.stderr.replace("'", "").replace(",", "")
        assert all(word in told for word in expected), done.stderr
        assert "methods[1] = 'KMX'" in done.stderr
        assert "color = 3: unknown key" in done.stderr
        assert "joint[2].a_mm = '400': must be a valid number" in done.stderr
        assert len(done.stderr.splitlines()) < 60


def test_robot_table_and_poses_of_a_new_problem_are_told_at_once(tmp_path: Path) -> None:
    (tmp_path / "dh.csv").write_text("a_mm,alpha_deg,d_mm,theta_deg\n0,0,NA,0\n0,x,400,nan\n")
    (tmp_path / "poses.csv").write_text("")
    done = run("new", "arm", "--dh", "dh.csv", "--data", "poses.csv", folder=tmp_path)
    assert done.returncode == 2
    assert [k for k, line in enumerate(done.stderr.splitlines()) if k > 3 or "line 1 is row 1" in line] == [4]
    for told in ("row 2, column 'd_mm': 'NA'", "row 3, column 'theta_deg'", "column 'alpha_deg': 'x'", "it is empty"):
        assert told in done.stderr
    assert not (tmp_path / "arm").exists()


@pytest.mark.parametrize("tables", [3, MAX_FAULTS_SHOWN + 5])
def test_what_is_not_told_is_counted(tables: int, capfd: pytest.CaptureFixture[str]) -> None:
    faults = [Fault("poses.csv", (k,), "X [mm]", "nan", "no number", "", "") for k in range(tables)]
    refusal(FaultsError(faults, ["one.toml: wrong", "two.toml: wrong"]))
    told = capfd.readouterr().err
    assert told.count("poses.csv") == told.count("X [mm]") == min(tables, MAX_FAULTS_SHOWN)
    assert told.count("toml: wrong") == (2 if tables == 3 else 0)
    assert ("and 7 more" in told, "more" in told) == (tables > 3, tables > 3)


def test_a_room_is_not_judged_as_a_robot(tmp_path: Path) -> None:
    (tmp_path / "room.toml").write_text("casadical = 1\n[[joint]]\nlower_deg = 1\n")
    done = run("plan", ROOT / "problems" / "planar" / "robot.toml", "--room", "room.toml", folder=tmp_path)
    assert done.returncode == 2
    assert "joint[1].lower_deg = 1: unknown key; allowed here: number, limits_deg" in done.stderr
    assert done.stderr.count("lower_deg") == 1

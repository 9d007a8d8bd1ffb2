"""Three reflectors on one flange: recognised, calibrated with a tool each, refused where a name is unknown."""

from __future__ import annotations

import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import main

sys.path.insert(0, str(Path(__file__).parents[1] / "cli"))
import first_hour

from casadical import InputError, calibrate, read_robot
from casadical.identification import errors
from casadical.project.check import precheck
from casadical.project.new import new_problem
from casadical.project.problem import read_campaign
from casadical.robot.robot_file import to_toml

POINTS = np.array([[62.0, -35.0, 148.0], [-60.0, 20.0, 150.0], [10.0, 90.0, 120.0]])
NAMES = ["SMR1", "SMR2", "SMR3"]


def table(folder: Path, n: int, seed: int = 0, skip: int = 0) -> Path:
    """Every pose with one of three reflectors, which the column "Reflektor" names; German, decimal commas."""
    which = np.random.default_rng(seed).integers(0, 3, n)
    q, p = first_hour.measured(n, seed, tool=POINTS[which])
    lines = first_hour.table(
        [f"A{k} [°]" for k in range(1, 7)] + [f"{c} [mm]" for c in "XYZ"], q, p, ";", ","
    ).splitlines()
    named = [f"{line};{NAMES[k]}" for line, k in zip(lines[1:], which, strict=True)]
    path = folder / f"table{skip}.csv"
    path.write_text("\n".join([f"{lines[0]};Reflektor", *named[skip:]]) + "\n")
    (folder / "dh.csv").write_text(first_hour.DH)
    return path


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("targets")
    new_problem(folder / "arm", dh=folder / "dh.csv", data=table(folder, 100))
    calibrate(folder / "arm").write(folder / "results")
    return folder / "arm"


def test_three_reflectors_are_calibrated_together(arm: Path, tmp_path: Path) -> None:
    assert precheck(arm).ok
    robot = read_robot(arm.parent / "results" / "KM.robot.toml")
    assert {robot.tool_name, *(t.name for t in robot.targets)} == set(NAMES)
    found = {robot.tool_name: robot.tool.T[:3, 3], **{t.name: t.point for t in robot.targets}}
    apart = [[np.linalg.norm(1e3 * (found[a] - found[b])) for a in NAMES] for b in NAMES]
    expected = np.linalg.norm(POINTS[:, None] - POINTS[None], axis=2)
    np.testing.assert_allclose(apart, expected, atol=0.1)
    # Poses that were never given.
    later = read_campaign(arm, table(tmp_path, 140, skip=100), robot)
    assert len(later) == 40
    assert float(np.mean(errors(robot, later))) < 1.2e-4


def test_the_robot_file_keeps_every_tool_and_exports_take_the_first(arm: Path) -> None:
    path = arm.parent / "results" / "KM.robot.toml"
    robot = read_robot(path)
    assert path.read_text().count("[[tool]]") == 3
    again = tomllib.loads(to_toml(robot))["tool"]
    for tool, point in zip(again, [robot.tool.T[:3, 3], *(t.point for t in robot.targets)], strict=True):
        np.testing.assert_allclose(tool["xyz_mm"], 1e3 * point, rtol=1e-12)
    q = np.zeros(6)
    alone = first_hour.positions(np.zeros((1, 6)), first_hour.ROWS, 1e3 * robot.tool.T[:3, 3])[0]
    measured = np.array(robot.position(q, robot.parameters.values)).ravel()
    base = np.linalg.inv(robot.base.T)
    np.testing.assert_allclose(1e3 * (base[:3, :3] @ measured + base[:3, 3]), alone, atol=5)


def test_what_the_robot_file_does_not_name_is_refused(arm: Path, tmp_path: Path) -> None:
    robot = read_robot(arm.parent / "results" / "KM.robot.toml")
    path = table(tmp_path, 40)
    path.write_text(path.read_text().replace("SMR2", "SMR9"))
    with pytest.raises(InputError, match=r"column 'tool' names .*SMR9.* missing: SMR9"):
        read_campaign(arm, path, robot)
    with pytest.raises(InputError, match=r"the robot file has one tool: give a table \[\[tool\]\]"):
        read_campaign(arm, table(tmp_path, 40), replace(robot, targets=(), tool_name=""))


def test_the_three_commands_of_the_readme(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    folder, data = tmp_path / "arm", table(tmp_path, 60)
    assert main(monkeypatch, "new", folder, "--dh", tmp_path / "dh.csv", "--data", data, "--yes") == 0
    assert "Column 'tool' names 3 measured points" in " ".join(capfd.readouterr().out.split())
    assert main(monkeypatch, "check", folder, "--repair") == 0
    assert "+++" not in capfd.readouterr().out

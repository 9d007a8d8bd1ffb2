"""Three reflectors on one flange: recognised, calibrated with a tool each, refused where a name is unknown."""

import tomllib
from dataclasses import replace
from pathlib import Path

import arms
import first_hour
import numpy as np
import pytest
from command_line import main

from casadical import InputError, Measurements, calibrate, compare_files, diagnose, read_robot, verify
from casadical.core.transforms import frame
from casadical.identification import errors
from casadical.project.check.check import precheck
from casadical.project.new import new_problem
from casadical.project.problem import read_campaign, read_problem
from casadical.project.targets import recognised
from casadical.robot.robot_file import to_toml

POINTS = np.array([[62.0, -35.0, 148.0], [-60.0, 20.0, 150.0], [10.0, 90.0, 120.0]])
NAMES = ["SMR1", "SMR2", "SMR3"]
HEADINGS = [f"A{k} [deg]" for k in range(1, 7)] + [f"{c} [mm]" for c in "XYZ"]
FOURTH = '[[tool]]\nname = "SMR4"\nunknown = "position"\n\n[gravity]'


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


def nest_table(folder: Path, *, sign: int = 1, named: bool = False, poses: int = 25) -> Path:
    """Three reflectors at every pose, as a German table; in which no column names them, unless `named`."""
    q, p, which = first_hour.nested(poses)
    q[:, 2] *= sign
    names = [f"Achse {k} [°]" for k in range(1, 7)] + [f"Messwert {c} [mm]" for c in "XYZ"]
    lines = first_hour.table(names, q, p, ";", ",").splitlines()
    if named:
        lines = [f"{lines[0]};Reflektor", *(f"{line};{NAMES[k]}" for line, k in zip(lines[1:], which, strict=True))]
    path = folder / "messung.csv"
    path.write_bytes(("\r\n".join(lines) + "\r\n").encode("cp1252"))
    (folder / "dh.csv").write_text(first_hour.DH.replace("-150,60", "-150,150"))
    (folder / "arm.urdf").write_text(first_hour.urdf())
    return path


def distances(points: list[np.ndarray]) -> np.ndarray:
    return np.sort([1e3 * np.linalg.norm(a - b) for k, a in enumerate(points) for b in points[:k]])


NEST = np.sort([np.linalg.norm(a - b) for k, a in enumerate(first_hour.NEST) for b in first_hour.NEST[:k]])


@pytest.mark.slow
def test_reflectors_that_nobody_named_are_recognised_from_repeats(tmp_path, monkeypatch, capfd):
    """In a table in which a sign is turned, too."""
    arm, data = tmp_path / "arm", nest_table(tmp_path, sign=-1)
    said = f"repeats disagree: 3 targets on one flange, distances {', '.join(f'{d:.1f}' for d in NEST)} mm between them"
    assert main(monkeypatch, "new", arm, "--dh", tmp_path / "dh.csv", "--data", data, "--yes") == 0
    assert said[:43] in " ".join(capfd.readouterr().out.split())
    assert main(monkeypatch, "calibrate", arm) == 2
    assert said[:43] in capfd.readouterr().err
    assert main(monkeypatch, "check", arm) == 2
    printed = " ".join(capfd.readouterr().out.split())
    assert said[:43] in printed
    assert "check the robot file" not in printed
    assert main(monkeypatch, "check", arm, "--repair") == 0
    assert "repaired: 3 targets, named target1, target2, target3" in capfd.readouterr().out
    written = read_robot(arm / "robot.toml")
    np.testing.assert_allclose(distances([written.tool.T[:3, 3], *(t.point for t in written.targets)]), NEST, atol=1.0)
    assert main(monkeypatch, "calibrate", arm, "--out", tmp_path / "results") == 0
    robot = read_robot(tmp_path / "results" / "KM.robot.toml")
    np.testing.assert_allclose(distances([robot.tool.T[:3, 3], *(t.point for t in robot.targets)]), NEST, atol=0.15)
    capfd.readouterr()
    assert main(monkeypatch, "verify", tmp_path / "results" / "KM.robot.toml", data) == 0
    assert "no column names the targets; as they lie, target" in " ".join(capfd.readouterr().out.split())


@pytest.mark.slow
def test_targets_at_one_stop_are_in_one_set_and_no_repeats(tmp_path: Path) -> None:
    """Readings of a stop differ by thousandths of a degree, or not at all."""
    new_problem(tmp_path / "arm", dh=tmp_path / "dh.csv", data=nest_table(tmp_path, named=True))
    sets = {name: m.q for name, m in read_problem(tmp_path / "arm").parts()}
    apart = np.abs(sets["identify"][:, None] - sets["report"][None]).max(axis=2)
    assert np.rad2deg(apart.min()) > 0.1
    robot = read_problem(tmp_path / "arm").robot
    m = read_campaign(tmp_path / "arm", tmp_path / "arm" / "poses.csv", robot)
    stops = replace(m, q=np.round(m.q, 3))
    assert diagnose(robot, stops, effects=["backlash"], laws=False).replicates.poses == 0


def test_points_of_targets_that_nobody_named_are_those_of_the_flange() -> None:
    model = arms.six_axis()
    points = model.tool.T[:3, 3] + np.array([[0.0, 0.0, 0.0], [0.12, 0.03, 0.0], [-0.05, 0.1, 0.06]])
    built = [replace(model, tool=replace(model.tool, T=frame(model.tool.T[:3, :3], point))) for point in points]
    q = arms.readings(model, 40, 0)
    position = np.stack([arms.positions(one, q, k).position for k, one in enumerate(built)], axis=1).reshape(-1, 3)
    found = recognised(model, Measurements(np.repeat(q, 3, axis=0), "position", position=position))
    np.testing.assert_allclose(found.points, points, atol=5e-4)
    assert found.which.tolist() == [0, 1, 2] * 40


def test_a_station_that_moved_is_no_second_target(tmp_path: Path) -> None:
    q, p = first_hour.measured(40)
    q, p = np.vstack([q, q]), np.vstack([p, p + np.array([0, 25.0, 0])])
    names = [f"A{k} [°]" for k in range(1, 7)] + [f"{c} [mm]" for c in "XYZ"]
    new_problem(tmp_path / "arm", **first_hour.given(tmp_path, first_hour.table(names, q, p)))
    found = precheck(tmp_path / "arm")
    assert found.targets
    assert not found.targets.turning
    assert found.targets.which is None
    assert any("the station was moved between them" in f.text for f in found.of_level("warning"))


@pytest.mark.slow
def test_names_swapped_halfway_are_found_and_repaired(tmp_path, monkeypatch, capfd):
    path = table(tmp_path, 80)
    lines = path.read_text().splitlines()
    swapped = {"SMR1": "SMR2", "SMR2": "SMR1", "SMR3": "SMR3"}
    for k in range(46, len(lines)):
        start, _, name = lines[k].rpartition(";")
        lines[k] = f"{start};{swapped[name]}"
    path.write_text("\n".join(lines) + "\n")
    arm = tmp_path / "arm"
    assert main(monkeypatch, "new", arm, "--dh", tmp_path / "dh.csv", "--data", path, "--yes", "-q") == 0
    assert main(monkeypatch, "check", arm) == 2
    printed = " ".join(capfd.readouterr().out.split())
    assert "column 'tool' names the wrong target from row 4" in printed
    assert "SMR1, not SMR2, was measured in" in printed
    assert "check the robot file" not in printed
    assert main(monkeypatch, "check", arm, "--repair", "-q") == 0
    found = tomllib.loads((arm / "problem.toml").read_text())["measurements"][0]["tools"]
    right = np.random.default_rng(0).integers(0, 3, 80)
    assert found == {name: [2 + int(i) for i in np.flatnonzero(right == k)] for k, name in enumerate(NAMES)}


def test_targets_that_the_table_or_the_robot_file_lacks(tmp_path: Path) -> None:
    path = table(tmp_path, 60)
    new_problem(tmp_path / "arm", dh=tmp_path / "dh.csv", data=path)
    robot = tmp_path / "arm" / "robot.toml"
    robot.write_text(robot.read_text().replace("[gravity]", FOURTH))
    found = precheck(tmp_path / "arm")
    assert found.ok
    assert any("the robot file has SMR4, which no row names" in f.text for f in found.of_level("warning"))
    data = tmp_path / "arm" / "poses.csv"
    data.write_text("\n".join(line.rpartition(";")[0] for line in data.read_text().splitlines()))
    problem = tmp_path / "arm" / "problem.toml"
    problem.write_text(problem.read_text().replace('tool = "Reflektor"\n', ""))
    with pytest.raises(InputError, match="does not say which one was measured: add a column 'tool'"):
        calibrate(tmp_path / "arm")


def test_a_target_that_is_seen_once_is_left_out_by_new(tmp_path, monkeypatch, capfd):
    path = table(tmp_path, 60)
    lines = path.read_text().splitlines()
    lines[17] = lines[17].rpartition(";")[0] + ";SMR4"
    path.write_text("\n".join(lines) + "\n")
    arm = tmp_path / "arm"
    assert main(monkeypatch, "new", arm, "--dh", tmp_path / "dh.csv", "--data", path, "--yes") == 0
    assert "left out (leave_out in problem.toml): 18, one of few of target SMR4" in " ".join(
        capfd.readouterr().out.split()
    )
    assert (arm / "robot.toml").read_text().count("[[tool]]") == 3
    assert precheck(arm).ok


def test_poses_are_planned_for_the_first_of_several_targets(arm, tmp_path, monkeypatch):
    assert main(monkeypatch, "plan", arm, "-n", "14", "--no-order", "--out", tmp_path / "next.csv", "-q") == 0
    assert "tool" not in (tmp_path / "next.csv").read_text().splitlines()[0]


def later_table(path: Path, n: int = 60, *, zero: float = 0.0, named: bool = False, noise: float = 0.03) -> Path:
    """A pose with one of the three reflectors in each row, which no column names; zero : of joint 2 [deg]"""
    rng = np.random.default_rng(78)
    q, which = rng.uniform(0.8 * first_hour.LIMITS[:, 0], 0.8 * first_hour.LIMITS[:, 1], (n, 6)), rng.integers(0, 3, n)
    rows = first_hour.ROWS + np.random.default_rng(0).normal(0, 1, first_hour.ROWS.shape) * [0.03, 0.4, 0.4, 0.04]
    rows[1, 3] += zero
    p = first_hour.positions(q, rows, POINTS[which]) + rng.normal(0, noise, (n, 3))
    lines = first_hour.table(HEADINGS, q, p).splitlines()
    lines = [f"{lines[0]},tool", *(f"{line},{NAMES[k]}" for line, k in zip(lines[1:], which, strict=True))]
    path.write_text("\n".join(lines if named else [line.rsplit(",", 1)[0] for line in lines]) + "\n")
    return path


@pytest.fixture(scope="module")
def one_target(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same arm, calibrated with one reflector."""
    folder = tmp_path_factory.mktemp("one")
    new_problem(folder / "arm", **first_hour.given(folder, first_hour.table(HEADINGS, *first_hour.measured(90))))
    calibrate(folder / "arm").write(folder / "results")
    return folder / "arm"


@pytest.mark.slow
@pytest.mark.parametrize("calibrated", ["arm", "one_target"])
@pytest.mark.parametrize(("n", "named"), [(60, False), (60, True), (12, False)])
def test_a_later_table_needs_no_names_of_its_targets(calibrated, n, named, request, tmp_path):
    """Each row is given to a target as it lies; only twelve rows of targets that nobody knows cannot be told apart."""
    folder: Path = request.getfixturevalue(calibrated)
    results = folder.parent / "results"
    if (calibrated, n) == ("one_target", 12):
        with pytest.raises(InputError, match="the model does not fit"):
            verify(results, later_table(tmp_path / "later.csv", n))
        return
    kept = verify(results, later_table(tmp_path / "later.csv", n, named=named))
    assert kept.valid
    assert ("no column names the targets" in " ".join(kept.notes)) != named
    changed = later_table(tmp_path / "later.csv", n, named=named, zero=0.05)
    broken = verify(results, changed)
    assert not broken.valid
    assert [step.code for step in broken.next] == [f"casadical compare {folder} {changed}"]
    compared = compare_files([folder, changed])
    assert [step.code for step in compared.next] == [f"casadical calibrate {folder} {changed} --out results"]
    (found,) = compared.changes
    assert found.cause.label == "joint_zero@2"
    assert found.amounts[0].value == pytest.approx(0.05, abs=0.003)
    same = compare_files([folder, later_table(tmp_path / "later.csv", n, named=named)])
    assert not same.changes
    assert not same.unexplained

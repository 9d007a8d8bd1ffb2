"""What readings of some kinds cannot tell at all is said by every command, with the one thing that would."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import run

from casadical.core.basics import Array
from casadical.measurements.kinds.distance import Distance
from casadical.robot.robot_file import read_robot

ROOT = Path(__file__).parents[2]
UR10E = ROOT / "problems" / "ur10e" / "robot.toml"
LINE = np.array([[2.0, -1.0, 0.3], [2.0, 0.0, 0.3], [2.0, 1.1, 0.3]])
ABOUT = np.array([[1.8, 0.3, 0.0], [-0.9, 1.6, 1.2], [-0.6, -1.7, 0.6]])


def readings(count: int = 60) -> tuple[pd.DataFrame, Array]:
    """Readings of a UR10e [deg], and where it holds its tool there, shape (count, 3) [m]."""
    robot, rng = read_robot(UR10E), np.random.default_rng(0)
    lower, upper = np.array([[j.lower, j.upper] for j in robot.joints]).T
    q = lower + (upper - lower) * rng.uniform(0.3, 0.7, (count, 6))
    p = robot.position.map(count)(q.T, robot.parameters.values).full().T
    table = pd.DataFrame(np.rad2deg(q), columns=[f"q{i}_deg" for i in range(1, 7)]).assign(pose=range(count))
    return table, p


def wires(folder: Path, places: Array, known: bool) -> list[str]:
    """A table for each of these places, shape (k, 3) [m]; what problem.toml says of them."""
    table, p = readings()
    told = []
    for k, place in enumerate(places, 1):
        noise = np.random.default_rng(k).normal(0, 0.05, len(p))
        made = table.assign(distance_mm=1e3 * np.linalg.norm(p - place, axis=1) + noise)
        if known:
            made = made.assign(**{f"to_{c}_mm": 1e3 * x for c, x in zip("xyz", place, strict=True)})
        made.to_csv(folder / f"wire{k}.csv", index=False)
        told.append(f'[[measurements]]\nfile = "wire{k}.csv"\nkind = "distance"')
    return told


def sockets(folder: Path, separation: str = "") -> list[str]:
    """Poses that are said to hold two sockets; whether they do is not what is looked at."""
    table, p = readings()
    near = p[:, 0] > np.median(p[:, 0])
    table.assign(point=np.where(near, "A", "B")).to_csv(folder / "sockets.csv", index=False)
    return [f'[[measurements]]\nfile = "sockets.csv"\nkind = "contact"\n{separation}']


def sessions(folder: Path) -> list[str]:
    """Two sessions of other poses each."""
    table, p = readings()
    made = table.assign(**{f"{c}_mm": 1e3 * p[:, k] for k, c in enumerate("xyz")})
    made.assign(session=["May"] * 30 + ["June"] * 30).to_csv(folder / "poses.csv", index=False)
    return ['[[measurements]]\nfile = "poses.csv"']


def problem(folder: Path, made: Callable[[Path], list[str]]) -> Path:
    arm = folder / "arm"
    arm.mkdir()
    shutil.copy(UR10E, arm / "robot.toml")
    parts = ['casadical = 1\ntitle = "t"\ndata = "synthetic"\nmethods = ["KM"]', *made(arm)]
    (arm / "problem.toml").write_text("\n\n".join(parts) + "\n")
    return arm


CASES: dict[str, tuple[Callable[[Path], list[str]], str]] = {
    "known places in a line": (lambda f: wires(f, LINE, True), "distances to one place off that line show it"),
    "unknown places in a line": (lambda f: wires(f, LINE, False), "distances to one place off that line show it"),
    "one wire": (lambda f: wires(f, LINE[:1], False), "distances to a second and a third place, not in line with it"),
    "sockets": (sockets, "one distance between two of them gives it ([[measurements.separation]])"),
    "sessions": (sessions, "shares no pose with 'May'; some poses of 'May' measured again would"),
    "wires about the robot": (lambda f: wires(f, ABOUT, False), ""),
}


@pytest.mark.parametrize(
    "case", [name if name.startswith("s") else pytest.param(name, marks=pytest.mark.slow) for name in CASES]
)
def test_check_says_what_these_readings_cannot_tell(tmp_path: Path, case: str) -> None:
    made, said = CASES[case]
    done = run("check", problem(tmp_path, made), "-q", "--json", tmp_path / "out.json")
    found = json.loads((tmp_path / "out.json").read_text())["findings"]
    texts = [f["text"] for f in found if f["text"].startswith("these readings cannot ")]
    assert done.returncode in (0, 2)
    assert len(texts) == bool(said)
    assert all(said in text for text in texts)


@pytest.mark.slow
def test_calibrate_and_diagnose_say_it_as_well(tmp_path: Path) -> None:
    arm = problem(tmp_path, CASES["unknown places in a line"][0])
    calibrated = run("calibrate", arm)
    assert "These readings cannot see a turn of the whole robot about the line" in " ".join(calibrated.stdout.split())
    tables = [arm / f"wire{k}.csv" for k in (1, 2, 3)]
    diagnosed = run("diagnose", arm, *tables, "--no-laws", "--together", "--json", tmp_path / "out.json")
    assert "These data cannot see a turn of the whole robot about the line" in " ".join(diagnosed.stdout.split())
    assert len(json.loads((tmp_path / "out.json").read_text())["cannot"]) == 1
    # The title has every table, and the error of a pose is said to be that of its three readings.
    assert diagnosed.stdout.startswith("wire1, wire2, wire3 (")
    assert "of each the norm over up to 3 readings" in " ".join(diagnosed.stdout.split())


def test_a_distance_between_two_sockets_gives_the_size(tmp_path: Path) -> None:
    separation = '[[measurements.separation]]\npoints = ["A", "B"]\ndistance_mm = 700.0\n'
    arm = problem(tmp_path, lambda folder: sockets(folder, separation))
    run("check", arm, "-q", "--json", tmp_path / "out.json")
    found = json.loads((tmp_path / "out.json").read_text())["findings"]
    assert not [f for f in found if f["text"].startswith("these readings cannot ")]


@pytest.mark.slow
def test_a_single_distance_of_each_wire_is_refused_and_one_of_the_set_is_all(tmp_path: Path) -> None:
    arm = problem(tmp_path, lambda folder: wires(folder, ABOUT, False))
    text = (arm / "problem.toml").read_text()
    for size, said in (("1", ""), ("2", "6 numbers were measured, but at least")):
        (arm / "problem.toml").write_text(f"{text}\n[sets]\nidentify = {size}\n")
        done = run("calibrate", arm, "-q")
        assert done.returncode == (2 if said else 0)
        assert said in done.stderr
    assert Distance().point_starts({"distance": np.array([1.2])}, np.zeros((1, 3))).tolist() == [[0.0, 0.0, 1.2]]


def test_far_ends_are_those_that_fit_the_distances_best() -> None:
    """Poses held out have far ends of their own: from few of them, distances in error by 0.1 mm stay that well fitted.

    The squares of the distances alone would leave many times as much (as scipy's optimum shows).
    """
    from scipy.optimize import least_squares

    rng = np.random.default_rng(1)
    p, far = rng.uniform(-0.4, 0.4, (18, 3)), np.array([1.8, 0.3, 0.0])
    arrays = {"distance": np.linalg.norm(p - far, axis=1) + rng.normal(0, 1e-4, 18)}
    best = least_squares(lambda x: np.linalg.norm(p - x, axis=1) - arrays["distance"], far, xtol=1e-15, ftol=1e-15)
    found = Distance().errors(arrays, p, lambda _: p)
    np.testing.assert_allclose(found, np.abs(best.fun), atol=1e-7)
    assert Distance().errors(arrays, p, lambda _: p).max() < 4e-4
    flat = p * [1, 1, 0]  # beside a plane the far end stands on either side of it
    exact = {"distance": np.linalg.norm(flat - [0.3, 0.2, 0.7], axis=1)}
    np.testing.assert_allclose(np.abs(Distance().start(exact, flat)), [0.3, 0.2, 0.7], atol=1e-9)

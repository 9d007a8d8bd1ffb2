"""Several slips at once: found, shown, written, and the repaired problem calibrates; clean tables are left alone."""

import re
from collections.abc import Callable
from pathlib import Path

import arms
import first_hour
import numpy as np
import pandas as pd
import pytest
from command_line import main, own_planar
from marks import slow

from casadical import Measurements, calibrate
from casadical.project.check.check import precheck
from casadical.project.check.repair import repaired
from casadical.project.check.slip_fit import Hypothesis
from casadical.project.check.slip_list import LENGTHS_MIRROR_WARNING, MIRROR_WARNING
from casadical.project.check.slips import outside, slip_fit
from casadical.project.new import new_problem
from casadical.project.problem import read_problem
from casadical.project.targets import recognised

Table = tuple[np.ndarray, np.ndarray]
ROOT = Path(__file__).parents[3]


def signs_and_columns(q: np.ndarray, p: np.ndarray) -> Table:
    q = q * [1, -1, 1, -1, 1, 1]
    return q[:, [0, 1, 2, 4, 3, 5]], p


def shifted_and_left_handed(q: np.ndarray, p: np.ndarray) -> Table:
    return q[:-1], p[1:] * [1, -1, 1]


def zero_unit_and_sign(q: np.ndarray, p: np.ndarray) -> Table:
    q = q.copy()
    q[:, 2] += 90
    q[:, 4] *= -1
    return q, p / 25.4


def coupled_and_free_zero(q: np.ndarray, p: np.ndarray) -> Table:
    q = q.copy()
    q[:, 3] -= 37.0
    q[:, 2] += q[:, 1]
    return q, p


def heavy_arm(q: np.ndarray, p: np.ndarray) -> Table:
    """The third reading is -J3 - J2, and the joints of the wrist count the other way."""
    third = -q[:, 2] - q[:, 1]
    return np.column_stack([q[:, :2], third, -q[:, 3:]]), p


def heavy_arm_and_two_zeros(q: np.ndarray, p: np.ndarray) -> Table:
    q, p = heavy_arm(q, p)
    return q + np.array([0, 37, 0, 0, 90, 0]), p


CASES = {
    signs_and_columns: ("columns q4 and q5 are swapped", "joint 2 counts the other way"),
    shifted_and_left_handed: ("the readings stand 1 row after their positions", "the measuring frame is left-handed"),
    zero_unit_and_sign: ("the zero of joint 3 is 90 deg off (add -90 to q3_deg)", "inches", "joint 5 counts the other"),
    heavy_arm: (
        "joint 3 counts the other way (turn the sign of q3); q3 counts from the horizontal, not from link 2",
        "(turn the sign of q4); joint 5 counts the other way (turn the sign of q5); joint 6 counts the other way",
    ),
    heavy_arm_and_two_zeros: (
        "q3 counts from the horizontal, not from link 2",
        "the zero of joint 2 is 3",
        "joint 4 c",
    ),
    coupled_and_free_zero: ("q3 counts from the horizontal, not from link 2", "the zero of joint 4 is 3"),
}


def folder_of(tmp_path: Path, slip: Callable[..., Table] | None) -> Path:
    q, p = first_hour.measured(90)
    if slip:
        q, p = slip(q, p)
    text = first_hour.DH.replace("-150,60", "-400,400").replace("-90,130", "-400,400").replace("-115,115", "-400,400")
    table = first_hour.write(tmp_path, "messung.csv", q, p)
    (tmp_path / "dh.csv").write_text(text)
    new_problem(tmp_path / "arm", dh=tmp_path / "dh.csv", data=table)
    return tmp_path / "arm"


@pytest.mark.parametrize(
    "slip", [heavy_arm, *slow(*(case for case in CASES if case is not heavy_arm))], ids=lambda s: s.__name__
)
def test_slips_are_found_together_and_repaired(slip, tmp_path):
    folder = folder_of(tmp_path, slip)
    found = precheck(folder)
    said = " ".join(f.text for f in found.findings if f.level == "error")
    for words in CASES[slip]:
        assert words in said
    assert "--repair" not in said  # of tables beside the folder nothing is repaired
    assert [step.code for step in found.next] == [f"casadical check {folder} --repair"]
    before = (folder / "poses.csv").read_bytes()
    shown = repaired(found)
    added = re.findall(r"^\+(?!\+\+)(.*)$", shown, re.MULTILINE)
    assert added
    assert {*added} <= {
        line for name in ("problem.toml", "robot.toml") for line in (folder / name).read_text().splitlines()
    }
    assert "mm before" in shown
    assert (folder / "poses.csv").read_bytes() == before
    assert precheck(folder).ok  # a second check agrees
    assert calibrate(folder).accuracies["KM"]["report"]["calibrated"].mean < 1e-4


def mirrored(q: np.ndarray, p: np.ndarray) -> Table:
    return q, p * [1, -1, 1]


def in_metres(q: np.ndarray, p: np.ndarray) -> Table:
    return q, p / 1e3


@pytest.mark.parametrize("slip", slow(mirrored, in_metres), ids=lambda s: s.__name__)
def test_a_slip_of_the_positions_alone_is_repaired(slip, tmp_path, monkeypatch):
    folder = folder_of(tmp_path, slip)
    assert main(monkeypatch, "check", folder, "--repair", "-q") == 0
    assert calibrate(folder).accuracies["KM"]["report"]["calibrated"].mean < 1e-4
    warned = [f.text for f in precheck(folder).of_level("warning") if f.topic == "units"]
    assert warned == ([f"problem.toml turns the sign of y: {MIRROR_WARNING}"] if slip is mirrored else [])


@pytest.mark.slow
def test_a_robot_with_a_four_bar_is_repaired_of_one_slip(tmp_path: Path, monkeypatch, capfd) -> None:
    folder = tmp_path / "arm"
    folder.mkdir()
    table = pd.read_csv(ROOT / "data" / "hh800_twin" / "hh800_twin.csv")
    table.assign(q5_deg=-table.q5_deg).to_csv(folder / "poses.csv", index=False)
    (folder / "robot.toml").write_bytes((ROOT / "problems" / "hh800" / "robot.toml").read_bytes())
    (folder / "problem.toml").write_text(
        'casadical = 1\ntitle = "t"\n[[measurements]]\nfile = "poses.csv"\n[sets]\ncolumn = "set"\n'
    )
    assert main(monkeypatch, "check", folder, "--repair") == 0
    assert "+readings = [[5, -1.0]]" in capfd.readouterr().out


def test_why_nothing_is_written_is_said(tmp_path: Path, monkeypatch, capfd) -> None:
    folder = own_planar(tmp_path / "arm")
    table = pd.read_csv(folder / "poses.csv")
    table[["x_mm", "y_mm", "z_mm"]] = np.random.default_rng(0).permutation(table[["x_mm", "y_mm", "z_mm"]])
    table.to_csv(folder / "poses.csv", index=False)
    assert main(monkeypatch, "check", folder, "--repair") == 2
    assert "nothing more is written: of " in capfd.readouterr().out


def test_one_link_in_metres_is_named_and_repaired(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, None)
    robot = folder / "robot.toml"
    robot.write_text(robot.read_text().replace("a_mm = 700.0", "a_mm = 0.7"))
    found = precheck(folder)
    (error,) = found.of_level("error")
    assert "a of row 3 is 700.0 mm, not 0.7 mm" in error.text
    assert "-a_mm = 0.7\n+a_mm = 700.0" in repaired(found)
    assert precheck(folder).ok


def test_estimated_masses_lie_in_the_frames_of_the_convention_that_was_meant(tmp_path: Path) -> None:
    rows = "0,90,180.7,0\n-612.7,0,0,0\n-571.55,0,0,0\n0,90,174.15,0\n0,-90,119.85,0\n0,0,116.55,0\n"
    (tmp_path / "dh.csv").write_text(f"a_mm,alpha_deg,d_mm,theta_deg\n{rows}")
    new_problem(tmp_path / "right", dh=tmp_path / "dh.csv", convention="standard")
    new_problem(tmp_path / "wrong", dh=tmp_path / "dh.csv", data=tmp_path / "right" / "poses.csv")
    assert '+convention = "standard"' in repaired(precheck(tmp_path / "wrong"))
    right, mended = ((tmp_path / name / "robot.toml").read_text() for name in ("right", "wrong"))
    bodies = [line for line in right.splitlines() if line.startswith(("body", "mass_share", "com_mm"))]
    assert len(bodies) == 8
    assert bodies == [line for line in mended.splitlines() if line.startswith(("body", "mass_share", "com_mm"))]


@pytest.mark.slow
def test_lengths_of_the_whole_robot_in_another_unit_are_repaired_there(tmp_path: Path) -> None:
    """Not in the positions: the accuracy would be a thousand times too good."""
    folder = folder_of(tmp_path, None)
    robot = folder / "robot.toml"
    lengths = re.compile(r"^(a_mm|d_mm) = (.*)$", re.MULTILINE)
    robot.write_text(lengths.sub(lambda m: f"{m[1]} = {float(m[2]) / 1e3!r}", robot.read_text()))
    found = precheck(folder)
    assert "the lengths in the robot file are in another unit (times 1000)" in " ".join(f.text for f in found.findings)
    repaired(found)
    assert "a_mm = 700.0" in robot.read_text()
    assert precheck(folder).ok


def test_a_clean_table_is_left_alone(tmp_path, monkeypatch, capfd):
    folder = folder_of(tmp_path, None)
    texts = {path: path.read_bytes() for path in folder.iterdir()}
    assert main(monkeypatch, "check", folder, "--repair") == 0
    assert "repaired" not in capfd.readouterr().out
    assert {path: path.read_bytes() for path in folder.iterdir()} == texts


def of_wires(folder: Path, q: np.ndarray, p: np.ndarray) -> Path:
    """A problem of three wires with unknown ends; q : readings [deg], p : positions [mm]."""
    wires = np.array([[1500, 400, 200], [-900, 1400, 700], [200, -1600, 1100]])[np.arange(90) % 3]
    columns = {f"q{k}_deg": column for k, column in enumerate(q.T, 1)}
    length = np.linalg.norm(p - wires, axis=1) + np.random.default_rng(0).normal(0, 0.02, 90)
    table = pd.DataFrame(columns | {"distance_mm": length, "anchor": [*"abc"] * 30})
    new_problem(folder / "arm", **first_hour.given(folder, table))
    return folder / "arm"


@pytest.mark.parametrize("sign", [-1, *slow(1)])
def test_a_slip_of_lengths_that_moves_little_is_found(sign: int, tmp_path: Path) -> None:
    """The last joint, the tool some millimetres beside its axis; without a slip the table is ready."""
    q, p = first_hour.measured(90, tool=np.array([9.0, 4.0, 120.0]))
    found = precheck(of_wires(tmp_path, q * [1, 1, 1, 1, 1, sign], p))
    assert found.ok == (sign > 0)
    assert ("joint 6 counts the other way" in " ".join(f.text for f in found.findings)) == (sign < 0)


@pytest.mark.slow
def test_slips_of_a_table_of_lengths_are_found_and_repaired(tmp_path):
    """The second joint turned, the fourth shifted by a quarter turn."""
    q, p = first_hour.measured(90)
    arm = of_wires(tmp_path, q * [1, -1, 1, 1, 1, 1] + [0, 0, 0, 90, 0, 0], p)
    found = precheck(arm)
    said = " ".join(f.text for f in found.findings if f.level == "error")
    assert "joint 2 counts the other way (turn the sign of q2); the zero of joint 4 is 90 deg off" in said
    assert LENGTHS_MIRROR_WARNING in said
    assert "Rival" not in said
    repaired(found)
    assert calibrate(arm).accuracies["KM"]["report"]["calibrated"].mean < 1e-4


def test_repeats_that_disagree_each_by_another_way_are_no_targets() -> None:
    robot = read_problem(ROOT / "problems" / "planar").robot
    q = np.repeat(np.random.default_rng(3).uniform(-1, 1, (20, robot.n)), 2, axis=0)
    apart = np.linspace(0.01, 0.2, 20)
    apart[8:13] = apart[10]
    p = np.random.default_rng(4).uniform(-0.3, 0.3, (40, 3))
    p[1::2] = p[::2] + apart[:, None] * [1, 0, 0]
    assert recognised(robot, Measurements(q=q, kind="position", position=p)) is None
    p[1::2] = p[::2] + apart[10] * np.eye(3)[0]
    found = recognised(robot, Measurements(q=q, kind="position", position=p))
    assert found is not None
    assert "the station was moved" in found.in_words("t.csv")


def test_readings_a_hundredth_beyond_the_limits_are_within() -> None:
    robot = read_problem(ROOT / "problems" / "planar").robot
    lower, upper = np.array([(j.lower, j.upper) for j in robot.joints]).T
    nothing = Hypothesis.none(robot.n)
    for q, wanted in ((upper + 0.005, False), (upper + 0.02, True), (lower - 0.005, False), (lower - 0.02, True)):
        assert outside(nothing, robot, np.tile(q, (20, 1))) is wanted


def test_of_positions_that_fit_nothing_is_wrong_and_nothing_turned() -> None:
    arm, nothing = arms.six_axis(), Hypothesis.none(6)
    fit = slip_fit(arm, arms.positions(arm, arms.readings(arm, 30, 0), 1)).placed(nothing, as_given=True)
    assert (nothing.slips, nothing.cost, fit.slips, fit.turn) == (0, 0.0, 0, 0.0)
    lengths = arms.distances(arm, arms.readings(arm, 40, 0), np.array([1.0, 0.5, 0.2]), 1)
    assert slip_fit(arm, lengths).placed(nothing, as_given=True).turn == 0.0
    assert fit.error == pytest.approx(arms.NOISE * 1.5, rel=0.3)  # median of three coordinates' noise

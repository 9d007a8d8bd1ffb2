"""Mistakes that people make, planted in good data: each is found and named before anything is solved."""

import json
import shutil
import tomllib
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import first_hour
import numpy as np
import pandas as pd
import pytest
from command_line import run
from marks import slow

from casadical import InputError, Joint, Measurements, Robot, calibrate
from casadical.identification.identification import identify
from casadical.project.check.check import precheck
from casadical.project.check.findings import far_rows, limits_findings
from casadical.project.check.plausible import repeats
from casadical.project.check.repair import repaired
from casadical.project.check.result import Precheck
from casadical.project.new import new_problem
from casadical.project.problem import read_problem

ROOT = Path(__file__).parents[3]
UR10E = ROOT / "data" / "campaigns" / "practice" / "ur10e-P03.csv"
Q = [f"q{i}_deg" for i in range(1, 7)]
XYZ = ["x_mm", "y_mm", "z_mm"]


def problem_with(folder: Path, change: Callable[[pd.DataFrame], pd.DataFrame], extra: str = "") -> Path:
    """The UR10e's problem with its table changed."""
    made = folder / "arm"
    made.mkdir()
    shutil.copy(ROOT / "problems" / "ur10e" / "robot.toml", made / "robot.toml")
    change(pd.read_csv(UR10E)).to_csv(made / "poses.csv", index=False)
    text = f'casadical = 1\ntitle = "t"\ndata = "synthetic"\n[[measurements]]\nfile = "poses.csv"\n{extra}'
    (made / "problem.toml").write_text(text)
    return made


@cache
def checked(name: str) -> Precheck:
    """A problem of the repository."""
    return precheck(ROOT / "problems" / name)


def said(found: Precheck, level: str) -> str:
    return "\n".join(f"{f.topic}: {f.text}" for f in found.findings if f.level == level)


@pytest.mark.parametrize("name", ["planar", "kr210", "ur10", *slow("ur10e", "panda_1")])
def test_a_good_problem_is_ready_and_what_it_holds_is_what_calibration_holds(name: str) -> None:
    """Without a solve; the certified lists are those of the solved ones."""
    found = checked(name)
    assert found.ok
    assert said(found, "error") == ""
    certified = tomllib.loads((ROOT / "problems" / name / "certified.toml").read_text())
    for view in found.outlooks:
        assert sorted(view.unidentifiable) == sorted(certified[view.method]["not_identifiable"])
        assert len(view.names) == certified[view.method]["identified"]


@pytest.mark.parametrize(("name", "near"), [("ur10", 0.1), *slow(("kr210", 0.1), ("ur10e", 0.1), ("hh800", 0.3))])
def test_the_error_on_held_out_poses_is_foretold(name: str, near: float) -> None:
    view = checked(name).outlooks[-1]
    certified = tomllib.loads((ROOT / "problems" / name / "certified.toml").read_text())[view.method]["report"]
    assert view.held_out is not None
    assert 1e3 * view.held_out == pytest.approx(certified["mean_mm"], rel=near)


def test_a_model_that_lacks_something_is_told_from_noise(tmp_path: Path) -> None:
    """The UR10e's campaign hides a gear eccentricity; its instrument is stated to be good to 0.01 mm."""
    made = problem_with(tmp_path, lambda t: t, "sigma_mm = 0.01\n")
    assert "SKCM: a linear step leaves 0.0" in said(precheck(made), "warning")


@pytest.mark.slow
def test_too_few_numbers_to_try_compliance_are_no_error(tmp_path: Path) -> None:
    """What `calibrate` does not need is a warning; then one method is judged."""
    q, p = first_hour.measured(15)
    (tmp_path / "dh.csv").write_text(first_hour.DH)
    pd.DataFrame(np.column_stack([q, p]), columns=[*Q, *XYZ]).to_csv(tmp_path / "t.csv", index=False)
    new_problem(tmp_path / "arm", dh=tmp_path / "dh.csv", data=tmp_path / "t.csv")
    found = precheck(tmp_path / "arm")
    assert found.ok
    assert "too few to see whether the joints give under load" in said(found, "warning")
    assert list(calibrate(tmp_path / "arm").accuracies) == ["KM"]
    pd.read_csv(tmp_path / "t.csv").iloc[:9].to_csv(tmp_path / "arm" / "poses.csv", index=False)
    fewer = precheck(tmp_path / "arm")
    assert not fewer.ok
    assert [step.code for step in fewer.next] == [f"casadical plan {tmp_path / 'arm'}"]


def test_expected_errors_are_those_that_calibration_states_afterwards() -> None:
    problem = read_problem(ROOT / "problems" / "planar")
    result = identify(problem.robot, problem.sets["identify"][0], method="KM")
    with pytest.raises(InputError, match="above zero"):
        precheck(ROOT / "problems" / "planar", noise=0.0)
    (view,) = precheck(ROOT / "problems" / "planar", noise=result.sigmas[0][0]).outlooks
    assert view.names == result.names
    assert view.errors == pytest.approx(result.standard_errors, rel=0.02)


@pytest.mark.slow
def test_expected_accuracy_is_the_mean_of_many_noisy_calibrations() -> None:
    """By simulation: noise is drawn, the arm calibrated, its error read on other poses."""
    from casadical.identification.accuracy import predicted

    problem = read_problem(ROOT / "problems" / "planar")
    (m,) = problem.sets["identify"]
    true, _ = predicted(problem.robot, m)
    rng = np.random.default_rng(4)
    lower, upper = np.array([(j.lower, j.upper) for j in problem.robot.joints]).T
    q = rng.uniform(lower, upper, (400, 2))
    far = replace(m, q=q, position=np.zeros((400, 3)), weight=np.ones(400), row=np.arange(400), conditions={})
    goal, _ = predicted(problem.robot, far)
    squares = []
    for _ in range(60):
        noisy = replace(m, position=true + rng.normal(0, 2e-5, true.shape))
        found = identify(problem.robot, noisy, method="KM", priors=False).robot
        squares.append(((predicted(found, far)[0] - goal) ** 2).sum(axis=1).mean())
    (view,) = precheck(ROOT / "problems" / "planar", noise=2e-5).outlooks
    assert view.accuracy == pytest.approx(np.sqrt(np.mean(squares)), rel=0.1)


def _turned(column: str) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda t: t.assign(**{column: -t[column]})


SLIPS: dict[str, tuple[Callable[[pd.DataFrame], pd.DataFrame], str]] = {
    "radians as degrees": (
        lambda t: t.assign(**{c: np.deg2rad(t[c]) for c in Q}),
        "in radians? name them q1_rad",  # refused on reading
    ),
    "metres as mm": (lambda t: t.assign(**{c: t[c] / 1e3 for c in XYZ}), "metres under names of millimetres"),
    "inches as mm": (lambda t: t.assign(**{c: t[c] / 25.4 for c in XYZ}), "inches under names of millimetres"),
    "a joint the other way": (_turned("q3_deg"), "turn the sign of q3"),
    "a zero off": (lambda t: t.assign(q2_deg=t.q2_deg - 90), "add 90 to q2_deg"),
    "a left-handed frame": (_turned("y_mm"), "left-handed"),
    "from the horizontal": (lambda t: t.assign(q3_deg=t.q3_deg + t.q2_deg), "subtract q2"),
}


@pytest.mark.parametrize(
    "name",
    [name if name in ("metres as mm", "a zero off") else pytest.param(name, marks=pytest.mark.slow) for name in SLIPS],
)
def test_a_slip_is_named(name: str, tmp_path: Path) -> None:
    change, words = SLIPS[name]
    found = precheck(problem_with(tmp_path, change))
    assert not found.ok
    assert words in said(found, "error")
    assert found.outlooks == ()


@pytest.mark.parametrize("joint", [6, *slow(1, 2, 3)])
def test_one_joint_in_radians_is_named(joint: int, tmp_path: Path) -> None:
    """Joint 6 too, where the nominal model still is within 2 % of its reach."""
    name = f"q{joint}_deg"
    found = precheck(problem_with(tmp_path, lambda t: t.assign(**{name: np.deg2rad(t[name])})))
    assert f"nominal model is {1e3 * found.slips.before.error:.4g} mm (median)" in said(found, "error")
    assert f"1.69 mm would be left if q{joint} alone holds radians under a name of degrees" in said(found, "error")
    assert f"joint {joint} covers" in said(found, "warning")
    assert "are these radians?" in said(found, "warning")


@pytest.mark.parametrize(
    ("name", "said_to_be", "meant"), [("kr210", "standard", "modified"), *slow(("ur10_grid", "modified", "standard"))]
)
def test_dh_rows_of_the_other_convention_are_named(name: str, said_to_be: str, meant: str, tmp_path: Path) -> None:
    (tmp_path / "problems").mkdir()
    made = Path(shutil.copytree(ROOT / "problems" / name, tmp_path / "problems" / name))
    (tmp_path / "data").symlink_to(ROOT / "data")
    lines = (made / "robot.toml").read_text().splitlines()
    kept = [line for line in lines if not line.startswith("convention")]
    (made / "robot.toml").write_text("\n".join([f'convention = "{said_to_be}"', *kept]))
    assert f"if the DH rows are of the {meant} convention, not {said_to_be}" in said(precheck(made), "error")


def test_limits_that_nobody_gave_are_said_to_be_assumed() -> None:
    assert "joints 1, 2, 3, 4, 5, 6: -360 .. 360 deg" in said(checked("ur10"), "note")
    assert "limits" not in said(checked("kr210"), "note")


def test_joints_in_another_unit_than_the_first_are_an_error_that_is_named(tmp_path: Path) -> None:
    """One joint in degrees among five in radians: no unit of the whole table."""

    def change(t: pd.DataFrame) -> pd.DataFrame:
        return t.assign(**{c: np.deg2rad(t[c]) for c in Q[1:]})

    found = precheck(problem_with(tmp_path, change))
    assert not found.ok
    assert "q2, q3, q4, q5, q6 are radians under names of degrees" in said(found, "error")


def test_every_fault_of_a_table_is_listed_at_once(tmp_path: Path) -> None:
    def change(t: pd.DataFrame) -> pd.DataFrame:
        t.loc[3, "x_mm"] = np.nan
        t.loc[[5, 6], "z_mm"] = np.nan
        return t.drop(columns=["q4_deg", "q6_deg"])

    folder = problem_with(tmp_path, change)
    table = next(folder.glob("*.csv"))
    assert table.name in precheck(folder, tables=[table]).next[0].code
    text = said(precheck(folder), "error")
    assert "column q4_deg or q4_rad, q6_deg or q6_rad are missing" in text
    assert "row 5, column 'x_mm': an empty cell or n/a is not a finite number" in text
    assert "row 7, column 'z_mm': an empty cell or n/a is not a finite number (2 such in this column)" in text


@pytest.mark.slow
def test_poor_data_are_doubted(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)

    def still(t: pd.DataFrame) -> pd.DataFrame:
        return t.assign(q6_deg=10.0).rename(columns={"temperature_degC": "temperature"})

    found = precheck(problem_with(tmp_path, still))
    assert "joint 6 does not move" in said(found, "warning")

    (tmp_path / "b").mkdir()
    few = problem_with(tmp_path / "b", lambda t: t.head(9), "[sets]\nidentify = 9\n")
    assert "27 numbers were measured for" in said(precheck(few), "error")

    def repeated(t: pd.DataFrame) -> pd.DataFrame:
        whole = pd.concat([t.head(5)] * 6, ignore_index=True)
        return whole.assign(**{c: whole[c] + rng.normal(0, 0.05, 30) for c in XYZ})

    (tmp_path / "c").mkdir()
    found = precheck(problem_with(tmp_path / "c", repeated, "[sets]\nidentify = 30\n"))
    assert "30 measurements at 5 distinct readings" in said(found, "warning")
    assert found.noise == pytest.approx(5e-5, rel=0.35)
    assert found.noise_source == "as repeated readings show"


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"Weight": 1.0}, "is 'weight' meant?"),
        ({"payload": 10.0}, "is 'payload_kg' meant?"),
        ({"approach9": 1.0}, "column 'approach9' has no effect: this robot has 6 joints"),
        ({"tilt_x_deg": 1.0, "tilt_y_deg": 2.0}, 'the robot file takes it as still: write frame = "logged"'),
    ],
)
def test_a_column_that_this_robot_has_no_use_for_is_named(tmp_path: Path, columns: dict, words: str) -> None:
    assert words in said(precheck(problem_with(tmp_path, lambda t: t.assign(**columns))), "warning")


def test_sessions_of_single_poses_are_not_taken_for_slips(tmp_path: Path) -> None:
    told = said(precheck(problem_with(tmp_path, lambda t: t[:30].assign(session=range(30)))), "error")
    assert "session '0' has 1 poses; where its base and tool are cannot be determined from fewer than 6" in told
    assert "units:" not in told


def test_an_open_four_bar_is_an_error_and_one_nearly_folded_a_warning(tmp_path: Path) -> None:
    table = pd.read_csv(ROOT / "data" / "hh800_twin" / "hh800_twin.csv")
    for k, (q3, level, words) in enumerate(((269.0, "error", "four-bar"), (256.0, "warning", "nearly folded"))):
        made = tmp_path / str(k)
        made.mkdir()
        robot = (ROOT / "problems" / "hh800" / "robot.toml").read_text().replace("[135, 225]", "[135, 269]")
        (made / "robot.toml").write_text(robot)
        changed = table.assign(q3_deg=np.where(table.index == 0, q3, table.q3_deg), q2_deg=90.0)
        changed.to_csv(made / "poses.csv", index=False)
        (made / "problem.toml").write_text(
            'casadical = 1\ntitle = "t"\ndata = "synthetic"\n[[measurements]]\nfile = "poses.csv"\n'
            '[sets]\ncolumn = "set"\n'
        )
        assert words in said(precheck(made), level)


def test_the_command_prints_keeps_and_exits(tmp_path: Path) -> None:
    bad = problem_with(tmp_path, _turned("q3_deg"))
    file = tmp_path / "kept.json"
    done = run("check", "problems/planar", bad, "--details", "--json", file)
    assert (done.returncode, done.stderr) == (2, "")
    assert "planar: ready" in done.stdout
    assert "arm: NOT READY, 1 error" in done.stdout
    good, wrong = json.loads(file.read_text())
    assert (good["ok"], wrong["ok"]) == (True, False)
    assert 0.005 < good["methods"]["KM"]["expected_accuracy_mm"] < 0.05
    assert good["methods"]["KM"]["unidentifiable"].keys() == {"d1", "d2", "theta2"}
    assert wrong["findings"][0]["topic"] == "units"
    done = run("check", "problems/planar", "-q")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_poses_that_determine_nothing_at_a_noise_are_an_error() -> None:
    """Metres of noise on an arm of one metre: no parameter is known better than before."""
    found = precheck(ROOT / "problems" / "planar", noise=2.0)
    assert not found.ok
    assert "with noise of 2e+03 mm per coordinate no parameter is determined" in said(found, "error")
    assert found.outlooks[0].held_out is None


def test_repeated_readings_tell_their_scatter() -> None:
    q = np.repeat([[0.0], [0.5], [1.0]], 2, axis=0)
    off = np.tile([[1e-4, 0.0, 0.0], [-1e-4, 0.0, 0.0]], (3, 1))
    # Six squares of 0.1 mm, over three coordinates of the three readings that are more than one each.
    assert repeats(Measurements(q, "position", position=off)) == (3, pytest.approx(np.sqrt(6e-8 / 9)))


@pytest.mark.parametrize("far", [8, 9])
def test_eight_rows_that_are_far_off_are_named(far: int) -> None:
    problem = read_problem(ROOT / "problems" / "planar")
    sets = [m for name in ("identify", "report") for m in problem.sets[name]]
    q, p = (np.concatenate([getattr(m, name) for m in sets]) for name in ("q", "position"))
    away = np.random.default_rng(1).normal(size=(far, 3))
    p[:far] += 0.03 * away / np.linalg.norm(away, axis=1)[:, None]
    (found,) = far_rows(problem.robot, Measurements(q=q, kind="position", position=p))
    assert found.text.count(" mm)") == 8
    assert (" mm) ... are" in found.text) == (far > 8)


def test_no_accuracy_is_promised_from_too_few_numbers() -> None:
    found = checked("planar")
    (view,) = found.outlooks
    few = replace(view, numbers=view.unknowns, method="few")
    none = replace(view, names=(), errors=np.zeros(0), method="none")
    told = replace(found, outlooks=(view, few, none)).to_json()["methods"]
    assert told["KM"]["expected_accuracy_mm"] == pytest.approx(1e3 * view.accuracy)
    assert told["few"]["expected_accuracy_mm"] is told["none"]["expected_accuracy_mm"] is None


@pytest.mark.parametrize("lags", ["q{}_meas_deg", "q{}_cmd_deg"])
def test_two_sets_of_readings_side_by_side_are_compared_and_the_worse_is_never_taken_in_silence(
    tmp_path: Path, lags: str
) -> None:
    """The measured angles are taken by their heading; the set that lags by 0.1 % of each move explains less."""
    shutil.copytree(ROOT / "problems" / "planar", made := tmp_path / "problems" / "planar")
    table, rng = pd.read_csv(ROOT / "data" / "planar" / "planar.csv"), np.random.default_rng(0)
    for j in (1, 2):
        q = table.pop(f"q{j}_deg")
        table[f"q{j}_meas_deg"] = table[f"q{j}_cmd_deg"] = q
        table[lags.format(j)] = q + 1e-3 * rng.standard_normal(len(q)) * q.diff().fillna(0.0)
    (tmp_path / "data" / "planar").mkdir(parents=True)
    table.to_csv(tmp_path / "data" / "planar" / "planar.csv", index=False)
    found = precheck(made)
    told = [f for f in found.findings if f.topic == "readings"]
    assert [f.level for f in told] == ["warning" if "meas" in lags else "note"]
    assert ('q1_deg = "q1_cmd_deg"' in told[0].text) == ("meas" in lags)
    # The repair takes the better ones, and only then.
    assert ("readings 'q1_cmd_deg' and on are taken" in repaired(found)) == ("meas" in lags)
    assert [f.level for f in precheck(made).findings if f.topic == "readings"] == ["note"]
    m = read_problem(made).table
    assert np.array_equal(m.q[:, 0], np.radians(table["q1_cmd_deg" if "meas" in lags else "q1_meas_deg"]))


def test_limits_that_nobody_gave_are_told_of_both_kinds_of_joints() -> None:
    full = Joint(lower=-2 * np.pi, upper=2 * np.pi)
    rail = Joint(kind="prismatic", lower=-10.0, upper=10.0)
    (finding,) = limits_findings(Robot("arm", (full, rail, replace(full, upper=3.0), rail)))
    assert finding.text.startswith("joints 1, 2, 4: -360 .. 360 deg")
    assert limits_findings(Robot("arm", (replace(rail, lower=0.0), replace(full, lower=-3.0)))) == []

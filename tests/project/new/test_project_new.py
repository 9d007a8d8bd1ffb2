"""A new problem folder runs at once, says what is made up, and takes nothing away from what was there."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import arms
import first_hour
import numpy as np
import pandas as pd
import pytest
from command_line import run

from casadical.cli.new import _ask
from casadical.core.basics import InputError
from casadical.identification.identification import identify
from casadical.project.check.check import precheck
from casadical.project.new import new_problem
from casadical.project.new.dh_table import robot_text
from casadical.project.new.new import as_built
from casadical.project.problem import read_problem
from casadical.project.robot_columns import poses_in_words
from casadical.robot.robot_file import read_robot

ROOT = Path(__file__).parents[3]

# The maker's published table of the UR10 (standard convention).
UR10 = """joint,d_mm,a_mm,alpha_deg,theta_deg,lower_deg,upper_deg,compliant,mass_kg,com_x_mm,com_y_mm,com_z_mm
1,127.3,0,90,0,-360,360,,7.1,21,0,27
2,0,-612,0,0,-360,360,yes,12.7,380,0,158
3,0,-572.3,0,0,-360,360,yes,4.27,240,0,68
4,163.941,0,90,0,-360,360,yes,2.0,0,7,18
5,115.7,0,-90,0,-360,360,yes,2.0,0,7,18
6,92.2,0,0,0,-360,360,,0.365,0,0,-26
"""

URDF = """<robot name="two">
<link name="base"/><link name="upper"/><link name="fore"/><link name="tip"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
<limit lower="-2.5" upper="2.5" effort="1" velocity="1"/></joint>
<joint name="j2" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0.4 0 0" rpy="1.5707963 0 0"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
<joint name="t" type="fixed"><parent link="fore"/><child link="tip"/><origin xyz="0.3 0 0.05"/></joint>
</robot>"""


def test_the_bare_example_runs_by_the_commands_it_names(tmp_path: Path) -> None:
    done = run("new", "arm", folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    readme = (tmp_path / "arm" / "README.md").read_text()
    commands = [line.split() for line in readme.splitlines() if line.startswith("    casadical")]
    assert [c[1] for c in commands] == ["check", "calibrate"]
    for _, *arguments in commands:
        done = run(*arguments, folder=tmp_path)
        assert (done.returncode, done.stderr) == (0, "")
    figures = json.loads((tmp_path / "results" / "result.json").read_text())
    assert figures["data"] == "synthetic"
    held_out = figures["methods"]["SKCM"]["sets"]["report"]
    assert held_out["mean_mm"] < 0.06 < 0.5 < held_out["before_placed"]["mean_mm"]


def test_a_dh_table_gives_the_robot_that_is_in_the_repository(tmp_path: Path) -> None:
    (tmp_path / "dh.csv").write_text(UR10)
    made = new_problem(tmp_path / "ur", dh=tmp_path / "dh.csv", convention="standard").robot
    ours = read_robot(ROOT / "problems" / "ur10" / "robot.toml")
    q = np.random.default_rng(0).uniform(-3, 3, 6)
    for robot in (made, ours):
        assert [j.compliance is None for j in robot.joints] == [True, False, False, False, False, True]
    at_flange = [[0.0 if p.name.startswith("tool_") else p.value for p in r.parameters] for r in (made, ours)]
    flange = [r.pose(q, values) for r, values in zip((made, ours), at_flange, strict=True)]
    assert np.allclose(flange[0][0].full(), flange[1][0].full(), rtol=0, atol=1e-12)
    torques = [r.torque(q, r.parameters.values).full() / abs(r.gravity[2]) for r in (made, ours)]
    # Gravity is taken in the measuring frame there and in the base here: both are upright.
    assert np.allclose(torques[0], torques[1], rtol=0, atol=1e-9)


HEADINGS = {
    "German": "Gelenk;Verdrehung α [°];Gliedlänge a [mm];Versatz d [mm];Winkel θ [°];untere Grenze [°];obere [°]",
    "German, cp1252": "Achse;Verdrehwinkel [Grad];Armlänge [mm];Gliedversatz [mm];Gelenkwinkel [Grad];min [°];max [°]",
    "French": "Axe;torsion (degrés);longueur (mm);décalage (mm);angle (degrés);limite inférieure (°);supérieure (°)",
    "Chinese": "关节;扭转角(度);连杆长度(毫米);连杆偏距(毫米);关节角(度);下限(度);上限(度)",
    "Japanese": "関節;ねじれ角(度);リンク長さ(mm);リンクオフセット(mm);関節角(度);下限(度);上限(度)",
    "no units": "i;link twist;link length;link offset;joint angle;min;max",
    "textbook": "i;alpha_i-1 [deg];a_i-1 [mm];d_i [mm];theta_i [deg];lower limit [deg];upper limit [deg]",
}  # fmt: skip
ENCODINGS = {"German, cp1252": "cp1252", "French": "cp1252", "Chinese": "gb18030", "Japanese": "cp932"}


@pytest.mark.parametrize("language", HEADINGS)
def test_a_dh_table_may_have_headings_of_other_languages(language: str, tmp_path: Path) -> None:
    rows = [line.replace(",", ";").replace(".", ",") for line in first_hour.DH.splitlines()[1:]]
    text = "\n".join([HEADINGS[language], *rows]) + "\n"
    (tmp_path / "dh.csv").write_bytes(text.encode(ENCODINGS.get(language, "utf-8")))
    (tmp_path / "plain.csv").write_text(first_hour.DH)
    made, plain = (tomllib.loads(robot_text(tmp_path / f, "arm", "modified")) for f in ("dh.csv", "plain.csv"))
    assert made["joint"] == plain["joint"]


@pytest.mark.parametrize(
    ("headings", "message"),
    [
        ("a_mm,alpha_deg,d_mm,colour", "column 'colour' is unknown; allowed: joint, a_mm"),
        ("a_mm,Gliedlänge [mm],d_mm,alpha_deg", "column 'Gliedlänge [mm]' is a second column of a_mm"),
        ("a_mm,twist [mm],d_mm,theta_deg", "column 'twist [mm]': unit 'mm' does not fit alpha"),
    ],
)
def test_headings_of_a_dh_table_that_mean_nothing_are_refused(headings: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "dh.csv").write_text(f"{headings}\n1,2,3,4\n5,6,7,8\n")
    with pytest.raises(InputError) as refused:
        robot_text(tmp_path / "dh.csv", "arm", "modified")
    assert message in str(refused.value)


def test_one_length_in_another_unit_does_not_decide_for_all(tmp_path: Path) -> None:
    rows = ["a,alpha,d,theta", "0.35,-1.57,0.675,0", "1.15,0,0,0", "0.041,-1.57,1200,0", "0,1.57,0.215,0"]
    (tmp_path / "dh.csv").write_text("\n".join(rows) + "\n")
    text = robot_text(tmp_path / "dh.csv", "arm", "standard")
    assert "a_m = 1.15" in text
    assert "d_m = 1200.0" in text


def test_measured_data_with_a_dh_table_calibrate_as_the_repositorys_problem_does(tmp_path: Path) -> None:
    """Real UR10 readings, a hundred of them."""
    table = pd.read_csv(ROOT / "data" / "ur10_laser_tracker" / "series_C_random_poses.csv").head(100)
    table.to_csv(tmp_path / "measured.csv", index=False)
    (tmp_path / "dh.csv").write_text(UR10)
    problem = new_problem(
        tmp_path / "ur", dh=tmp_path / "dh.csv", convention="standard", data=tmp_path / "measured.csv"
    )
    assert problem.data is None
    assert problem.origin == "data of unstated origin"
    assert (tmp_path / "ur" / "poses.csv").read_text() == (tmp_path / "measured.csv").read_text()
    assert precheck(tmp_path / "ur").ok
    result = identify(problem.robot, problem.sets["identify"][0], method="KM")
    assert 1e3 * result.accuracy(problem.sets["report"][0])["calibrated"].mean < 0.6


def test_data_that_do_not_read_are_refused_by_their_own_name(tmp_path: Path) -> None:
    table = pd.read_csv(ROOT / "data" / "ur10_laser_tracker" / "series_C_random_poses.csv").head(50)
    table.drop(columns="q3_rad").to_csv(tmp_path / "bad.csv", index=False)
    (tmp_path / "dh.csv").write_text(UR10)
    with pytest.raises(InputError) as refused:
        new_problem(tmp_path / "ur", dh=tmp_path / "dh.csv", data=tmp_path / "bad.csv")
    assert "bad.csv" in str(refused.value)
    assert "poses.csv" not in str(refused.value)
    assert not (tmp_path / "ur").exists()


def test_a_urdf_gives_a_folder_that_calibrates(tmp_path: Path) -> None:
    pytest.importorskip("yourdfpy", reason="the extra urdf is not installed")
    (tmp_path / "two.urdf").write_text(URDF)
    problem = new_problem(tmp_path / "two", urdf=tmp_path / "two.urdf", tip_link="tip")
    assert 'tip_link = "tip"' in (tmp_path / "two" / "problem.toml").read_text()
    result = identify(problem.robot, problem.sets["identify"][0], method="KM")
    assert 1e3 * result.accuracy(problem.sets["report"][0])["calibrated"].mean < 0.06


def test_sets_that_the_data_name_are_kept(tmp_path: Path) -> None:
    new_problem(tmp_path / "one")
    table = pd.read_csv(tmp_path / "one" / "poses.csv")
    table.assign(set=["identify"] * 40 + ["report"] * 20).to_csv(tmp_path / "named.csv", index=False)
    dh = "a_mm,alpha_deg,d_mm,theta_deg\n0,0,400,0\n180,-90,0,0\n600,0,0,-90\n120,-90,620,0\n0,90,0,0\n0,-90,115,0\n"
    (tmp_path / "dh.csv").write_text(dh)
    problem = new_problem(tmp_path / "two", dh=tmp_path / "dh.csv", data=tmp_path / "named.csv")
    assert {name: len(parts[0]) for name, parts in problem.sets.items()} == {"identify": 40, "report": 20}
    assert read_problem(tmp_path / "two").methods == ("KM", "SKCM")


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "poses.csv").write_text("mine")
    with pytest.raises(InputError, match=r"poses\.csv is there already; nothing was written"):
        new_problem(tmp_path / "arm")
    assert [p.name for p in (tmp_path / "arm").iterdir()] == ["poses.csv"]
    assert (tmp_path / "arm" / "poses.csv").read_text() == "mine"


WRONG = {
    "two robots": ({"urdf": "x.urdf", "dh": "x.csv"}, "both say which robot"),
    "no such convention": ({"dh": "dh.csv", "convention": "craig"}, "allowed: modified, standard"),
    "no number": ({"dh": "word.csv"}, "row 3, column 'a_mm': 'x' is not a number"),
    "not available": ({"dh": "na.csv"}, "row 3, column 'alpha_deg': 'NA' is not a finite number"),
    "half a range": ({"dh": "half.csv"}, "belong together"),
}


@pytest.mark.parametrize("name", WRONG)
def test_bad_input_is_refused_and_nothing_is_written(name: str, tmp_path: Path) -> None:
    given, words = WRONG[name]
    (tmp_path / "dh.csv").write_text("a_mm,alpha_deg\n100,90\n200,0\n")
    (tmp_path / "word.csv").write_text("a_mm,alpha_deg\n100,90\nx,0\n")
    (tmp_path / "na.csv").write_text("a_mm,alpha_deg\n100,90\n0,NA\n")
    (tmp_path / "half.csv").write_text("a_mm,lower_deg\n100,90\n")
    paths = {k: tmp_path / v if k != "convention" else v for k, v in given.items()}
    with pytest.raises(InputError, match=words):
        new_problem(tmp_path / "new", **paths)
    assert not (tmp_path / "new").exists()


def test_a_question_lists_its_choices_by_number(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    answers = iter([3, 2])
    monkeypatch.setattr("casadical.cli.new.prompt", lambda *_, **__: next(answers))
    assert _ask(SimpleNamespace(text="Which?", choices={"first": [], "second": []})) == "second"
    assert capsys.readouterr().err == "  1: first\n  2: second\n"


def test_a_simulated_robot_departs_from_nominal_to_either_side() -> None:
    arm, rng, sigma = arms.six_axis(), np.random.default_rng(0), {"m": 3e-4, "rad": 5e-4}
    chosen = [p for p in arm.parameters if p.group == "geometry"]
    built = [as_built(arm, rng) for _ in range(40)]
    off = [[(r.parameters[p.name].value - p.value) / sigma[p.unit] for p in chosen] for r in built]
    assert np.abs(np.mean(off)) < 0.1
    assert np.std(off) == pytest.approx(1.0, abs=0.1)


def test_it_is_told_where_a_camera_is_and_which_way_poses_go() -> None:
    m = arms.poses(arms.six_axis(), arms.readings(arms.six_axis(), 4, 0), 1)
    assert poses_in_words(replace(m, kind="position", orientation=None)) == ""
    assert poses_in_words(replace(m, camera="to base")).startswith("Poses as they are: the camera stands still")
    assert poses_in_words(replace(m, inverted=True)).startswith("Each pose is inverted")

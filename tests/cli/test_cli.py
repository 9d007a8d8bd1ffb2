"""The command as a user meets it: what it prints, keeps, refuses, and its exit codes."""

import json
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from command_line import main, own_planar, run

import casadical
from casadical.measurements.kinds.position import Position

ROOT = Path(__file__).parents[2]
PLANAR = ROOT / "problems" / "planar"


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One run over two problems with everything kept."""
    folder = tmp_path_factory.mktemp("kept")
    done = run(
        "calibrate", "problems/planar", "problems/panda_3", "--details", "--out", folder / "out",
        "--json", folder / "all.json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return folder


def test_report_is_the_golden_text() -> None:
    done = run("calibrate", "problems/planar", "--details")
    assert (done.returncode, done.stderr) == (0, "")
    printed = "".join(line.rstrip() + "\n" for line in done.stdout.splitlines())
    assert printed == (Path(__file__).parent / "planar.txt").read_text()


def test_every_command_answers_in_25_lines_of_80_columns_and_has_details(tmp_path: Path) -> None:
    own_planar(tmp_path / "arm")
    arm, table, out = "arm", "arm/poses.csv", "out"  # short paths: a long one takes lines of its own
    commands = [
        ("calibrate", arm, "--out", out),
        ("check", arm),
        ("plan", arm, "-n", 12, "--out", "p.csv"),
        ("verify", out, table),
        ("compare", out, table),
        ("certificate", out, "--problem", arm),
        ("export", "model", out, "--out", "arm.xml"),
        ("correct", out, table, "--nominal", arm, "--out", "c.csv"),
    ]
    for command in commands:
        done = run(*command, folder=tmp_path)
        assert (done.returncode, done.stderr) == (0, "")
        lines = done.stdout.splitlines()
        assert len(lines) <= 25, done.stdout
        assert all(len(line) <= 80 for line in lines)
    (tmp_path / "p.csv").unlink()
    whole = run(*commands[2], "--details", folder=tmp_path).stdout
    assert "Expected standard errors" in whole
    assert "all figures and sentences: --details" not in whole


def test_json_has_every_figure(kept: Path) -> None:
    found = json.loads((kept / "all.json").read_text())
    assert list(found) == ["planar", "panda_3"]
    planar = found["planar"]
    assert (planar["data"], planar["methods"].keys()) == ("synthetic", {"KM"})
    method = planar["methods"]["KM"]
    assert method["sets"].keys() == {"identify", "report"}
    for figures in method["sets"].values():
        for name in ("mean_mm", "max_mm", "std_mm", "rms_mm", "p95_mm"):
            assert 0 < figures[name] < 0.1 < figures["before_placed"][name]
    assert (method["sets"]["identify"]["n"], method["sets"]["report"]["n"]) == (25, 15)
    for parameter in method["parameters"]:
        assert {"name", "value", "std_error", "unit", "status"} <= parameter.keys()
        assert (parameter["std_error"] is None) == (parameter["status"] != "identified")
        assert bool(parameter["reason"]) == (parameter["status"] != "identified")
    assert method["optimal"] is True


def test_out_holds_for_each_problem_robot_parameters_and_figures(kept: Path) -> None:
    whole = json.loads((kept / "all.json").read_text())
    for name in ("planar", "panda_3"):
        folder = kept / "out" / name
        assert sorted(p.name for p in folder.iterdir()) == ["KM.parameters.csv", "KM.robot.toml", "result.json"]
        assert json.loads((folder / "result.json").read_text()) == whole[name]
        table = pd.read_csv(folder / "KM.parameters.csv")
        listed = whole[name]["methods"]["KM"]["parameters"]
        assert list(table["name"]) == [p["name"] for p in listed]
        assert table["value"].to_numpy() == pytest.approx([p["value"] for p in listed], rel=1e-12)


def test_method_and_seed_choose(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures = []
    for seed in (0, 0, 5):
        file = tmp_path / "one.json"
        assert (
            main(monkeypatch, "calibrate", PLANAR, "--seed", seed, "--method", "SKCM", "--quiet", "--json", file) == 0
        )
        found = json.loads(file.read_text())["methods"]
        assert found.keys() == {"SKCM"}
        figures.append(found["SKCM"]["sets"]["report"]["mean_mm"])
    assert figures[0] == figures[1] != figures[2]


def test_a_place_that_cannot_be_written_is_a_users_mistake_and_nothing_is_kept(tmp_path, monkeypatch, capfd):
    (tmp_path / "file").write_text("mine")
    for place in (["--out", tmp_path / "file"], ["--out", tmp_path / "new", "--json", tmp_path / "file" / "x.json"]):
        assert main(monkeypatch, "calibrate", PLANAR, "--quiet", *place) == 2
        assert "cannot be written" in capfd.readouterr().err
        assert [p for p in tmp_path.rglob("*") if p.is_file()] == [tmp_path / "file"]
    assert (tmp_path / "file").read_text() == "mine"


def test_a_mistake_in_the_second_problem_keeps_nothing_of_the_first(tmp_path: Path) -> None:
    bad = tmp_path / "bad"
    bad.mkdir()
    (bad / "problem.toml").write_text("casadical = 1\n")
    done = run("calibrate", PLANAR, bad, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert "title: is missing" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


# A law that jumps wherever the tool moves by 30 um, so that no slope says where the optimum is.
JUMPS = """
[[effect]]
name = "law"
joint = 2
settings = {seam = "joint", formula = "a * sign(sin(1e5 * px))", factors = [["a", 1e-4]]}
values.a = {value = 1e-2, unit = "rad"}
"""


@pytest.mark.slow
def test_no_optimum_ends_in_3_and_keeps_nothing(tmp_path, monkeypatch, capfd):
    robot = own_planar(tmp_path / "arm") / "robot.toml"
    robot.write_text(robot.read_text().replace("casadical = 1", "casadical = 2") + JUMPS)
    assert main(monkeypatch, "calibrate", tmp_path / "arm", "--out", tmp_path / "out") == 3
    message = capfd.readouterr().err
    assert "no optimum found, nothing was written" in message
    assert "Maximum_Iterations_Exceeded" in message
    assert "check units" in message
    assert "Traceback" not in message
    assert not (tmp_path / "out").exists()


def test_a_bug_ends_in_70_with_its_traceback(monkeypatch, capfd, tmp_path):
    monkeypatch.setattr(Position, "numbers", property(lambda _: 1 / 0))
    assert main(monkeypatch, "calibrate", PLANAR) == 70
    message = capfd.readouterr().err
    assert "ZeroDivisionError: division by zero" in message
    assert "bug in casadical" in message


def test_help_and_version() -> None:
    words = " ".join(run("calibrate", "--help").stdout.split())
    for part in ("--out", "--json", "--method", "--seed", "--loss", "--quiet", "held out", "Exit codes: 0 done, 2 bad"):
        assert part in words
    assert run().stderr.split() == run("--help").stdout.split()
    done = subprocess.run([sys.executable, "-m", "casadical", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"casadical {casadical.__version__}\n"

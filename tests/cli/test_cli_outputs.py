"""Outputs are checked before the work: no input, no foreign file and no other output is ever replaced."""

import contextvars
import json
import shutil
from pathlib import Path

import pytest
from command_line import main, own_planar, run

from casadical import InputError
from casadical.cli.options import robot_of
from casadical.cli.outputs import _refuse_foreign
from casadical.core.files import claimed, json_text
from casadical.diagnosis.motion.result import LogDiagnosis

ROOT = Path(__file__).parents[2]


@pytest.fixture
def problem(tmp_path: Path) -> Path:
    return own_planar(tmp_path / "p")


@pytest.mark.parametrize("name", ["robot.toml", "problem.toml", "campaigns/2026-03-01.csv"])
@pytest.mark.parametrize("given", [".", ".."])
def test_no_file_of_a_fleet_is_replaced(monkeypatch, capsys, problem: Path, name: str, given: str) -> None:
    (problem / "campaigns").mkdir()
    shutil.copy(problem / "poses.csv", problem / "campaigns" / "2026-03-01.csv")
    before = (problem / name).read_bytes()
    for option in ("--json", "--report"):
        store = problem.parent / "fleet.parquet"
        assert main(monkeypatch, "fleet", problem / given, "--store", store, option, problem / name) == 2
        assert "is an input of this command and is not replaced" in capsys.readouterr().err
    assert (problem / name).read_bytes() == before


@pytest.mark.parametrize("name", ["robot.toml", "poses.csv", "problem.toml", "link"])
def test_an_input_is_not_replaced(monkeypatch, capsys, problem: Path, name: str) -> None:
    (problem / "link").symlink_to("poses.csv")
    before = {p.name: p.read_bytes() for p in problem.iterdir()}
    assert main(monkeypatch, "calibrate", problem, "--json", problem / name) == 2
    assert "is an input of this command and is not replaced" in capsys.readouterr().err
    assert {p.name: p.read_bytes() for p in problem.iterdir()} == before


@pytest.mark.parametrize(
    ("first", "second"),
    [(("--json", "a"), ("--report", "a")), (("--json", "o"), ("--out", "o")), (("--json", "l"), ("--report", "a"))],
)
def test_two_outputs_of_one_name_are_refused(monkeypatch, capsys, tmp_path, problem, first, second) -> None:
    (tmp_path / "l").symlink_to("a")
    pairs = [(option, tmp_path / name) for option, name in (first, second)]
    assert main(monkeypatch, "calibrate", problem, *pairs[0], *pairs[1]) == 2
    assert "two outputs have this name" in capsys.readouterr().err


def test_a_name_of_the_set_in_its_folder_is_refused(monkeypatch, capsys, tmp_path, problem) -> None:
    assert main(monkeypatch, "calibrate", problem, "--out", tmp_path / "o", "--json", tmp_path / "o/result.json") == 2
    assert "among those of --out" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()
    (tmp_path / "o").mkdir()
    (tmp_path / "o" / "notes.txt").write_text("mine")
    given = ("calibrate", problem, "--out", tmp_path / "o", "--json", tmp_path / "o" / "all.json", "-q")
    assert main(monkeypatch, *given) == 0
    assert (tmp_path / "o" / "notes.txt").read_text() == "mine"


def test_a_foreign_file_is_not_replaced_and_an_earlier_output_is(monkeypatch, capsys, tmp_path, problem) -> None:
    kept = tmp_path / "kept.json"
    for text in ("shopping list", '{"name": "another program", "files": []}'):
        kept.write_text(text)
        assert main(monkeypatch, "calibrate", problem, "--json", kept) == 2
        assert "was not written by casadical" in capsys.readouterr().err
        assert kept.read_text() == text
    kept.unlink()
    for _ in range(2):
        assert main(monkeypatch, "calibrate", problem, "-q", "--json", kept) == 0
    assert json.loads(kept.read_text())["problem"] == "p"
    assert main(monkeypatch, "check", problem, "-q", "--json", kept) == 0


def test_a_plan_that_was_measured_is_not_replaced(monkeypatch, capsys, tmp_path, problem) -> None:
    shutil.copy(problem / "poses.csv", tmp_path / "plan.csv")
    assert main(monkeypatch, "plan", problem, "-n", 6, "--out", tmp_path / "plan.csv") == 2
    assert "move this one away" in capsys.readouterr().err
    (tmp_path / "plan.csv").write_text("q1_deg,q2_deg,x_mm,y_mm,z_mm\n1,2,,,\n")  # nobody measured it
    assert main(monkeypatch, "plan", problem, "-n", 6, "--out", tmp_path / "plan.csv") == 0


def test_the_second_writer_of_a_folder_is_told_before_it_works(monkeypatch, capsys, tmp_path, problem) -> None:
    with claimed([tmp_path / "o"]):  # in another context, as another process has one of its own
        code = contextvars.Context().run(main, monkeypatch, "calibrate", problem, "--out", tmp_path / "o")
    assert code == 2
    assert "another casadical is writing to this folder" in capsys.readouterr().err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_folder_is_not_left_where_the_json_beside_it_is_not_written(monkeypatch, capsys, tmp_path) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(monkeypatch, "new", "n", "--json", "/dev/full") == 2
    assert (
        capsys.readouterr().err
        == "casadical: /dev/full: cannot be written: No space left on device; nothing was written\n"
    )
    assert list(tmp_path.iterdir()) == []
    assert main(monkeypatch, "new", "n", "--json", "n.json") == 0
    kept = json.loads(Path("n.json").read_text())
    assert kept["files"] == [str(path) for path in sorted(Path("n").iterdir())]
    assert kept["problem"] == "n"


def test_json_goes_into_the_file_that_a_shell_opened_for_the_standard_output() -> None:
    """Behind what is printed there; its standard output is a file, as with > or >>."""
    done = run("check", "problems/planar", "--json", "/dev/stdout")
    assert done.returncode == 0, done.stderr
    before, _, after = done.stdout.partition("\n{\n")
    assert before
    assert json.JSONDecoder().raw_decode("{" + after)[0]["ok"] is True


@pytest.mark.parametrize(("name", "refused"), [("KM.robot.toml", True), ("result.json", True), ("prior.toml", False)])
def test_inputs_in_the_folder_of_the_outputs_are_safe_by_their_name(name, refused, monkeypatch, capsys, tmp_path):
    (tmp_path / name).write_text("casadical = 1\n")
    given = ("calibrate", ROOT / "problems" / "planar", "--prior", tmp_path / name, "--out", tmp_path)
    assert main(monkeypatch, *given) == 2
    assert ("is an input, and --out may replace it" in capsys.readouterr().err) == refused


def test_the_diagnosis_of_logs_is_written_over_its_own_file(tmp_path: Path) -> None:
    text = json_text(dict.fromkeys([key.name for key in LogDiagnosis.derived], "x"))
    (tmp_path / "a.json").write_text(text)
    _refuse_foreign(tmp_path / "a.json")
    (tmp_path / "b.json").write_text('{"log": "mine", "verdict": "mine"}')
    with pytest.raises(InputError, match="was not written by casadical"):
        _refuse_foreign(tmp_path / "b.json")


def test_a_problem_folder_is_none_of_results(tmp_path: Path) -> None:
    for name in ("problem.toml", "result.json"):
        (tmp_path / name).touch()
    assert robot_of(tmp_path) == tmp_path

"""Outputs are checked before the work: no input, no foreign file and no other output is ever replaced."""

import contextvars
import json
import shutil
from pathlib import Path

import pytest
from command_line import main, own_planar, run

from casadical.core.files import claimed

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


def test_the_second_writer_of_a_folder_is_told_before_it_works(monkeypatch, capsys, tmp_path, problem) -> None:
    with claimed([tmp_path / "o"]):  # in another context, as another process has one of its own
        code = contextvars.Context().run(main, monkeypatch, "calibrate", problem, "--out", tmp_path / "o")
    assert code == 2
    assert "another casadical is writing to this folder" in capsys.readouterr().err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("command", [("new", "n", "--dh"), ("plan", "p", "-n", "6", "--measured")])
def test_a_device_is_no_input(monkeypatch, capsys, tmp_path, problem, command) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(monkeypatch, *command, "/dev/full") == 2
    assert "/dev/full: is a device; name a file" in capsys.readouterr().err


def test_an_empty_path_is_not_the_folder_that_one_is_in(problem: Path) -> None:
    for command in (["new", ""], ["check", ""], ["check", "p", "--json", ""]):
        done = run(*command, folder=problem.parent)
        assert done.returncode == 2
        assert "a path is empty" in done.stderr
    assert [path.name for path in problem.parent.iterdir()] == ["p"]
    done = run("plan", "p", "-n", "6", "--for", "", folder=problem.parent)
    assert "is empty; give a value, or leave it out" in done.stderr


def test_a_fleet_of_none_leaves_no_store(tmp_path: Path) -> None:
    done = run("fleet", "nothing", "--store", "s.parquet", folder=tmp_path)
    assert "nothing: neither a problem folder nor a folder of such" in done.stderr
    shutil.copytree(ROOT / "problems" / "planar", tmp_path / "p")
    again = run("fleet", "p", "--store", "s.parquet", "--scheduler", "nonsense", folder=tmp_path)
    assert (done.returncode, again.returncode) == (2, 2)
    assert "s.parquet" not in done.stderr + again.stderr
    assert not (tmp_path / "s.parquet").exists()


def test_what_two_options_say_is_asked_for(tmp_path: Path) -> None:
    done = run("new", "arm", "--urdf", "a.urdf", "--dh", "b.csv", folder=tmp_path)
    assert "--dh: not together with --urdf; leave one of the two out" in done.stderr
    done = run("new", "a\x1bb", folder=tmp_path)
    assert "its name holds the control character" in done.stderr
    assert not [*tmp_path.iterdir()]


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


def test_a_folder_of_results_stands_for_its_robot_file(problem: Path) -> None:
    """Wherever a robot file may be given."""
    folder = problem.parent
    assert run("calibrate", "p", "--out", "results", folder=folder).returncode == 0
    for command in (
        ["export", "model", "results", "--out", "arm.urdf"],
        ["check", "results", "p/poses.csv"],
        ["diagnose", "results", "p/poses.csv", "--no-laws"],
        ["export", "c", "results", "--nominal", "p/robot.toml", "--out", "c", "--what", "command"],
    ):
        done = run(*command, folder=folder)
        assert done.returncode in (0, 2), done.stderr
        assert "problem.toml" not in done.stderr, command
        assert "Traceback" not in done.stderr
    assert (folder / "arm.urdf").is_file()
    for kept in (folder / "results" / "result.json", *(folder / "results").glob("*.robot.toml")):
        done = run("certificate", "results", "--out", kept, folder=folder)
        assert "is an input of this command and is not replaced" in done.stderr
    (folder / "targets.csv").write_text("q1_deg,q2_deg\n10,20\n")
    done = run("correct", "results", "targets.csv", "--nominal", "p/robot.toml", "--out", "t.csv", folder=folder)
    assert "manifest" not in done.stderr

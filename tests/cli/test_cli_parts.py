"""Parts of commands that end before the work begins, or say how far it is."""

import inspect
from pathlib import Path

import pytest
from command_line import main

from casadical.cli.outputs import _check
from casadical.cli.progress import DIAGNOSIS, share
from casadical.cli.root import MOVED
from casadical.core.errors import InputError
from casadical.export.mjcf.replay import replay_campaign

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("text", "done"),
    [
        ("laws beside nothing", 0.72),
        ("laws beside what was found", 0.8),
        ("laws beside what was found: 3 of 4", 0.8 + 0.05 * 2 / 4),
        ("the robot with laws", 0.96),
        ("unknown words", 0.0),
        ("1 of 4 campaigns", 0.25),
    ],
)
def test_the_bar_of_a_diagnosis_stands_where_the_step_begins(text: str, done: float) -> None:
    assert share(text, DIAGNOSIS) == pytest.approx(done)


def test_check_says_by_its_exit_code_whether_all_is_right(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    planar = ROOT / "problems" / "planar"
    assert main(monkeypatch, "check", planar, "--quiet") == 0
    (tmp_path / "problem.toml").write_text("casadical = 1\n")
    assert main(monkeypatch, "check", planar, tmp_path, "--quiet") == 2


def test_inputs_in_the_folder_of_the_outputs_are_safe_by_their_name(tmp_path: Path) -> None:
    mine, taken, apart = tmp_path / "mine.csv", tmp_path / "result.json", tmp_path / "other" / "result.json"
    apart.parent.mkdir()
    for path in (mine, apart):
        path.write_text("1")
    _check([], [tmp_path], [mine, apart], overwrite=True)
    taken.write_text("1")
    _check([], [tmp_path / "out"], [mine, taken, apart], overwrite=True)
    with pytest.raises(InputError, match=r"is an input, and --out may replace it"):
        _check([], [tmp_path], [taken], overwrite=True)


def test_a_driver_file_replaces_nothing_unless_told(monkeypatch, capsys, tmp_path):
    robot, out = ROOT / "problems" / "kr210" / "robot.toml", tmp_path / "dh.csv"
    out.write_text("mine")
    arguments = ("export", "model", robot, "--nominal", robot, "--to", "standard_dh", "--out", out)
    assert main(monkeypatch, *arguments) == 2
    assert "dh.csv" in capsys.readouterr().err
    assert out.read_text() == "mine"


@pytest.mark.parametrize("old", list(MOVED))
def test_an_earlier_name_of_a_command_tells_the_new_one(monkeypatch, capsys, old):
    assert main(monkeypatch, *old.split(), "problems/planar") == 2
    assert capsys.readouterr().err == f"casadical: {old} is now: casadical {MOVED[old]}\n"


def test_the_split_of_a_replay_has_seed_zero() -> None:
    assert inspect.signature(replay_campaign).parameters["seed"].default == 0


def test_a_command_is_what_is_written_by_default(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Stopped where it would be compiled."""
    made: list[object] = []

    def stop(product: object, *_: object, **__: object) -> None:
        made.append(product)
        raise InputError("far enough")

    monkeypatch.setattr("casadical.export.controller.c_export.write_c", stop)
    robot = ROOT / "problems" / "kr210" / "robot.toml"
    assert main(monkeypatch, "export", "c", robot, "--nominal", robot, "--out", tmp_path / "c") == 2
    assert [type(product).__name__ for product in made] == ["Command"]


def test_a_check_that_finds_nothing_to_repair_says_no_more_than_without(monkeypatch, capsys):
    told = []
    for options in ((), ("--repair",)):
        assert main(monkeypatch, "check", ROOT / "problems" / "planar", *options) == 0
        told.append(capsys.readouterr().out)
    assert told[0]
    assert told[0] == told[1]

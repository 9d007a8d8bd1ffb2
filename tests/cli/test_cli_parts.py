"""Parts of commands that end before the work begins, or say how far it is."""

from pathlib import Path

import pytest
from command_line import main

from casadical.cli.terminal import DIAGNOSIS, refusal, share, wrapped
from casadical.core.telling.blocks import Table, Words
from casadical.core.telling.result import plain_text

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("text", "done"),
    [
        ("laws beside nothing", 0.72),
        ("laws beside what was found", 0.8),
        ("laws beside what was found: 3 of 4", 0.8 + 0.05 * 2 / 4),
        ("the robot with laws", 0.96),
        ("the robot with laws: 2 of 2", 0.98),
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


@pytest.mark.parametrize(("name", "refused"), [("KM.robot.toml", True), ("result.json", True), ("prior.toml", False)])
def test_inputs_in_the_folder_of_the_outputs_are_safe_by_their_name(name, refused, monkeypatch, capsys, tmp_path):
    (tmp_path / name).write_text("casadical = 1\n")
    given = ("calibrate", ROOT / "problems" / "planar", "--prior", tmp_path / name, "--out", tmp_path)
    assert main(monkeypatch, *given) == 2
    assert ("is an input, and --out may replace it" in capsys.readouterr().err) == refused


def test_a_driver_file_replaces_nothing_unless_told(monkeypatch, capsys, tmp_path):
    robot, out = ROOT / "problems" / "kr210" / "robot.toml", tmp_path / "dh.csv"
    out.write_text("mine")
    arguments = ("export", "model", robot, "--nominal", robot, "--to", "standard_dh", "--out", out)
    assert main(monkeypatch, *arguments) == 2
    assert "dh.csv" in capsys.readouterr().err
    assert out.read_text() == "mine"


def test_a_check_that_finds_nothing_to_repair_says_no_more_than_without(monkeypatch, capsys):
    told = []
    for options in ((), ("--repair",)):
        assert main(monkeypatch, "check", ROOT / "problems" / "planar", *options) == 0
        told.append(capsys.readouterr().out)
    assert told[0]
    assert told[0] == told[1]


def test_brackets_in_names_are_printed(capsys):
    wrapped(False, 80).print("arm [red] of cell [bold]2")
    assert capsys.readouterr().out == "arm [red] of cell [bold]2\n"


def test_control_characters_of_what_was_read_reach_no_terminal(capsys):
    refusal("topic \x1b[31mred\x9b, line\nnext")
    assert capsys.readouterr().err == "casadical: topic \\x1b[31mred\\x9b, line\nnext\n"
    blocks = [Words("\x1b[31mred", "warning"), Table("t", ["\x1bcolumn"], [["\x1bcell"]])]
    assert "\x1b" not in plain_text(blocks)

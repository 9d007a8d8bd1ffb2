"""All commands behave alike: the same flags in the same words, completion that works, progress only on a terminal."""

import os
import pty
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import click
import pytest
import typer
from command_line import ROOT

from casadical.cli import app, terminal
from casadical.cli import options as o
from casadical.cli.terminal import CHECK, DIAGNOSIS, PLAN, share

BIN = Path(sys.executable).parent


def commands() -> Iterator[tuple[str, click.Command]]:
    """Every command that does something, by its words."""

    def walk(words: str, command: click.Command) -> Iterator[tuple[str, click.Command]]:
        inner = getattr(command, "commands", None)
        if inner is None:
            yield words, command
        for name, sub in (inner or {}).items():
            yield from walk(f"{words} {name}".strip(), sub)

    yield from walk("", typer.main.get_command(app))


ALL = dict(commands())


def options(command: click.Command) -> dict[str, click.Parameter]:
    return {name: p for p in command.params for name in p.opts if name.startswith("--")}


@pytest.mark.parametrize("name", ALL)
def test_every_command_can_be_quiet_and_keep_json_and_tells_all_about_itself(name: str) -> None:
    command = ALL[name]
    found = options(command)
    assert {"--quiet", "--json"} <= found.keys()
    assert "-q" in found["--quiet"].opts
    assert "Exit codes:" in (command.help or "")
    example = next(line.strip() for line in (command.help or "").splitlines() if line.strip().startswith("Example: "))
    own, words = name.removesuffix(" robot"), example.removeprefix("Example: casadical ")  # a group has a default
    assert words.startswith(f"{own} ")
    command.make_context(name, words.removeprefix(own).split(), resilient_parsing=False)
    for option, parameter in found.items():
        assert getattr(parameter, "help", None), f"{name} {option} has no help"


def test_options_defaults_and_limits_are_those_that_were_promised() -> None:
    """A line for each option: its names, whether it is needed or may be repeated, its default and limits.

    What changes here is named in the changelog, with old and new.
    """
    lines = []
    for name, command in ALL.items():
        for p in command.params:
            facts = [fact for fact in ("required", "multiple", "is_eager") if getattr(p, fact)]
            facts += [f"{k}={v}" for k in ("default", "min", "max") if (v := getattr(p, k)) is not None]
            facts += [f"nargs={p.nargs}"] * (p.nargs != 1)
            lines.append(" ".join([name, "/".join([*p.opts, *p.secondary_opts]), *facts]))
    assert lines == Path(__file__).with_name("contract.txt").read_text(encoding="utf-8").splitlines()


def test_an_option_means_the_same_everywhere() -> None:
    words: dict[str, set[str]] = {}
    for command in ALL.values():
        for option, parameter in options(command).items():
            if option in ("--quiet", "--json", "--nominal", "--compensator", "--payload"):
                words.setdefault(option, set()).add(f"{parameter.metavar}: {parameter.help}")
    assert {option for option, texts in words.items() if len(texts) > 1} == set()


@pytest.mark.parametrize(
    ("complete", "begun", "offered"),
    [
        (o.methods, "IWO", ["IWO-NN-SKCM", "IWO-LM-NN-SKCM"]),
        (o.losses, "h", ["huber"]),
        (o.effects, "backlash,gear_e", ["backlash,gear_eccentricity"]),
        (o.languages, "c,str", ["c,structured_text"]),
    ],
)
def test_words_are_completed(complete: Callable[[str], list[str]], begun: str, offered: list[str]) -> None:
    assert complete(begun) == offered


@pytest.mark.slow
def test_a_reader_that_goes_away_loses_no_file(tmp_path: Path) -> None:
    """As `| head -1` does."""
    command = [BIN / "casadical", "calibrate", "problems/planar", "--details", "--out", tmp_path / "out"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout
        assert process.stderr
        process.stdout.close()
        said = process.stderr.read()
    assert (process.returncode, said) == (0, b"")
    assert (tmp_path / "out" / "result.json").exists()


@pytest.mark.parametrize(
    ("text", "done"),
    [
        ("laws given what was found", 0.8),
        ("laws given what was found: 3 of 4", 0.8 + 0.05 * 2 / 4),
        ("the robot with laws: 2 of 2", 0.98),
        ("unknown words", 0.0),
        ("1 of 4 campaigns", 0.25),
    ],
)
def test_the_bar_of_a_diagnosis_stands_where_the_step_begins(text: str, done: float) -> None:
    assert share(text, DIAGNOSIS) == pytest.approx(done)


@pytest.mark.parametrize("steps", [DIAGNOSIS, CHECK, PLAN])
def test_a_step_begins_within_the_work(steps: terminal.Steps) -> None:
    assert all(0 <= begun < 1 for begun in steps.values())


def test_the_bar_on_a_real_terminal_shows_step_and_share_and_is_wiped() -> None:
    seen, terminal_side = pty.openpty()
    environment = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "CI")} | {"TERM": "xterm"}
    command = [BIN / "casadical", "diagnose", "problems/planar"]
    with subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=terminal_side) as process:
        os.close(terminal_side)
        shown = b""
        with suppress(OSError):  # the other end is closed
            while part := os.read(seen, 4096):
                shown += part
        assert process.stdout
        assert b"signatures of the candidates" not in process.stdout.read()
    os.close(seen)
    assert re.search(r"\d%.*planar: signatures of the candidates", shown.decode())
    assert shown.endswith(b"\x1b[2K")  # the last line is erased

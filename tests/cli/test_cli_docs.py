"""The examples of docs/cli.md, to the letter: each command is run, and what the page shows is what it prints."""

import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import run

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "cli.md"


def examples() -> list[tuple[str, list[str]]]:
    """Commands, and the lines that the page shows below each."""
    found: list[tuple[str, list[str]]] = []
    inside = False
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("```"):
            inside = line == "```console"
        elif inside and line.startswith("$ "):
            found.append((line[2:], []))
        elif inside:
            found[-1][1].append(line)
    return found


def shown_in_order(wanted: list[str], printed: list[str]) -> str | None:
    """The first wanted line that is missing; between `...` and the next one any lines may lie."""
    at, anywhere = 0, False
    for line in wanted:
        if line == "...":
            anywhere = True
            continue
        places = [k for k in range(at, len(printed)) if printed[k].split() == line.split()]
        if not places or (places[0] != at and not anywhere):
            return line
        at, anywhere = places[0] + 1, False
    return None if anywhere or at == len(printed) else f"the page ends before: {printed[at]}"


def test_the_help_of_every_command_has_an_example_that_parses() -> None:
    import typer

    from casadical.cli import app

    found = dict(commands(typer.main.get_command(app), "casadical"))
    assert len(found) >= 12
    for name, command in found.items():
        example = next(line for line in command.help.splitlines() if line.strip().startswith("Example: "))
        assert example.strip().removeprefix("Example: ").startswith(f"{name} ")
        arguments = example.split(name, 1)[1].split()
        command.make_context(name, arguments, resilient_parsing=False)


def commands(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Every command by its whole name; that of a group's default is the group's."""
    if hasattr(command, "commands"):
        for word, below in command.commands.items():
            yield from commands(below, name if word == "robot" else f"{name} {word}")
    else:
        yield name, command


@pytest.mark.slow
def test_the_examples_print_what_the_page_shows(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed (extra mujoco)")
    for name in ("problems", "data"):
        (tmp_path / name).symlink_to(ROOT / name)
    for command, wanted in examples():
        first, *words = shlex.split(command)
        if first == "cp":
            shutil.copy(*(tmp_path / word for word in words))
            continue
        assert first == "casadical"
        done = run(*words, folder=tmp_path)
        assert (done.returncode, done.stderr) == (0, ""), command
        printed = [line for line in done.stdout.splitlines() if line.strip()]
        assert shown_in_order(wanted, printed) is None, f"{command}\n{done.stdout}"

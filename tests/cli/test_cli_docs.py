"""The examples of docs/cli.md, to the letter: each command is run, and what the page shows is what it prints."""

import shlex
import shutil
from pathlib import Path

import pytest
from command_line import run
from walk import blocks

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "cli.md"


def examples() -> list[tuple[str, list[str]]]:
    """Commands, and the lines that the page shows below each."""
    found: list[tuple[str, list[str]]] = []
    for line in "".join(block.text for block in blocks(PAGE) if block.language == "console").splitlines():
        if line.startswith("$ "):
            found.append((line[2:], []))
        else:
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

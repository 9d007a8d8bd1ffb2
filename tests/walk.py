"""A Markdown page as a newcomer walks it: its files written, then its commands and its Python run, in their order."""

import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import command_line

ROOT = Path(__file__).parents[1]
BIN = Path(sys.executable).parent
# <!-- file: cell.toml --> above a block says under which name the page's commands expect it.
_BLOCK = re.compile(r"(?:<!-- file: (?P<name>\S+) -->\n)?^```(?P<language>[\w{}-]*)\n(?P<text>.*?)^```$", re.M | re.S)
_INDENTED = re.compile(r"(?<=\n\n) {4}(casadical .*)\n(?=\n)")


@dataclass(frozen=True)
class Block:
    """One block of code; name : of the file that it is, where it is one."""

    language: str
    text: str
    name: str = ""


def blocks(page: Path) -> list[Block]:
    """The fenced blocks of a page, and its indented commands, from top to bottom."""
    text = page.read_text(encoding="utf-8")
    found = [(m.start(), Block(m["language"], m["text"], m["name"] or "")) for m in _BLOCK.finditer(text)]
    found += [(m.start(), Block("synopsis" if "[--" in m[1] else "sh", m[1] + "\n")) for m in _INDENTED.finditer(text)]
    return [block for _, block in sorted(found, key=lambda pair: pair[0])]


def walk(page: Path, folder: Path) -> list[tuple[Block, subprocess.CompletedProcess[str]]]:
    """Run a page in a folder that looks like the repository's root; stops at what fails."""
    for name in ("problems", "data"):
        (folder / name).symlink_to(ROOT / name)
    steps = blocks(page)
    for block in steps:
        if block.name:
            (folder / block.name).write_text(block.text, encoding="utf-8")
    done = []
    for block in steps:
        if block.language not in ("sh", "python") or block.name:
            continue
        done.append((block, run(block, folder)))
        if done[-1][1].returncode:
            break
    return done


def run(block: Block, folder: Path) -> subprocess.CompletedProcess[str]:
    """One block: Python, and commands of casadical alone, in this process; else with the environment of the tests."""
    if block.language == "python":
        if "__main__" not in block.text:
            return command_line.python(block.text, folder, width=200)
        # As a file, for the processes that it starts import it.
        (folder / "page.py").write_text(block.text, encoding="utf-8")
        command = [sys.executable, "page.py"]
    else:
        lines = block.text.splitlines()
        if all(re.fullmatch(r"casadical [^|&;<>$]*", line) for line in lines):
            for line in lines:
                done = command_line.run(*shlex.split(line)[1:], folder=folder, width=200)
                if done.returncode:
                    break
            return done
        command = ["bash", "-euo", "pipefail", "-c", block.text]
    environment = {**os.environ, "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "200"}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)

"""The command inside the process of a test: nothing is loaded again, and what was compiled is still there."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

import pytest

from casadical import cli

ROOT = Path(__file__).parents[1]


def main(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run `casadical` with these arguments; its exit code."""
    monkeypatch.setattr(sys, "argv", ["casadical", *map(str, arguments)])
    # Else the help is that of `python -m pytest`.
    monkeypatch.setattr(sys.modules["__main__"], "__package__", None, raising=False)
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    return int(stopped.value.code or 0)


def run(*arguments: object, folder: Path = ROOT, width: int = 80) -> subprocess.CompletedProcess[str]:
    """`casadical` as `subprocess.run` would do it: from a folder, at a dumb terminal; all that it wrote, in C too."""
    with ExitStack() as stack:
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        patch.chdir(folder)
        for name, value in (("COLUMNS", str(width)), ("TERM", "dumb"), ("NO_COLOR", "1")):
            patch.setenv(name, value)
        out, err = (stack.enter_context(_into_file(patch, number)) for number in (1, 2))
        code = main(patch, *arguments)
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        printed = []
        for file in (out, err):
            file.seek(0)
            printed.append(file.read())
    return subprocess.CompletedProcess(["casadical", *map(str, arguments)], code, *printed)


@contextmanager
def _into_file(patch: pytest.MonkeyPatch, number: int) -> Iterator[IO[str]]:
    """Standard output (1) or error (2) of Python and of libraries led into a file."""
    kept = os.dup(number)
    with TemporaryFile("w+", encoding="utf-8") as file, open(os.dup(file.fileno()), "w", encoding="utf-8") as stream:
        os.dup2(file.fileno(), number)
        patch.setattr(sys, {1: "stdout", 2: "stderr"}[number], stream)
        try:
            yield file
        finally:
            os.dup2(kept, number)
            os.close(kept)

"""The command inside the process of a test: nothing is loaded again, and what was compiled is still there."""

import os
import shutil
import subprocess
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

import pytest

from casadical import cli

ROOT = Path(__file__).parents[1]
# Exported C is compared with its reference on so many poses instead of 100,000, which take most of the time.
FEW = 1000


def own_planar(folder: Path) -> Path:
    """A problem folder of the planar arm, its table in it as poses.csv."""
    shutil.copytree(ROOT / "problems" / "planar", folder)
    shutil.copy(ROOT / "data" / "planar" / "planar.csv", folder / "poses.csv")
    problem = folder / "problem.toml"
    problem.write_text(problem.read_text().replace("../../data/planar/planar.csv", "poses.csv"))
    return folder


def main(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run `casadical` with these arguments; its exit code."""
    if arguments[:2] == ("export", "c"):
        from casadical.export import write_c

        monkeypatch.setitem(write_c.__kwdefaults__, "vectors", FEW)
    monkeypatch.setattr(sys, "argv", ["casadical", *map(str, arguments)])
    # Else the help is that of `python -m pytest`.
    monkeypatch.setattr(sys.modules["__main__"], "__package__", None, raising=False)
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    return int(stopped.value.code or 0)


def run(*arguments: object, folder: Path = ROOT, width: int = 80) -> subprocess.CompletedProcess[str]:
    """`casadical` as `subprocess.run` would do it: from a folder, at a dumb terminal; all that it wrote, in C too."""
    code, *printed = _captured(lambda patch: main(patch, *arguments), folder, width)
    return subprocess.CompletedProcess(["casadical", *map(str, arguments)], code, *printed)


def python(code: str, folder: Path, width: int = 80, file: Path | None = None) -> subprocess.CompletedProcess[str]:
    """A program in the process of the test, from a folder; an exception is its end, as in a process of its own."""
    space = {"__name__": "__main__"} | ({"__file__": str(file)} if file else {})

    def execute(patch: pytest.MonkeyPatch) -> int:
        patch.setattr(sys, "argv", [str(file or "-c")])
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ResourceWarning)  # of a file that a short example does not close
                exec(compile(code, str(file or "<program>"), "exec"), space)
        except Exception:
            traceback.print_exc()
            return 1
        return 0

    ended, *printed = _captured(execute, folder, width)
    return subprocess.CompletedProcess(["python", "-c", code], ended, *printed)


def _captured(what: Callable[[pytest.MonkeyPatch], int], folder: Path, width: int) -> tuple[int, str, str]:
    """What a function gives, and all that was written while it ran, in C too."""
    with ExitStack() as stack:
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        patch.chdir(folder)
        for name, value in (("COLUMNS", str(width)), ("TERM", "dumb"), ("NO_COLOR", "1"), ("MPLBACKEND", "Agg")):
            patch.setenv(name, value)
        out, err = (stack.enter_context(_into_file(patch, number)) for number in (1, 2))
        code = what(patch)
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        printed = []
        for file in (out, err):
            file.seek(0)
            printed.append(file.read())
    return code, printed[0], printed[1]


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

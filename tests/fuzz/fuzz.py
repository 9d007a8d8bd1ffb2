"""Hostile inputs for every command: what is run, and what must hold of it.

An input is a command line of a grammar and files that were changed: numbers at the edge of what can be, words in their
place, lines lost, doubled or cut, control characters and markup, folders and links in place of files. Each runs in a
process of its own on a copy of small valid files. What must hold of every one:

- the exit code is a documented one: 0, 2, 3 or 4; not 70, which is a bug, and no signal
- with 2 and 3 a message begins with `casadical: ` or is the usage; `check` prints its findings; with 0 standard error
  is empty; nowhere is a traceback or a control character
- it takes less than 20 s of the processor, and 1 GB beyond what the harness holds
- no input file is changed; with another code than 0 no output is left; no hidden file of an unfinished output is; JSON
  outputs can be read
"""

from __future__ import annotations

import fcntl
import hashlib
import importlib
import json
import os
import pkgutil
import re
import resource
import shutil
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from fuzz_inputs import Hostile

ROOT = Path(__file__).parents[2]
SECONDS, BYTES = 20, 2**30
CODES = {0, 2, 3}
MORE_CODES = {"calibrate": 4, "compare": 5, "verify": 5}


def load_all() -> None:
    """Every module of the package, so that no child of this process loads it again."""
    import casadical

    for module in pkgutil.walk_packages(casadical.__path__, "casadical."):
        with suppress(ImportError):  # of an extra that is not installed
            importlib.import_module(module.name)


def change(place: Path, name: str, kind: str, at: int, value: str) -> None:
    """Change one file of the world."""
    path = place / "in" / name
    if kind == "is":  # another file in its place
        shutil.rmtree(path) if path.is_dir() else path.unlink()
        path.symlink_to(value)
        return
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines()
    k = at % max(1, len(lines))
    if kind == "number":
        cells = list(_number_spans(text))
        if cells:
            a, b = cells[at % len(cells)]
            text = text[:a] + value + text[b:]
    elif kind == "word":
        spans = [(i, i + 1) for i, c in enumerate(text) if c in '"=,[']
        if spans:
            a, b = spans[at % len(spans)]
            text = text[:b] + value + text[b:]
    elif kind in ("drop line", "double line"):
        lines[k : k + 1] = [] if kind == "drop line" else lines[k : k + 1] * 2
        text = "\n".join(lines) + "\n"
    elif kind == "cut":
        text = text[: len(text) * (at % 100) // 100]
    elif kind == "put":
        a = len(text) * (at % 100) // 100
        text = text[:a] + value + text[a:]
    else:
        text = value
    path.write_text(text, encoding="utf-8", errors="surrogatepass")


def _number_spans(text: str) -> Any:
    return (m.span() for m in re.finditer(r"(?<![\w.])-?\d+(\.\d+)?(e-?\d+)?", text))


def run(
    hostile: Hostile, template: Path, scratch: Path, command: Callable[[], object] | None = None
) -> tuple[str, int]:
    """What is wrong with the run of an input, nothing if nothing is, and its exit code.

    command : what is run in place of casadical
    """
    place = scratch / "place"
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(template, place, symlinks=True)
    for one in hostile.changes:
        change(place, *one)
    before = snapshot(place / "in")
    began = time.monotonic()
    ends = [os.pipe() for _ in range(2)]
    for _, writing in ends:
        fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 2**20)  # a command that prints more waits, which is found out
    process = os.fork()
    if process == 0:
        try:
            _child(hostile, place, [writing for _, writing in ends], command)
        finally:
            os._exit(72)
    for _, writing in ends:
        os.close(writing)
    deadline = began + 6 * SECONDS  # for one that waits; a busy machine gives little of its processor
    while True:
        done, status, used = os.wait4(process, os.WNOHANG)
        if done:
            break
        if time.monotonic() > deadline:
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
            for reading, _ in ends:
                os.close(reading)
            return f"takes more than {6 * SECONDS} s of waiting", -1
        time.sleep(0.005)
    code = os.waitstatus_to_exitcode(status)
    out, error = (_read(reading) for reading, _ in ends)
    if code == -signal.SIGXCPU:
        return f"takes more than {SECONDS} s", code
    held = int((place / "held").read_text())
    return _fault(hostile, place, before, code, out, error, used.ru_maxrss * 1024 - held), code


def _held() -> int:
    """Memory of this process [bytes]. A fork begins with less than its parent holds: pages of files are not copied."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def _read(reading: int) -> str:
    os.set_blocking(reading, False)  # a process that the command left may hold the other end
    with os.fdopen(reading, "rb") as file:
        return (file.read() or b"").decode("utf-8", "replace")


def _child(hostile: Hostile, place: Path, ends: list[int], command: Callable[[], object] | None) -> None:
    """The command in this process, which ends here."""
    try:
        os.chdir(place)
        Path("held").write_text(str(_held()))
        for number, end in zip((1, 2), ends, strict=True):
            os.dup2(end, number)
            os.close(end)
        given = Path("in/stdin.csv") if "--follow" in hostile.command else Path("/dev/null")
        usable = not given.is_symlink() or given.is_file() or given.is_fifo() or given.is_char_device()
        os.dup2(os.open(given if usable else "/dev/null", os.O_RDONLY | os.O_NONBLOCK * given.is_fifo()), 0)
        sys.stdin, sys.stdout, sys.stderr = open(0, closefd=False), open(1, "w"), open(2, "w")  # noqa: SIM115
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 5))
        sys.argv = ["casadical", *hostile.command]
        from casadical.cli import main

        (command or main)()
        code: Any = 0
    except SystemExit as stopped:
        code = stopped.code
    except BaseException:
        import traceback

        traceback.print_exc()
        code = 71
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else 0 if code is None else 1)


def snapshot(folder: Path) -> dict[str, str]:
    """Every entry of a folder, with the hash of its content."""
    found = {}
    for path in sorted(folder.rglob("*")):
        plain = path.is_file() and not path.is_symlink() if path.name != "loop" else False
        found[str(path.relative_to(folder))] = hashlib.sha256(path.read_bytes()).hexdigest() if plain else ""
    return found


def _fault(hostile: Hostile, place: Path, before: dict[str, str], code: int, out: str, error: str, used: int) -> str:
    """The first thing that is wrong with what a run left."""
    if "Traceback (most recent call last)" in out + error:
        return "traceback: " + error.strip().splitlines()[-2 if len(error.strip().splitlines()) > 1 else -1][:150]
    if code not in {*CODES, MORE_CODES.get(hostile.command[0], 0)}:
        return f"exit code {code}: {error[-150:]!r}"
    if code in (2, 3) and not error.startswith("casadical: ") and "Usage: " not in error and not out.strip():
        return f"no message with exit code {code}: {error[:150]!r}"
    if code == 0 and error:
        return f"standard error with exit code 0: {error[:150]!r}"
    bad = next((c for c in out + error if ord(c) < 32 and c not in "\n\t"), None)
    if bad:
        return f"prints the control character {bad!r}"
    if used > BYTES:
        return f"takes {used / 2**30:.2f} GB"
    after = snapshot(place / "in")
    if after != before:
        names = [n for n in {*before, *after} if before.get(n) != after.get(n)]
        # What --overwrite was asked to replace may be replaced, unless the command reads it.
        asked = hostile.command if "--overwrite" in hostile.command else ()
        names = [n for n in names if f"in/{n}" not in asked]
        if hostile.command[0] == "measure":  # keeps its readings there
            names = [n for n in names if not n.startswith("live/")]
        # A folder that `new` was told to write gets new files.
        into = hostile.command[1] if hostile.command[0] == "new" and code == 0 else ""
        if any(n in before or not into or Path(into) not in (Path("in", n), Path("in", n).parent) for n in names):
            return f"changes inputs: {sorted(names)[:5]}"
    return _outputs_fault(hostile, place, code)


def _outputs_fault(hostile: Hostile, place: Path, code: int) -> str:
    left = sorted((place / "out").rglob("*"))
    if any(p.name.startswith(".casadical-") for p in left):
        return f"leaves a hidden file: {[p.name for p in left]}"
    files = [p for p in left if p.is_file()]
    if code not in (0, 4, 5) and files and hostile.command[0] != "check":
        return f"leaves outputs with exit code {code}: {[p.name for p in files]}"
    for path in files:
        if path.stat().st_size == 0:
            return f"leaves an empty file {path.name!r}"
        if f"--json {path.relative_to(place)}" in " ".join(hostile.command):
            try:
                json.loads(path.read_text())
            except ValueError as error:
                return f"writes {path.name!r}, which is no JSON: {error}"
    return ""

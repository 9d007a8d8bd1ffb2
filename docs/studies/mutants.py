"""python docs/studies/mutants.py [--room ROOM] [--seconds S] [--most N]; then --print > docs/studies/mutants.txt

Which wrong formulas would the tests notice? Each mutant is one change of the package that cosmic-ray makes (install it
by `pip install cosmic-ray`): an operator, a comparison, a constant, a condition turned, a loop of no turn, a decorator
or an exception lost. In each room `EACH` are drawn with a fixed seed: every place that can be changed is as likely as
another, no rule names a file, a line or a kind of change; only what changes no program (annotations, no Python) is
passed over. The draw belongs to a state of the package: continue on the commit on which it began.

A mutant runs tests until one fails: the one that killed it before; then those of its room (the folder of tests with its
name) that call the mutant's function, the quickest first, the others of their files, and then 60 tests of other rooms
that call it. It is killed by a failure, an error or a test that hangs. It lives if all pass, or if none has failed
within the limit (--seconds of processor time, 60); the print says which, and how many were killed by their own room.
Tests that killed one are run without a mutant at the end; a kill by one that fails then does not count. Mutants that
change nothing a caller can see are argued in EQUIVALENT. Which tests call what is in build/mutants_map.jsonl: `--trace
tests/robot ...` runs tests once and adds what they call; a mutant whose tests are not in it runs all of `--tests`.

A run works in a copy of the repository, appends a line to the log for each mutant with the commit that it was made on,
and leaves out what ran on a killed mutant before: `--room effects --most 20` runs the next twenty of one room, `--again
WORDS` those whose name contains the words, `--again ""` all, `--lived` those
that lived and are not argued as equivalent. `--list` prints all mutants, `--tests FILES` runs only these tests.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from mutants_equivalent import EQUIVALENT
from mutants_rules import PACKAGE, Mutant, drawn
from mutants_tests import Bench, chosen, read_map, run_tests

ROOT = Path(__file__).parents[2]
SEED, EACH, LIMIT = 59, 32, 60
ROOMS = sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))
MAP = ROOT / "build" / "mutants_map.jsonl"
LOG = Path(__file__).with_name("mutants.jsonl")


def mutants(room: str = "") -> Iterator[Mutant]:
    """All, or those of one room."""
    for name in ROOMS:
        if room in ("", name):
            yield from drawn(name, EACH, SEED)


def outcome(mutant: Mutant, bench: Bench, tests: Sequence[str], stamp: int) -> tuple[str, str]:
    """killed, lived, or late (no test had failed within the limit), and the test that failed."""
    file = bench.root / "casadical" / mutant.path
    original = file.read_text(encoding="utf-8")
    file.write_text(mutant.text, encoding="utf-8")
    os.utime(file, (stamp, stamp))  # so that no compiled file of another mutant is taken for this one
    try:
        status = run_tests(tests, bench)
    finally:
        file.write_text(original, encoding="utf-8")
        os.utime(file, (stamp + 1, stamp + 1))
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGALRM):
        return "late", ""
    if os.waitstatus_to_exitcode(status) in (0, pytest.ExitCode.NO_TESTS_COLLECTED):
        return "lived", ""
    return "killed", bench.failed.read_text(encoding="utf-8")


def trace(path: Path, tests: Sequence[str]) -> None:
    """Run these tests once, and add to the map what each calls."""
    path.parent.mkdir(parents=True, exist_ok=True)
    found = [str(Path(__file__).parent), str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "MUTANTS_MAP": str(path.resolve()), "PYTHONPATH": os.pathsep.join(found)}
    command = [sys.executable, "-m", "pytest", "-p", "mutants_tests", "-q", "-m", "slow or not slow", *tests]
    subprocess.run(command, cwd=ROOT, env=environment, check=True)


def copied(folder: Path) -> Path:
    """A copy of the repository in which files may be changed; what the tests only read is linked."""
    for path in ROOT.iterdir():
        if path.name in ("casadical", "tests", "docs"):
            shutil.copytree(path, folder / path.name, ignore=shutil.ignore_patterns("__pycache__", "gallery"))
        elif path.name != ".git":
            (folder / path.name).symlink_to(path)
    return folder


def commit() -> str:
    """That of the repository; with + where package or tests differ from it."""
    asked = (["rev-parse", "--short", "HEAD"], ["status", "--porcelain", "casadical", "tests"])
    head, changed = (subprocess.check_output(["git", *words], cwd=ROOT, text=True).strip() for words in asked)
    return head + "+" * bool(changed)


def read_log(log: Path) -> dict[str, dict[str, Any]]:
    """The last line of each mutant, by its key."""
    lines = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()] if log.exists() else []
    return {line["key"]: line for line in lines}


def report(log: Path) -> None:
    """Score by room, and what lived."""
    known = {m.key: m for m in mutants()}
    done = {key: line for key, line in read_log(log).items() if key in known}
    print(f"{len(done)} of {len(known)} mutants ran; * no failure within the limit")
    print()
    print(f"{'room':16s}   ran  killed  by its own tests  lived  equivalent  score   of  commits")
    for room in (*ROOMS, "all"):
        rows = {key: line for key, line in done.items() if room in (known[key].room, "all")}
        killed = sum(line["outcome"] == "killed" for line in rows.values())
        own = sum(f"tests/{known[key].room}/" in line["by"] for key, line in rows.items())
        same = sum(key in EQUIVALENT and line["outcome"] != "killed" for key, line in rows.items())
        lived = len(rows) - killed - same
        score = f"{killed / (len(rows) - same):6.3f}" if len(rows) > same else "     -"
        total = sum(room in (m.room, "all") for m in known.values())
        commits = " ".join(sorted({line["commit"] for line in rows.values()})) if room != "all" else ""
        figures = f"{len(rows):5d} {killed:7d} {own:17d} {lived:6d} {same:11d} {score} {total:4d}  {commits}"
        print(f"{room:16s} {figures}".rstrip())
    print()
    print("lived:")
    for key, line in done.items():
        if line["outcome"] != "killed" and key not in EQUIVALENT:
            print(f"  {known[key].name}{' *' if line['outcome'] == 'late' else ''}")
    argued = [f"  {known[key].name}: {why}" for key, why in EQUIVALENT.items() if key in known]
    print("\n".join(["", "equivalent:", *argued]))


def asked() -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("--room", default="")
    parser.add_argument("--seconds", type=int, default=LIMIT)
    parser.add_argument("--most", type=int, default=1000)
    parser.add_argument("--log", type=Path, default=LOG)
    parser.add_argument("--map", type=Path, default=MAP, help="which tests call what, see --trace")
    parser.add_argument("--print", action="store_true", dest="shown")
    parser.add_argument("--list", action="store_true", dest="names")
    parser.add_argument("--trace", nargs="*", default=[], help="tests to run once for the map")
    parser.add_argument("--again", help="run those again whose name contains this")
    parser.add_argument("--lived", action="store_true", help="run those again that lived")
    parser.add_argument("--tests", nargs="*", default=[], help="run only these tests on each mutant")
    return parser.parse_args()


def main() -> None:
    given = asked()
    if given.trace:
        trace(given.map, given.trace)
    elif given.names:
        print("\n".join(m.name for m in mutants(given.room)))
    elif given.shown:
        report(given.log)
    else:
        run(given)


def run(given: argparse.Namespace) -> None:
    """The mutants that are asked for; a line of each is printed, and added to the log."""
    for module in ("casadi", "numpy", "pandas", "scipy.stats", "pydantic", "typer", "rich.console", "hypothesis"):
        importlib.import_module(module)  # once for all children
    known, at = read_log(given.log), commit()
    todo = [m for m in mutants(given.room) if wanted(given, m, known.get(m.key))]
    with tempfile.TemporaryDirectory() as scratch:
        bench = Bench(copied(Path(scratch)), read_map(given.map), given.seconds)
        done: list[dict[str, Any]] = []
        for k, mutant in enumerate(todo[: given.most]):
            began = time.monotonic()
            before = str(known.get(mutant.key, {}).get("by", ""))
            tests = given.tests or chosen(bench.known, mutant.room, mutant.path, mutant.line, before)
            result, by = outcome(mutant, bench, tests, 10**9 + 2 * k)
            done.append({"key": mutant.key, "outcome": result, "by": by, "commit": at})
            note(given.log, done[-1:])
            print(f"{result:7s} {time.monotonic() - began:5.0f} s  {mutant.name}  {by}", flush=True)
        unsure = failing_anyway(done, bench)
    note(given.log, [line | {"outcome": "lived"} for line in done if line["by"] in unsure])


def wanted(given: argparse.Namespace, mutant: Mutant, line: dict[str, Any] | None) -> bool:
    """Whether to run a mutant whose last line in the log is this."""
    if given.again is not None:
        return given.again in mutant.name
    return line is None or (given.lived and line["outcome"] != "killed" and mutant.key not in EQUIVALENT)


def note(log: Path, lines: list[dict[str, Any]]) -> None:
    with log.open("a", encoding="utf-8") as file:
        file.writelines(json.dumps(line) + "\n" for line in lines)


def failing_anyway(done: list[dict[str, Any]], bench: Bench) -> set[str]:
    """Tests that killed a mutant and fail without one, too: these kills do not count."""
    killers = sorted({str(line["by"]) for line in done if "::" in str(line["by"])})
    wrong: set[str] = set()
    while killers and os.waitstatus_to_exitcode(run_tests(killers, bench, limit=600)):
        test = bench.failed.read_text(encoding="utf-8")
        print(f"fails without a mutant: {test}", flush=True)
        if test not in killers:
            return set(killers)
        wrong.add(test)
        killers.remove(test)
    return wrong


if __name__ == "__main__":
    main()

"""Which tests call which functions, for docs/studies/mutants.py; and which of them run on a mutant, in which order.

As a plugin of pytest (`-p mutants_tests`) it appends a line of JSON for each test to the file MUTANTS_MAP: its seconds,
and the functions of the package that it calls. What a fixture calls counts for every test that uses the fixture.
"""

from __future__ import annotations

import ast
import json
import os
import resource
import signal
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = f"{ROOT / 'casadical'}{os.sep}"
# A test that takes longer than so many times what it took, and than so many seconds, hangs.
LONGER, AT_LEAST = 20, 30
FIRST, FOREIGN = 20, 60

_called: list[set[CodeType]] = [set()]
_by_fixture: dict[int, set[CodeType]] = {}


def _trace(frame: FrameType, *_: Any) -> None:
    _called[-1].add(frame.f_code)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any) -> Iterator[None]:
    _called.append(set())
    try:
        return (yield)
    finally:
        _by_fixture[id(fixturedef)] = _called.pop()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: Any) -> Iterator[None]:
    _called[:] = [set()]
    began = time.monotonic()  # what a browser works is in no time of this process
    sys.settrace(_trace)
    try:
        done = yield
    finally:
        sys.settrace(None)
    used = (one for found in item._fixtureinfo.name2fixturedefs.values() for one in found)
    called = _called[0].union(*(_by_fixture.get(id(one), set()) for one in used))
    names = {f"{c.co_filename}:{c.co_qualname}" for c in called if c.co_filename.startswith(PACKAGE)}
    line = {
        "test": item.nodeid,
        "seconds": round(time.monotonic() - began, 3),
        "calls": sorted(name.removeprefix(PACKAGE) for name in names),
    }
    with open(os.environ["MUTANTS_MAP"], "a", encoding="utf-8") as file:
        file.write(json.dumps(line) + "\n")
    return done


@dataclass(frozen=True)
class Known:
    """Of each test: seconds, and `file:function` (its qualified name) of the functions that it calls."""

    seconds: Mapping[str, float]
    calls: Mapping[str, frozenset[str]]


def read_map(path: Path) -> Known:
    """What the plugin wrote. A test that ran twice counts as the second time."""
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return Known({x["test"]: x["seconds"] for x in lines}, {x["test"]: frozenset(x["calls"]) for x in lines})


def chosen(known: Known, room: str, path: str, line: int, before: str) -> list[str]:
    """Tests that run on a mutant: the one that killed it before; of its room those that call the function of this line,
    or where it is in none, any of its file; then the others of the same files, and of files that name the module; then
    those of other rooms that call it, as many as FOREIGN. The quickest of each first."""
    wanted = {f"{path}:{name}" for name in _functions_at(path, line)}
    direct = {t for t, made in known.calls.items() if (made & wanted if wanted else any(_in(path, c) for c in made))}
    own = {test for test in known.calls if test.startswith(f"tests/{room}/")}
    if not direct:  # a file of constants
        direct = own
    files = {test.partition("::")[0] for test in own}
    named = {f for f in files if (ROOT / f).exists() and Path(path).stem in (ROOT / f).read_text(encoding="utf-8")}
    named |= {test.partition("::")[0] for test in own & direct}
    others = {test for test in own - direct if test.partition("::")[0] in named}
    first, second, third = (
        sorted(part, key=lambda t: (known.seconds[t], t)) for part in (own & direct, others, direct - own)
    )
    tests = dict.fromkeys([*([before] if "::" in before else []), *first, *second, *third[:FOREIGN]])
    return [test for test in tests if (ROOT / test.partition("::")[0]).exists()]


def _in(path: str, call: str) -> bool:
    return call.startswith(f"{path}:")


def _functions_at(path: str, line: int) -> list[str]:
    """Qualified name of the innermost function that holds a line; lambdas and such count for it."""
    found: list[str] = []

    def visit(node: ast.AST, within: str) -> None:
        for child in ast.iter_child_nodes(node):
            name = within
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                name = f"{within}{child.name}"
                if not isinstance(child, ast.ClassDef):
                    if child.body[0].lineno <= line <= (child.end_lineno or 0):
                        found.append(name)
                    name += ".<locals>"
                name += "."
            visit(child, name)

    visit(ast.parse((ROOT / "casadical" / path).read_text(encoding="utf-8")), "")
    return found[-1:]


class Ordered:
    """Plugin that runs chosen tests, or files, in their order, writes the first that fails, and ends one that hangs."""

    def __init__(self, tests: list[str], seconds: Mapping[str, float], failed: Path) -> None:
        self.place = {test: k for k, test in enumerate(tests)}
        self.seconds, self.failed = seconds, failed

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        places = {item.nodeid: self.place.get(item.nodeid, self.place.get(item.location[0])) for item in items}
        kept = [item for item in items if places[item.nodeid] is not None]
        items[:] = sorted(kept, key=lambda item: places[item.nodeid] or 0)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> None:
        signal.setitimer(signal.ITIMER_PROF, max(AT_LEAST, LONGER * self.seconds.get(item.nodeid, 0)))
        self.failed.write_text(f"hangs: {item.nodeid}", encoding="utf-8")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed.write_text(report.nodeid, encoding="utf-8")

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self.failed.write_text(f"collection: {report.nodeid}", encoding="utf-8")


@dataclass(frozen=True)
class Bench:
    """A copy of the repository, what is known of its tests, and how long a mutant may take [s of the processor]."""

    root: Path
    known: Known
    seconds: int

    @property
    def failed(self) -> Path:
        return self.root / "failed"


def run_tests(tests: Sequence[str], bench: Bench, limit: int = 0) -> int:
    """Status of a child process that runs these tests in their order until one fails; limit : as the bench's.

    The first few in a process of their own: their files alone are imported for what they notice.
    """
    status = _run(list(tests[:FIRST]), bench, limit or bench.seconds)
    return status if status or len(tests) <= FIRST else _run(list(tests[FIRST:]), bench, limit or bench.seconds)


def _run(tests: list[str], bench: Bench, limit: int) -> int:
    bench.failed.write_text("", encoding="utf-8")
    child = os.fork()
    if not child:
        code = 70
        try:
            code = _in_child(tests, bench, limit)
        finally:
            os._exit(code)
    _, status = os.waitpid(child, 0)
    with suppress(ProcessLookupError):  # what a test of a mutant has left
        os.killpg(child, signal.SIGKILL)
    return status


def _in_child(tests: list[str], bench: Bench, limit: int) -> int:
    os.setsid()
    os.chdir(bench.root)
    sys.path.insert(0, str(bench.root))
    os.environ |= {"PYTHONPATH": str(bench.root), "OMP_NUM_THREADS": "1"}
    with (bench.root / "said").open("w") as said:
        os.dup2(said.fileno(), 1)
        os.dup2(said.fileno(), 2)
    spent = int(resource.getrusage(resource.RUSAGE_SELF).ru_utime)
    signal.alarm(10 * limit)
    resource.setrlimit(resource.RLIMIT_CPU, (spent + limit, spent + 3 * limit))
    order = Ordered(tests, bench.known.seconds, bench.failed)
    files = list(dict.fromkeys(test.partition("::")[0] for test in tests))
    options = ["-x", "-q", "-m", "slow or not slow", "-p", "no:cacheprovider"]
    options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # loaded before
    return int(pytest.main([*options, *files], plugins=[order])) if files else 0

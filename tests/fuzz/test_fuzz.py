"""Hostile command lines and files, drawn by hypothesis."""

import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import fuzz
import fuzz_files
import pytest
from fuzz_inputs import draw
from fuzz_world import world
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

pytestmark = pytest.mark.slow  # hundreds of commands
FOUND = sorted((Path(__file__).parent / "found").iterdir())

# The same inputs in every run, and none kept.
DRAWN_BY_RULE = settings(
    derandomize=True, deadline=None, database=None, phases=(Phase.generate,), suppress_health_check=list(HealthCheck)
)


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("world") / "template"
    fuzz.load_all()
    world(place)
    return place


@settings(DRAWN_BY_RULE, max_examples=200)
@given(st.data())
def test_every_input_ends_as_documented(template: Path, data: st.DataObject) -> None:
    def choose(among: Sequence[Any]) -> Any:
        return data.draw(st.sampled_from(among))

    hostile = draw(choose)
    fault, code = fuzz.run(hostile, template, template.parent)
    assert not fault, f"{hostile}\nexit code {code}"


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("raise ValueError('x')", "traceback"),
        ("import os; os.abort()", "exit code -6"),
        ("sys.exit(70)", "exit code 70"),
        ("sys.exit(2)", "no message"),
        ("print('hm', file=sys.stderr)", "standard error"),
        ("print('\\x1b[31m')", "control character"),
        ("open('in/p/robot.toml', 'a').write(' ')", "changes inputs"),
        ("open('out/a.json', 'w').write('{'); sys.argv = 1", "no JSON"),
        ("open('out/a.json', 'w').write('{}'); print('casadical: x', file=sys.stderr); sys.exit(2)", "leaves outputs"),
        ("open('out/.casadical-x.part', 'w')", "hidden file"),
        ("while True: pass", "takes more than"),
        ("b = bytearray(700_000_000); b[::4096] = b'x' * len(b[::4096])", "GB"),
    ],
)
def test_what_is_wrong_is_found(template: Path, monkeypatch: pytest.MonkeyPatch, body: str, told: str) -> None:
    """The harness itself: a command that does this is found out."""
    monkeypatch.setattr(fuzz, "SECONDS", 2)
    monkeypatch.setattr(fuzz, "BYTES", 600_000_000)
    hostile = fuzz.Hostile(("calibrate", "in/p", "--json", "out/a.json"), ())
    fault, _ = fuzz.run(hostile, template, template.parent, lambda: exec(body, {"sys": sys}))
    assert told in fault


@pytest.fixture(scope="module")
def kinds(template: Path) -> tuple[dict[str, fuzz_files.Kind], Path]:
    shutil.copytree(template, template.with_name("files"), symlinks=True)
    place = template.with_name("files")
    return fuzz_files.kinds(place), place / "in"


@pytest.mark.parametrize("path", FOUND, ids=lambda path: path.name)
def test_a_file_that_once_ended_in_a_traceback_or_never(kinds, path: Path) -> None:
    listed, place = kinds
    name, _, content = path.read_bytes().partition(b"\n")
    began = time.process_time()
    assert fuzz_files.fault_of(listed[name.decode()], place, content) == ""
    assert time.process_time() - began < 5


def test_a_cell_of_many_digits_is_looked_at_once(kinds) -> None:
    listed, place = kinds
    began = time.process_time()
    assert fuzz_files.fault_of(listed["dh.csv"], place, b"a_mm,alpha_deg\n1,0\n" + b"5" * 90_000 + b"x,0\n") == ""
    assert time.process_time() - began < 2


def test_every_kind_of_file_is_read_as_it_is(kinds) -> None:
    """Else its mutants are all refused at the same place."""
    listed, place = kinds
    for kind in listed.values():
        (place / kind.name).parent.mkdir(exist_ok=True)
        (place / kind.name).write_bytes(kind.seeds[0])
        if kind.name not in ("p/problem.toml", "answers.jsonl", "w/withheld.json", "c/manifest.json"):
            kind.read(place / kind.name)


@settings(DRAWN_BY_RULE, max_examples=400)
@given(st.data())
def test_mutated_files_end_as_documented(kinds, data: st.DataObject) -> None:
    listed, place = kinds
    kind = listed[data.draw(st.sampled_from(sorted(listed)))]
    content = fuzz_files.mutated(kind, data.draw(st.randoms(use_true_random=False)))
    began = time.process_time()
    assert fuzz_files.fault_of(kind, place, content) == "", content
    assert time.process_time() - began < 20


@pytest.mark.parametrize(
    ("name", "made"), [("my.effect.toml", fuzz_files.effect_file), ("log.csv", fuzz_files.log_file)]
)
@settings(DRAWN_BY_RULE, max_examples=100)
@given(data=st.data())
def test_files_by_grammar_end_as_documented(kinds, name: str, made, data: st.DataObject) -> None:
    """What is nearly right comes farther than mutants do: it reaches the model, and the log's own checks."""
    listed, place = kinds
    content = made(data.draw(st.randoms(use_true_random=False)))
    assert fuzz_files.fault_of(listed[name], place, content) == "", content

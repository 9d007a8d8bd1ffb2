"""Hostile command lines and files, drawn by hypothesis of the grammar of docs/studies/fuzz.py."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

ROOT = Path(__file__).parents[2]


sys.path.insert(0, str(ROOT / "docs" / "studies"))

import fuzz  # noqa: E402


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("world") / "template"
    fuzz.load_all()
    fuzz.world(place)
    return place


@settings(
    max_examples=200,
    derandomize=True,
    deadline=None,
    database=None,
    phases=(Phase.generate,),
    suppress_health_check=list(HealthCheck),
)
@given(st.data())
def test_every_input_ends_as_documented(template: Path, data: st.DataObject) -> None:
    def choose(among: Sequence[Any]) -> Any:
        return data.draw(st.sampled_from(among))

    hostile = fuzz.draw(choose)
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
    import casadical.cli

    monkeypatch.setattr(casadical.cli, "main", lambda: exec(body, {"sys": sys}))
    monkeypatch.setattr(fuzz, "SECONDS", 2)
    monkeypatch.setattr(fuzz, "BYTES", 600_000_000)
    hostile = fuzz.Hostile(("calibrate", "in/p", "--json", "out/a.json"), ())
    fault, _ = fuzz.run(hostile, template, template.parent)
    assert told in fault

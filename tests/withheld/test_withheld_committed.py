"""The committed run says what is committed: key, answers and figures belong together."""

from __future__ import annotations

import json

import pytest
from checks import ROOT

from casadical.withheld.score import score

DATA = ROOT / "data" / "withheld"


def test_the_committed_answers_have_the_committed_figures() -> None:
    found = score(DATA, DATA, DATA / "answers.diagnosis.jsonl").as_json()
    kept = json.loads((DATA / "score.json").read_text())
    assert found["campaigns"] == kept["campaigns"] == 320
    assert found["unanswered"] == []
    assert found["confusion"] == kept["confusion"]
    for name, figure in kept["figures"].items():
        numbers = [[f[k] for k in ("value", "low", "high", "n")] for f in (found["figures"][name], figure)]
        assert numbers[0] == pytest.approx(numbers[1], rel=1e-3, abs=1e-4), name


def test_the_second_run_has_its_key() -> None:
    second = score(DATA / "second", DATA / "second", DATA / "second" / "answers.diagnosis.jsonl")
    assert (len(second.trials), second.unanswered) == (48, [])


def test_the_page_has_the_committed_figures() -> None:
    page = (ROOT / "docs" / "blind-check.md").read_text()
    for name, figure in json.loads((DATA / "score.json").read_text())["figures"].items():
        row = next(line for line in page.splitlines() if line.startswith(f"| {name} |"))
        assert f"| {figure['value']:.3f} " in row, name

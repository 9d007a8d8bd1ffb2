"""The committed runs say what is committed: keys, answers, figures and the page belong together."""

import json
from pathlib import Path

import pytest
from checks import ROOT

from casadical.blind_check.scoring import in_common, score

DATA = ROOT / "data" / "withheld"
COUNTED = sorted(path.parent for path in DATA.rglob("score.json"))


@pytest.mark.parametrize("run", COUNTED, ids=lambda run: run.name)
def test_the_committed_answers_have_the_committed_figures(run: Path) -> None:
    found = score(run, run, run / "answers.diagnosis.jsonl").to_json()
    kept = json.loads((run / "score.json").read_text())
    assert found["campaigns"] == kept["campaigns"] == (640 if run.name == "fourth" else 320)
    assert found["unanswered"] == []
    assert found["confusion"] == kept["confusion"]
    for name, figure in kept["figures"].items():
        numbers = [[f[k] for k in ("value", "low", "high", "n")] for f in (found["figures"][name], figure)]
        assert numbers[0] == pytest.approx(numbers[1], rel=1e-3, abs=1e-4), name


def test_the_second_run_has_its_key() -> None:
    second = score(DATA / "second", DATA / "second", DATA / "second" / "answers.diagnosis.jsonl")
    assert (len(second.outcomes), second.unanswered) == (48, [])


@pytest.mark.parametrize("run", COUNTED, ids=lambda run: run.name)
def test_the_page_has_the_committed_figures(run: Path) -> None:
    page = (ROOT / "docs" / "blind-check.md").read_text()
    for name, figure in json.loads((run / "score.json").read_text())["figures"].items():
        row = next(line for line in page.splitlines() if line.startswith(f"| {name} |"))
        assert f"| {figure['value']:.3f} (" in row, name


def test_the_page_has_the_baselines_of_the_last_run() -> None:
    run = next(run for run in reversed(COUNTED) if len(answers(run)) > 1)
    page = (ROOT / "docs" / "blind-check.md").read_text().partition("<!-- beside -->")[2]
    for s in in_common([score(run, run, path) for path in answers(run)]):
        for row in s.metrics:
            line = next(line for line in page.splitlines() if line.startswith(f"| {row.name} |"))
            assert f"| {str(row.estimate).replace('  (', ' (')} |" in line, (s.head.by, row.name)


def answers(run: Path) -> list[Path]:
    return sorted(run.glob("answers.*.jsonl*"))

"""The key is the published one or nothing is scored; figures that can be counted by hand."""

import json
import re
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from casadical.blind_check.protocol import Answer, HiddenEffect, Secret, label, read_manifest
from casadical.blind_check.scoring import Outcome, fraction, mean, metrics, outcome, score
from casadical.blind_check.worker_pool import workers
from casadical.cli import app
from casadical.core.basics import InputError


def test_a_changed_key_is_refused(small, tmp_path) -> None:
    shutil.copytree(small.key, tmp_path / "key")
    path = tmp_path / "key" / "key.json"
    path.write_text(path.read_text().replace('"kind": "none"', '"kind": "unlisted"', 1))
    with pytest.raises(InputError, match="the key was changed after it was made"):
        score(small.folder, tmp_path / "key", small.answers)


def test_answers_to_another_check_are_refused(small, tmp_path) -> None:
    lines = small.answers.read_text().splitlines(keepends=True)
    head = json.loads(lines[0]) | {"key_sha256": "0" * 64}
    path = tmp_path / "answers.jsonl"
    path.write_text(json.dumps(head) + "\n" + "".join(lines[1:]))
    with pytest.raises(InputError, match="answers another check"):
        score(small.folder, small.key, path)


def test_bad_files_are_named(small, tmp_path) -> None:
    with pytest.raises(InputError, match="no such key"):
        score(small.folder, tmp_path / "nowhere", small.answers)
    path = tmp_path / "answers.jsonl"
    changed = small.answers.read_text().replace('"verdict":"', '"verdict":"perhaps ', 1)
    path.write_text(changed)  # its checksum tells that the line was changed: no answer, to be answered again
    assert len(score(small.folder, small.key, path).unanswered) == 1
    path.write_text(re.sub(r',"sha256":"[0-9a-f]{64}"', "", changed))  # as an earlier casadical wrote it
    with pytest.raises(InputError, match=r"line 2: verdict: .*delete this line, and run predict again"):
        score(small.folder, small.key, path)
    path.write_text("{}\n")
    with pytest.raises(InputError, match=r"line 1: key_sha256: .*predict into another file \(--out\)"):
        score(small.folder, small.key, path)
    path.write_text("")
    with pytest.raises(InputError, match="holds no answers"):
        score(small.folder, small.key, path)


def test_the_command_prints_every_figure_and_writes_them(small, tmp_path) -> None:
    words = ["withheld", "score", str(small.folder), str(small.key), str(small.answers)]
    done = CliRunner().invoke(app, [*words, "--json", str(tmp_path / "score.json")])
    assert done.exit_code == 0, done.output
    told = json.loads((tmp_path / "score.json").read_text())
    assert told["campaigns"] == 4
    assert set(told["figures"]) == set(score(small.folder, small.key, small.answers).metrics)
    assert all(name in done.output for name in told["figures"])
    assert read_manifest(small.folder).key_sha256 in done.output


def test_unanswered_campaigns_are_told(small, tmp_path) -> None:
    path = tmp_path / "some.jsonl"
    path.write_text("".join(small.answers.read_text().splitlines(keepends=True)[:3]))
    found = score(small.folder, small.key, path)
    assert (len(found.outcomes), len(found.unanswered)) == (2, 2)


def test_intervals_against_scipy() -> None:
    stats = pytest.importorskip("scipy.stats")
    for hits, n in ((0, 34), (8, 10), (33, 33), (4, 25)):
        found = fraction([k < hits for k in range(n)])
        interval = stats.binomtest(hits, n).proportion_ci(method="wilson")
        assert (found.value, found.hits, found.n) == (hits / n, hits, n)
        assert (found.low, found.high) == pytest.approx((interval.low, interval.high), abs=1e-12)
    values = np.random.default_rng(3).gamma(2.0, size=80)
    own = mean(values)
    other = stats.bootstrap((values,), np.mean, n_resamples=4000, method="percentile", rng=1).confidence_interval
    assert own.value == pytest.approx(float(values.mean()))
    assert (own.low, own.high) == pytest.approx((other.low, other.high), rel=0.05)
    assert fraction([]).value is None
    assert str(mean([])) == "-"


def made(kind: str, truth: tuple[str, ...], verdict: str, named: tuple[str, ...], **more: object) -> Outcome:
    """A trial by hand; the set of the first cause is itself unless told."""
    given = {
        "name": "t", "robot": "r", "kind": kind, "poses": 40, "missing": None,
        "effects": tuple(t.partition("@")[0] for t in truth) or (("ghost",) if kind == "unlisted" else ()),
        "truth": truth, "signal": 1.0, "signals": (1.0,) * len(truth), "verdict": verdict, "named": named,
        "alike": named[:1], "probability": 0.5,
    }  # fmt: skip
    return Outcome(**(given | more))  # type: ignore[arg-type]


def test_figures_counted_by_hand() -> None:
    outcomes = [
        made("none", (), "none", ()),
        made("none", (), "explained", ("backlash@1",)),
        made("one", ("backlash@2",), "explained", ("backlash@2", "joint_scale@1"), probability=0.9),
        made("one", ("backlash@2",), "explained", ("backlash@3",), probability=0.1, alike=("backlash@3", "backlash@2")),
        made("one", ("frame_drift",), "ambiguous", ("target_shift",), probability=0.2, signal=0.4),
        made("one", ("frame_drift",), "none", (), probability=0.0, signal=0.3),
        made("several", ("a@1", "b"), "explained", ("b", "a@1")),
        made("several", ("a@1", "b"), "explained", ("b", "c"), signals=(0.1, 1.0)),
        made("unlisted", (), "explained", ("c",)),
        made("unlisted", (), "unknown", ()),
    ]
    found = {name: (e.value, e.hits, e.n) for name, (e, _) in metrics(outcomes).items()}
    expected = {
        "false alarms where there is nothing": (0.5, 1, 2),
        "detection, signal >= .5": (1.0, 6, 6),
        "detection, signal .35 to .5": (1.0, 1, 1),
        "detection, signal .2 to .35": (0.0, 0, 1),
        "one effect: first cause right, signal >= .35": (1 / 3, 1, 3),
        "FIA: probability of the true cause, signal >= .35": (0.4, None, 3),
        "FIA over all campaigns with one effect": (0.3, None, 4),
        "one effect: claims right": (0.5, 1, 2),
        "one effect: claims made, signal >= .35": (2 / 3, 2, 3),
        "one effect: sets contain the truth": (2 / 3, 2, 3),
        "one effect: size of the set": (4 / 3, None, 3),
        "two effects, each >= .35: both named first": (1.0, 1, 1),
        "several: recall of effects >= .35": (1.0, 3, 3),
        "several: precision": (0.75, 3, 4),
        "on no list, claimed as listed": (0.5, 1, 2),
        "on no list, any listed cause named": (0.5, 1, 2),
    }
    for name, (value, hits, n) in expected.items():
        assert found[name] == (pytest.approx(value), hits, n), name


def test_a_trial_compares_an_answer_with_what_was_hidden() -> None:
    secret = Secret(
        robot="r", kind="one", poses=40, missing=None, noise=1e-5, repeatability=0.0, visible=2e-5,
        hidden=(HiddenEffect(effect="gravity_compensator", joint=2, about="", visible=2e-5),),
    )  # fmt: skip
    given = {
        "campaign": "c", "verdict": "ambiguous",
        "causes": [{"effect": "gravity_compensator", "joint": 2, "indistinguishable": ["backlash@2", "x", "y"]}],
        "posterior": {"gravity_compensator@2": 0.7, "none": 0.3},
    }  # fmt: skip
    found = outcome("c", secret, Answer.model_validate(given))
    assert found.truth == found.named == ("gravity_compensator",)
    assert found.alike == ("gravity_compensator", "backlash@2", "x")
    assert (found.signal, found.probability) == pytest.approx((2.0, 0.7))


def test_labels_leave_out_joints_that_mean_nothing() -> None:
    assert label("backlash", 3) == "backlash@3"
    assert label("gravity_compensator", 2) == "gravity_compensator"
    assert label("thermal_growth", None) == "thermal_growth"


def test_an_error_among_workers_is_told_unchanged() -> None:
    with pytest.raises(ZeroDivisionError), workers(None, 1):
        raise ZeroDivisionError


def test_what_is_written_of_made_campaigns_names_them_and_their_key(tmp_path, monkeypatch) -> None:
    made = SimpleNamespace(campaigns={"a": {}, "b": {}}, key_sha256="0" * 64)

    def fake(*_, also, **__):
        for path, text in also(made).items():
            path.write_text(text)
        return made

    monkeypatch.setattr("casadical.blind_check.generation.make", fake)
    out, kept = tmp_path / "made", tmp_path / "made.json"
    done = CliRunner().invoke(app, ["withheld", "make", "--out", str(out), "--json", str(kept), "--workers", "1"])
    assert done.exit_code == 0, done.output
    told = json.loads(kept.read_text())
    assert (told["campaigns"], told["folder"], told["key_sha256"]) == (["a", "b"], str(out), "0" * 64)

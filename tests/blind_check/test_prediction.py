"""Answers come from the campaigns alone, are kept as they come, and from any executor."""

import json
import shutil
import subprocess
import sys

import pytest
from checks import Here, N

from casadical.blind_check.prediction import predict
from casadical.blind_check.protocol import read_answers, read_manifest
from casadical.core.basics import InputError


@pytest.mark.slow
def test_the_diagnosis_answers_with_the_campaigns_alone(small, tmp_path) -> None:
    """One campaign, moved to where no key is near, in a process of its own."""
    name = next(iter(read_manifest(small.folder).campaigns))
    alone = tmp_path / "alone"
    shutil.copytree(small.folder, alone)
    manifest = json.loads((alone / "withheld.json").read_text())
    manifest["campaigns"] = {name: manifest["campaigns"][name]}
    (alone / "withheld.json").write_text(json.dumps(manifest))
    for path in alone.glob("*.csv"):
        if not path.name.startswith(name):
            path.unlink()
    command = "from casadical.cli import main; main()"
    words = [sys.executable, "-c", command, "withheld", "predict", str(alone), "--workers", "1"]
    done = subprocess.run(words, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    head, answers = read_answers(alone / "answers.diagnosis.jsonl")
    assert head.by == "diagnosis"
    assert sum(answers[name].probabilities.values()) == pytest.approx(1, abs=0.01)


def test_answers_that_are_there_are_kept(small, stubbed, tmp_path) -> None:
    path = tmp_path / "answers.jsonl"
    whole = small.answers.read_bytes().splitlines(keepends=True)
    # Cut in the middle of the third answer.
    begun(small, path, 2)
    path.write_bytes(path.read_bytes() + whole[3][:100])
    pool = Here()
    seen: list[tuple[str, int, int]] = []
    predict(small.folder, path, executor=pool, show=lambda *told: seen.append(told))
    assert pool.count == N - 2
    assert [done for _, done, _ in seen] == [3, 4]
    assert sorted(path.read_bytes().splitlines()) == sorted(small.answers.read_bytes().splitlines())


def begun(small, path, answered: int) -> None:
    """A file with the first answers of the whole one."""
    path.write_bytes(b"".join(small.answers.read_bytes().splitlines(keepends=True)[: answered + 1]))


def test_an_interrupted_run_keeps_what_it_has(small, stubbed, tmp_path) -> None:
    path = tmp_path / "answers.jsonl"
    begun(small, path, N - 2)

    def stop(_name: str, done: int, _count: int) -> None:
        if done == N - 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        predict(small.folder, path, executor=Here(), show=stop)
    assert len(read_answers(path)[1]) == N - 1


def test_a_campaign_that_cannot_be_answered_does_not_stop_the_others(small, stubbed, tmp_path) -> None:
    torn = tmp_path / "torn"
    shutil.copytree(small.folder, torn)
    name = next(iter(read_manifest(torn).campaigns))
    path = torn / f"{name}.csv"
    path.write_text(path.read_text().replace(",", ",nothing", 30))
    answers = predict(torn, tmp_path / "answers.jsonl", executor=Here())
    assert set(read_answers(answers)[1]) == set(read_manifest(torn).campaigns) - {name}
    assert "is not a finite number" in next(t for t in answers.read_text().splitlines() if '"failed"' in t)


def test_bad_input_is_named(small, tmp_path) -> None:
    with pytest.raises(InputError, match=r"holds no withheld\.json"):
        predict(tmp_path)
    other = tmp_path / "other.jsonl"
    other.write_text(small.answers.read_text().replace(read_manifest(small.folder).key_sha256, "0" * 64))
    with pytest.raises(InputError, match="holds answers to another check; name another file by --out"):
        predict(small.folder, other)
    torn = tmp_path / "torn"
    shutil.copytree(small.folder, torn)
    next(torn.glob("*.csv")).unlink()
    with pytest.raises(InputError, match=r"is missing, though withheld\.json names it"):
        predict(torn, tmp_path / "answers.jsonl")

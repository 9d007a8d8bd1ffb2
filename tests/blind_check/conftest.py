"""One small check for all tests of this folder."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from checks import ROOT, Here, N

from casadical.blind_check import prediction


@dataclass(frozen=True)
class Small:
    folder: Path
    key: Path
    answers: Path


def said(name: str, *_: object) -> dict[str, Any]:
    """What is answered to every campaign in the place of a diagnosis, which takes seconds."""
    return {
        "campaign": name, "verdict": "explained", "causes": [{"effect": "joint_scale", "joint": 1}],
        "posterior": {"joint_scale@1": 0.9, "none": 0.1},
    }  # fmt: skip


@pytest.fixture
def stubbed(monkeypatch) -> None:
    monkeypatch.setattr(prediction, "diagnosis", said)


@pytest.fixture(scope="session")
def small(tmp_path_factory) -> Small:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'casadical[withheld]'")
    from casadical.blind_check.generation import make

    top = tmp_path_factory.mktemp("withheld")
    folder, key = top / "campaigns", top / "key"
    make(folder, key, N, 5, poses=[20], project=ROOT, executor=Here())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prediction, "diagnosis", said)
        return Small(folder, key, prediction.predict(folder, top / "answers.jsonl", executor=Here()))

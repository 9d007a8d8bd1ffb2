"""One small check for all tests of this folder."""

from dataclasses import dataclass
from pathlib import Path

import pytest
from checks import ROOT, Here, N

from casadical.blind_check.generation import make
from casadical.blind_check.prediction import predict


@dataclass(frozen=True)
class Small:
    folder: Path
    key: Path
    answers: Path


@pytest.fixture(scope="session")
def small(tmp_path_factory) -> Small:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'casadical[withheld]'")
    top = tmp_path_factory.mktemp("withheld")
    folder, key = top / "campaigns", top / "key"
    make(folder, key, N, 5, poses=[20], project=ROOT, executor=Here())
    return Small(folder, key, predict(folder, top / "f-test.jsonl", by="f-test", executor=Here()))

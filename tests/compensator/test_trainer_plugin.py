"""A trainer from another package, found by its entry point alone: no line of casadical knows it."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from plugin_site import ROOT, installed, run, run_here

from casadical.compensator import JointBox, Layout, load_compensator, make_task
from casadical.compensator.trainers.known import known_trainers

# The trainer of the page, as a user would copy it.
PAGE = (ROOT / "docs" / "compensator.md").read_text(encoding="utf-8")
(MODULE,) = re.findall(r"```python\n([^`]*?class RandomFeatures.*?)\n\nrng = ", PAGE, re.DOTALL)
POINT = "random-features = toy:RandomFeatures"
DATA = ROOT / "data" / "hh800_twin" / "hh800_twin.csv"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The HH800 with the method of the plug-in."""
    made = tmp_path_factory.mktemp("problem")
    text = (ROOT / "problems" / "hh800" / "problem.toml").read_text()
    text = re.sub(r"methods = .*", 'methods = ["SKCM", "RF-NN-SKCM"]', text)
    (made / "problem.toml").write_text(text.replace("../../data/hh800_twin/hh800_twin.csv", DATA.as_posix()))
    (made / "robot.toml").write_text((ROOT / "problems" / "hh800" / "robot.toml").read_text())
    return made


def test_a_plug_in_trains_a_method_of_a_problem(folder: Path, tmp_path: Path) -> None:
    site = installed(tmp_path, "casadical.trainers", POINT, MODULE)
    done = run(site, "calibrate", folder, "--out", tmp_path / "out", "--report", tmp_path / "r.html", "--details")
    assert (done.returncode, done.stderr) == (0, "")
    entry = json.loads((tmp_path / "out" / "result.json").read_text())["networks"]["RF-NN-SKCM"]
    assert (entry["trainer"], entry["settings"]) == ("random-features", {"draws": 300, "ridge": 0.1})
    trained = entry["as_trained"]["train"]
    assert trained["after"]["mean_mm"] < 0.9 * trained["before"]["mean_mm"]
    row = next(line for line in done.stdout.splitlines() if line.startswith("RF-NN-SKCM") and ">" in line)
    assert row.split()[-1] == ("kept" if entry["helps"] else "refused")
    kept = load_compensator(tmp_path / "out" / "RF-NN-SKCM.compensator.json")
    assert (kept.trainer, kept.helps) == ("random-features", entry["helps"])
    assert '"name":"RF-NN-SKCM' in (tmp_path / "r.html").read_text()
    completed = run(site, program="from casadical.cli.options import methods; print(methods('RF'))")
    assert completed.stdout == "['RF-NN-SKCM']\n"


def test_a_plug_in_resumes_from_a_checkpoint_to_the_same_network(tmp_path: Path) -> None:
    installed(tmp_path, "casadical.trainers", POINT, MODULE)
    program = """
import sys
import numpy as np
from casadical.compensator import Compensator
rng = np.random.default_rng(0)
q = rng.uniform(-1, 1, (60, 6))
data = (q, 0.2 * np.sin(q[:, :3]))
whole = Compensator.fit(*data, trainer="random-features")
seen = []
def cut(p):
    seen.append(p)
    if len(seen) == 20:
        raise KeyboardInterrupt
try:
    Compensator.fit(*data, trainer="random-features", checkpoint=sys.argv[1], progress=cut)
except KeyboardInterrupt:
    pass
again = Compensator.fit(*data, trainer="random-features", checkpoint=sys.argv[1])
print(again.network.weights.tobytes() == whole.network.weights.tobytes(), len(seen))
"""
    done = run(tmp_path, tmp_path / "c", program=program)
    assert (done.returncode, done.stdout.split()) == (0, ["True", "20"]), done.stderr


FAULTY = {
    "a name that is taken": ('"random-features"', '"lm"', "lm = toy:RandomFeatures", "already"),
    "a method that is taken": ('"RF-NN-SKCM"', '"GP-NN-SKCM"', POINT, "two trainers have the method 'GP-NN-SKCM'"),
    "of another family": ("(Trainer)", "", POINT, "must be a subclass of"),
}


@pytest.mark.parametrize("name", FAULTY)
def test_a_faulty_plug_in_is_named(name: str, folder: Path, tmp_path: Path, monkeypatch) -> None:
    old, new, point, words = FAULTY[name]
    site = installed(tmp_path, "casadical.trainers", point, MODULE.replace(old, new))
    done = run_here(monkeypatch, known_trainers, site, "calibrate", folder)
    assert done.returncode == 2, done.stderr
    assert words in done.stderr


def test_without_the_plug_in_its_method_is_not_known(folder: Path, tmp_path: Path, monkeypatch) -> None:
    done = run_here(monkeypatch, known_trainers, tmp_path, "calibrate", folder)
    assert done.returncode == 2
    assert "RF-NN-SKCM" in done.stderr
    assert "GP-NN-SKCM" in done.stderr


def test_the_page_draws_what_it_says() -> None:
    """The toy's output layer is the ridge solution: its residual is orthogonal to the features but for the ridge."""
    space: dict[str, object] = {}
    exec(MODULE, space)
    rng = np.random.default_rng(1)
    q = rng.uniform(-1, 1, (40, 6))
    task = make_task(Layout(), JointBox((-1,) * 6, (1,) * 6), q, np.sin(q[:, :3]))
    run_ = space["RandomFeatures"](draws=1).begin(task, 0)
    run_.step()
    hidden, last = task.layout.layers(run_.best())
    z = np.vstack([np.tanh(hidden @ task.inputs), np.ones(40)])
    assert (task.targets - last @ z) @ z.T == pytest.approx(0.1 * last, abs=1e-12)

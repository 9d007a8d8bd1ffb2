"""Parts of the compensator that whole trainings do not show."""

import json
from pathlib import Path

import numpy as np

from casadical.compensator import Compensator, Layout, load_compensator, save_compensator
from casadical.compensator.checksummed_json import checksummed
from casadical.compensator.iwo import IwoSettings
from casadical.compensator.network import Task, forward, random_weights
from casadical.compensator.trainers.backprop import Backprop
from casadical.compensator.trainers.iwo import Iwo, IwoRun, IwoThenLm
from casadical.compensator.trainers.levenberg_marquardt import LevenbergMarquardt, advance, begin_batch
from problems import small_task, smooth


def test_starting_weights_keep_the_spread_of_what_comes_in() -> None:
    layout = Layout(joints=6, hidden=(40,), outputs=3)
    drawn = random_weights(layout, np.random.default_rng(0), 4000)
    spread = np.sort(drawn.std(axis=0))
    # 40 neurons of 6 joints and a bias, 3 outputs of 40 neurons and a bias: of variance one over these numbers.
    expected = np.sort([7**-0.5] * 40 * 7 + [41**-0.5] * 3 * 41)
    np.testing.assert_allclose(spread, expected, rtol=0.08)


def test_a_problem_without_an_error_is_left_at_once() -> None:
    task = small_task()
    weights = random_weights(task.layout, np.random.default_rng(0), 1)
    exact = Task(task.layout, task.inputs, forward(task.layout, weights, task.inputs)[0], task.scale_mm, task.loss)
    samples, none = np.full((1, task.targets.shape[1]), 1 / task.targets.shape[1]), np.zeros(1)
    batch = advance(exact, begin_batch(exact, weights, samples, none), samples, none)
    assert batch.cost[0] == 0
    assert not batch.active[0]
    np.testing.assert_array_equal(batch.weights, weights)


def test_the_second_trainer_waits_for_the_first() -> None:
    run = IwoThenLm(Iwo(IwoSettings(iterations=3)), LevenbergMarquardt(iterations=2, ridges=(0.0,))).begin(
        small_task(), 0
    )
    parts = []
    for _ in range(20):
        if run.reasons():
            break
        run.step()
        parts.append("iwo" if isinstance(run.run, IwoRun) else "lm")
    first = parts.index("lm")
    assert first >= 2  # generations: the last one starts the second
    assert set(parts[first:]) == {"lm"}
    assert len(parts) < 20


def test_settings_of_trainers_are_those_of_the_page() -> None:
    page = (Path(__file__).parents[2] / "docs" / "compensator.md").read_text(encoding="utf-8")
    default = next(line for line in page.splitlines() if line.startswith("| `lm` (default)"))
    of_method = next(line for line in page.splitlines() if line.startswith("| `LM-NN-SKCM`"))
    assert "ten restarts" in default
    assert LevenbergMarquardt().restarts == 10
    assert "20 restarts" in of_method
    assert LevenbergMarquardt.for_method().restarts == 20
    # The paper's own trainers learn millimetres, not shares of the residual.
    assert (Backprop.output_scale_mm, Iwo.output_scale_mm, LevenbergMarquardt.output_scale_mm) == (1.0, 1.0, None)


def test_a_network_that_corrects_nothing_of_no_error_is_read(tmp_path: Path) -> None:
    made = Compensator.fit(*smooth(60, 0), trainer=LevenbergMarquardt(restarts=1, iterations=30, ridges=(1e-3,)))
    assert made.network is not None
    save_compensator(made, tmp_path / "net.json")
    body = json.loads((tmp_path / "net.json").read_text())
    for key in ("format", "version", "sha256"):
        body.pop(key)
    body["network"]["weights"] = [0.0] * len(body["network"]["weights"])
    body["training"]["before"]["max_mm"] = 0.0
    (tmp_path / "none.json").write_text(checksummed("casadical-compensator", 1, body))
    assert not load_compensator(tmp_path / "none.json").correction_mm(np.zeros((1, 6))).any()

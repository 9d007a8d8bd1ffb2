"""The paper's four methods on a problem: who learns from what, who is refused, what is printed and kept."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from marks import slow

from casadical import calibrate
from casadical.compensator import load_compensator
from casadical.compensator.trainers.registry import network_methods
from casadical.identification import residual_mm
from casadical.project.calibration_page import training_history
from casadical.project.networks import train_networks, training_material

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def hh800(calibrated):
    """What the command makes of it, networks and all."""
    return calibrated("hh800")


def planted(problem, result, mm: float = 1.0):
    """The problem with a smooth residual added to every reading: a network has something to learn."""

    def moved(m):
        shift = 1e-3 * mm * np.column_stack([np.sin(m.q[:, 0]), np.cos(m.q[:, 0]), np.zeros(len(m))])
        exact = m.position - 1e-3 * residual_mm(result.robot, m)
        return replace(m, position=exact + shift)

    return replace(problem, sets={name: tuple(map(moved, parts)) for name, parts in problem.sets.items()})


def test_all_four_methods_of_the_paper_and_the_best_trainer_run(hh800) -> None:
    networks, errors = hh800.networks, hh800.accuracies
    assert hh800.problem.methods == ("KM", "SKCM")
    assert tuple(networks.results) == tuple(network_methods())
    assert [r.compensator.trainer for r in networks.results.values()] == ["backprop", "iwo", "lm", "iwo-lm", "taught"]
    for r in networks.results.values():
        c = r.compensator
        assert (c.training.before.poses, c.choice.before.poses, c.validation.before.poses) == (50, 50, 50)
        before = errors["SKCM"]["report"]["calibrated"]
        assert c.validation.before.mean_mm == pytest.approx(1e3 * before.mean)
        assert c.helps == (c.choice.gain > max(0, c.choice.gain_error))
        if not r.helps:
            assert {name: a.mean for name, a in r.errors.items()} == pytest.approx(
                {name: states["calibrated"].mean for name, states in errors["SKCM"].items()}
            )


def test_a_planted_residual_is_learnt_and_its_figures_are_those_of_the_corrected_robot(hh800) -> None:
    problem, results = hh800.problem, hh800.identifications
    easy = planted(problem, results["SKCM"])
    seen: list[str] = []
    networks = train_networks(easy, results["SKCM"], ("NN-SKCM",), seed=3, show=seen.append)
    r = networks.results["NN-SKCM"]
    assert r.helps
    m = easy.sets["report"][0]
    corrected = results["SKCM"].predict(m.q)[0] + 1e-3 * r.compensator.correction_mm(m.q)
    left = np.linalg.norm(corrected - m.position, axis=1)
    assert r.errors["report"].mean == pytest.approx(left.mean())
    assert r.errors["report"].max == pytest.approx(left.max())
    assert 1e3 * left.mean() < 0.5 * 1.0
    losses = [float(line.split("loss ")[1].split()[0]) for line in seen]
    assert len(losses) >= 20
    assert losses[-1] < 0.2 * losses[0]


def test_report_has_no_part_in_any_choice(hh800) -> None:
    """Nonsense in the report set changes neither the network nor the decision; in train or choose it does."""
    problem, results = hh800.problem, hh800.identifications
    easy = planted(problem, results["SKCM"])

    def learnt(changed: str | None):
        sets = dict(easy.sets)
        if changed:
            m = sets[changed][0]
            noise = np.random.default_rng(0).normal(0, 0.01, m.position.shape)
            sets[changed] = (replace(m, position=m.position + noise),)
        c = train_networks(replace(easy, sets=sets), results["SKCM"], ("NN-SKCM",)).results["NN-SKCM"].compensator
        return None if c.network is None else c.network.weights.tolist()

    plain = learnt(None)
    assert plain is not None
    assert learnt("report") == plain
    assert learnt("choose") is None
    assert learnt("train") != plain


@pytest.mark.slow
def test_a_large_problem_without_a_set_to_train_on_lends_identified_poses(calibrated) -> None:
    problem, result = calibrated("ur10_joints").problem, calibrated("ur10_joints").identification
    material, words = training_material(problem, result, 0)
    assert "lent" in words
    rows = {name: set(map(tuple, q)) for name, (q, _) in material.items()}
    assert rows["train"] | rows["choose"] <= rows["identify"]
    assert not rows["train"] & rows["choose"]
    assert not rows["report"] & rows["identify"]
    assert len(material["train"][0]) <= 1500
    again, _ = training_material(problem, result, 0)
    assert np.array_equal(material["train"][0], again["train"][0])


@pytest.mark.parametrize(
    ("name", "words"),
    [("planar", "too few to learn"), *slow(("panda_3", "the data are contact"), ("fr3_camera", "too few to learn"))],
)
def test_where_nothing_can_be_learnt_it_says_why(calibrated, name: str, words: str) -> None:
    bare = calibrated(name)
    networks = train_networks(bare.problem, bare.identifications["KM"])
    calibration = replace(bare, networks=networks)
    assert all(words in r.verdict and r.compensator is None and not r.helps for r in networks.results.values())
    text = " ".join(str(calibration).split())
    assert words in text
    assert "after NN-SKCM" not in text
    assert words in calibration.to_json()["networks"]["NN-SKCM"]["verdict"]


@pytest.mark.slow
def test_poses_left_out_as_outliers_are_not_lent(calibrated) -> None:
    problem = calibrated("ur10_joints").problem
    result = replace(calibrated("ur10_joints").identification, outliers=tuple((0, i) for i in range(100)))
    material, _ = training_material(problem, result, 0)
    out = set(map(tuple, result.measurements[0].q[:100]))
    kept = set(map(tuple, result.measurements[0].q[100:]))
    assert not (out - kept) & set(map(tuple, material["train"][0]))
    assert len(material["train"][0]) + len(material["choose"][0]) == len(result.measurements[0]) - 100


def test_compensators_are_kept_as_files_that_load(hh800, tmp_path: Path) -> None:
    hh800.write(tmp_path / "kept")
    for name, r in hh800.networks.results.items():
        assert load_compensator(tmp_path / "kept" / f"{name}.compensator.json").verdict == r.compensator.verdict


def test_a_network_method_brings_the_identification_that_it_needs() -> None:
    found = calibrate(ROOT / "problems" / "planar", method="NN-SKCM")
    assert (tuple(found.identifications), tuple(found.networks.results)) == (("SKCM",), ("NN-SKCM",))
    assert calibrate(ROOT / "problems" / "planar", method="KM").networks is None


def test_json_holds_refusals_settings_and_the_papers_figures(hh800) -> None:
    networks = hh800.networks
    found = json.loads(json.dumps(hh800.to_json(), allow_nan=False))
    assert found["methods"].keys() == {"KM", "SKCM"}
    assert found["networks"].keys() == set(network_methods())
    for name, entry in found["networks"].items():
        r = networks.results[name]
        assert entry["helps"] == r.helps
        assert entry["sets"]["report"]["mean_mm"] == pytest.approx(1e3 * r.errors["report"].mean)
        trained = entry["as_trained"]["report"]["after"]
        assert trained["mean_mm"] == pytest.approx(r.compensator.validation.after.mean_mm)
    assert found["networks"]["IWO-NN-SKCM"]["settings"]["settings"]["maximum"] == 50
    assert found["paper"]["validation"]["IWO-NN-SKCM"] == {"mean_mm": 0.4662, "max_mm": 0.6538, "std_mm": 0.1333}


def test_a_training_of_no_step_is_drawn_at_its_beginning() -> None:
    name, *_ = network_methods()
    trained = SimpleNamespace(helps=True, compensator=SimpleNamespace(history=((0, 2.5),)))
    (drawn,) = training_history(SimpleNamespace(results={name: trained})).series
    assert ([*drawn.x], [*drawn.y]) == ([0.0], [2.5])

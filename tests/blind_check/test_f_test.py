"""The method that the diagnosis is measured against does what the textbook says."""

import json

import numpy as np
import pytest
from checks import ROOT
from numpy_physics import campaign, disturbances

from casadical.blind_check.mujoco_physics import Plant, perturb
from casadical.blind_check.prediction import SIGNIFICANT, Regression, answer_campaign
from casadical.project.problem import read_campaign_robot
from casadical.robot.robot_file import to_toml


def squares(X: np.ndarray, y: np.ndarray) -> float:
    return float(np.sum((y - X @ np.linalg.lstsq(X, y)[0]) ** 2))


def test_gains_are_those_of_least_squares() -> None:
    rng = np.random.default_rng(0)
    A, E, y = rng.normal(size=(60, 4)), rng.normal(size=(60, 7)), rng.normal(size=60)
    A = np.column_stack([A, A[:, 0]])  # a column twice: rank 4
    E[:, 6] = E[:, 5]
    left = Regression(y, E, 60).with_columns(A)
    assert left.freedom == 56
    groups = [np.array([0]), np.array([1, 2]), np.array([5, 6])]
    expected = [squares(A, y) - squares(np.column_stack([A, E[:, g]]), y) for g in groups]
    assert left.gains(groups) == pytest.approx(expected)
    more = left.with_columns(left.E[:, groups[1]])
    assert more.freedom == 54
    both = squares(np.column_stack([A, E[:, [1, 2]]]), y) - squares(np.column_stack([A, E[:, [0, 1, 2]]]), y)
    assert more.gains(groups[:1]) == pytest.approx([both])


def test_a_cause_that_shows_nothing_gains_nothing() -> None:
    E = np.array([[1.0, 0, 0, 2], [0, 0, 0, 0], [0, 0, 1, 0]])
    groups = [np.array(columns) for columns in ([0], [1], [0, 3], [2])]
    np.testing.assert_allclose(Regression(np.array([3.0, 4, 5]), E, 2).gains(groups), [9, 0, 9, 25])


def test_a_group_that_leaves_no_freedom_is_no_finding() -> None:
    rng = np.random.default_rng(6)
    left = Regression(rng.normal(size=5), rng.normal(size=(5, 6)), 5)
    assert left.best([np.arange(5), np.arange(6)])[1] == 1.0
    assert left.best([np.array([0]), np.arange(5)])[0] == 0


def test_among_many_candidates_it_takes_what_is_there_and_no_noise() -> None:
    rng, many = np.random.default_rng(4), 400
    groups = [np.array([k]) for k in range(many)]
    taken = 0
    for _ in range(20):
        E, noise = rng.normal(size=(100, many)), rng.normal(size=100)
        taken += Regression(noise, E, 100).best(groups)[1] < SIGNIFICANT
        best, p = Regression(noise + 2 * E[:, 7], E, 100).best(groups)
        assert (best, p < SIGNIFICANT) == (7, True)
    assert taken <= 1


def test_the_p_value_is_that_of_the_f_distribution() -> None:
    stats = pytest.importorskip("scipy.stats")
    rng = np.random.default_rng(5)
    E, y = rng.normal(size=(50, 3)), rng.normal(size=50)
    none, one = squares(np.zeros((50, 1)), y), squares(E[:, :1], y)
    _, p = Regression(y, E, 50).best([np.array([0])])
    assert p == pytest.approx(stats.f.sf((none - one) / (one / 49), 1, 49))


def test_causes_of_a_campaign_are_named_one_after_the_other() -> None:
    plant = Plant.from_dict(json.loads((ROOT / "data" / "campaigns" / "robots" / "kr210.json").read_text()))
    hidden = [disturbances.GearEccentricity(5, size=4e-4), disturbances.JointScale(3, size=4e-4)]
    table = campaign(perturb(plant, 3), 70, 3, disturbances=hidden, noise_mm=0.02)
    seen, unseen = table[table["pose"] % 5 > 0], table[table["pose"] % 5 == 0]
    model = to_toml(read_campaign_robot(ROOT / "problems" / "kr210"))
    answer = answer_campaign("f-test", "two", model, seen, unseen.drop(columns=["x_mm", "y_mm", "z_mm"]))
    named = [f"{cause['effect']}@{cause['joint']}" for cause in answer["causes"]]
    assert set(named[:2]) == {"gear_eccentricity@5", "joint_scale@3"}
    assert len(set(named)) == len(named)
    assert answer["posterior"] == {named[0]: 1.0}
    shrinks = [cause["shrink"] for cause in answer["causes"]]
    assert 0 < shrinks[0] < shrinks[1]
    assert answer["gap_mm"]["after"] == pytest.approx(answer["gap_mm"]["before"] * (1 - shrinks[-1]), rel=1e-3)
    truth = unseen[["x_mm", "y_mm", "z_mm"]].to_numpy()
    base, better = (
        np.linalg.norm(np.array(answer["unseen"][k]) - truth, axis=1).mean() for k in ("base_mm", "with_causes_mm")
    )
    assert better < 0.6 * base

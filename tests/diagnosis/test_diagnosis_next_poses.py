"""Next poses: the gain against densities written out, better than chance, and a table to take to the robot."""

import io
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from cases import case, robot
from scipy.linalg import block_diag

from casadical import InputError, identify
from casadical.core.linear_gaussian.noise import covariance_of
from casadical.diagnosis.candidates import candidates_of
from casadical.diagnosis.linear_problem import make_case
from casadical.diagnosis.linearisation import linearise
from casadical.diagnosis.next_poses import Comparison, Predictive, causes_in_question, next_poses, predict_cause
from casadical.identification.accuracy import predicted
from casadical.identification.pose_selection import Workspace
from casadical.identification.pose_selection.candidates import draw, later_poses
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import from_table

EFFECTS = ("nonlinear_stiffness@2", "backlash@2", "gear_eccentricity@2", "frame_drift", "thermal_growth")


@pytest.fixture(scope="module")
def doubtful():
    return case("ur10e-P09", *EFFECTS)


def divergences(a: tuple, b: tuple, noise: np.ndarray, poses: list[int]) -> list[float]:
    """Kullback-Leibler divergences of two normal distributions of the poses' data: of b from a, of a from b."""
    mean, cov = [], []
    for expected, root in (a, b):
        rows = root[poses].reshape(3 * len(poses), -1)
        mean.append(expected[poses].ravel())
        cov.append(rows @ rows.T + block_diag(*noise[poses]))
    d, k = mean[0] - mean[1], len(mean[0])

    def kl(S: np.ndarray, T: np.ndarray) -> float:
        logs = np.linalg.slogdet(T)[1] - np.linalg.slogdet(S)[1]
        return 0.5 * (np.trace(np.linalg.solve(T, S)) + d @ np.linalg.solve(T, d) - k + logs)

    return [kl(cov[1], cov[0]), kl(cov[0], cov[1])]


def test_gains_add_up_to_the_expected_log_bayes_factor() -> None:
    rng = np.random.default_rng(0)
    a, b = ((rng.normal(size=(6, 3)), rng.normal(size=(6, 3, k))) for k in (4, 5))
    noise = np.stack([np.eye(3) + 0.3 * v[:, None] * v for v in rng.normal(size=(6, 3))])
    picked: list[int] = []
    one, other = Predictive(*a, noise), Predictive(*b, noise)
    comparisons = (Comparison(one, other), Comparison(other, one))
    total = np.zeros(2)
    for pose in (4, 0, 2, 5):
        total += [comparison.gains()[pose] for comparison in comparisons]
        gains = {model: model.learn(pose) for model in (one, other)}
        for comparison in comparisons:
            comparison.follow(pose, gains[comparison.model])
        picked.append(pose)
        np.testing.assert_allclose(total, divergences(a, b, noise, picked), rtol=1e-9)


def test_table_can_be_taken_to_the_robot(doubtful) -> None:
    table = next_poses(doubtful, 6, ["nonlinear_stiffness@2", "backlash@2"], seed=1, pool=200)
    again = next_poses(doubtful, 6, ["nonlinear_stiffness@2", "backlash@2"], seed=1, pool=200)
    pd.testing.assert_frame_equal(table, again)
    assert {"order", "payload_kg", "approach2", "repeats", "separation", "time_s", "x_mm"} <= set(table)
    assert "approach3" not in table  # neither cause asks for it
    assert set(table["approach2"]) == {-1, 1}
    assert set(table["payload_kg"]) <= {0.0, 10.0}
    assert (table["separation"].diff().dropna() > 0).all()
    q = np.deg2rad(table[[f"q{i}_deg" for i in range(1, 7)]].to_numpy())
    own = doubtful.m.q
    assert (q >= own.min(axis=0) - 1e-6).all()
    assert (q <= own.max(axis=0) + 1e-6).all()
    text = io.StringIO(table.to_csv(index=False))
    filled = pd.read_csv(text).assign(x_mm=1.0, y_mm=2.0, z_mm=3.0, time_s=np.arange(6.0), temperature_degC=21.0)
    assert len(from_table(filled, 6)) == 6


@pytest.mark.parametrize(
    "labels", [["nonlinear_stiffness@2", "backlash@2"], ["frame_drift", "thermal_growth"], ["backlash@2", "none"]]
)
def test_chosen_poses_tell_more_than_random_ones(doubtful, labels: list[str]) -> None:
    best = next_poses(doubtful, 8, labels, against=(), pool=400)["separation"].iloc[-1]
    causes = causes_in_question(doubtful, labels)
    least = causes[0].noise
    effects = tuple(dict.fromkeys(e for cause in causes for e in cause.variant))
    columns = dict.fromkeys((*doubtful.robot.conditions, *(c for e in effects for c in e.conditions)))
    pool = later_poses(doubtful.robot, doubtful.m, doubtful.inliers, columns, 400, 5)[0]
    there = linearise(doubtful.given, pool, doubtful.values)
    found = [(cause.label, predict_cause(doubtful, cause.variant, least, there)) for cause in causes]
    noise = covariance_of(there.Jq, least.repeatability, least.sigma)
    rng = np.random.default_rng(0)
    chance = [rng.choice(len(pool), 8, replace=False).tolist() for _ in range(40)]
    pairs = [(p, r) for a, p in found for b, r in found if a < b]
    drawn = [min(min(divergences(p, r, noise, poses)) for p, r in pairs) for poses in chance]
    assert best > 1.5 * np.mean(drawn)
    assert best > np.max(drawn)


@pytest.fixture(scope="module")
def poor():
    """A campaign without payload, joint 1 in a small range, approached from one side, the arm hardly warm."""
    rng = np.random.default_rng(3)
    r = robot("ur10e")
    q = draw(r, 40, Workspace(*np.deg2rad([[-30, -170, -90, -90, -90, -90], [30, -20, 90, 90, 90, 90]])), rng)
    columns = {f"approach{j}": np.ones(40) for j in range(1, 7)}
    columns |= {"payload_kg": np.zeros(40), "time_s": 30.0 * np.arange(40), "temperature_degC": np.linspace(20, 21, 40)}
    m = Measurements(q=q, kind="position", position=np.zeros((40, 3)), conditions=columns)
    seen, _ = predicted(r, m)
    table = replace(m, position=seen + 2e-5 * rng.normal(size=seen.shape))
    names = ("joint_scale@1", "gear_eccentricity@1", "backlash@2", "friction_windup@2", "thermal_growth", "frame_drift")
    return make_case(identify(r, table, priors=True), candidates_of(r, names))


@pytest.mark.parametrize(
    ("labels", "news"),
    [
        (["joint_scale@1", "gear_eccentricity@1"], "range of q1"),
        (["backlash@2", "friction_windup@2"], "approach2 -1"),
        (["backlash@2", "friction_windup@2"], "payload 10 kg"),
        (["thermal_growth", "frame_drift"], "arm warmed up by 5 K"),
    ],
)
def test_what_the_campaign_had_not_is_asked_for(poor, labels: list[str], news: str) -> None:
    table = next_poses(poor, 6, labels, pool=300)
    assert table["new"].str.contains(news, regex=False).any()


def test_only_what_the_room_and_the_payloads_allow(poor) -> None:
    room = Workspace(*np.deg2rad([[-60, -170, -90, -90, -90, -90], [60, -20, 90, 90, 90, 90]]))
    table = next_poses(poor, 6, ["joint_scale@1", "gear_eccentricity@1"], workspace=room, payloads=(0.0, 2.0), pool=300)
    assert table["q1_deg"].abs().between(30, 60).any()
    assert table["q1_deg"].abs().max() <= 60
    assert set(table["payload_kg"]) <= {0.0, 2.0}


def test_loop_stays_as_open_as_it_was() -> None:
    c = case("hh800-P01", "backlash", "friction_windup")
    table = next_poses(c, 5, ["backlash@5", "friction_windup@5"], pool=300)
    margin = c.robot.model.at_declared("loop", ("margin",))
    values = c.robot.parameters.values
    q = np.deg2rad(table[[f"q{i}_deg" for i in range(1, 7)]].to_numpy())
    least = margin.map(len(c.m))(c.m.q.T, values).full().min()
    assert margin.map(len(q))(q.T, values).full().min() >= least - 1e-4


@pytest.mark.parametrize("labels", [["backlash@2"], ["backlash@2", "backlash@2"], ["backlash@2", "hose"]])
def test_bad_labels(doubtful, labels: list[str]) -> None:
    with pytest.raises(InputError):
        next_poses(doubtful, 3, labels)

"""A diagnosis that knows what an earlier campaign of the robot found, and says what of it changed."""

from dataclasses import replace

import numpy as np
import pytest
from cases import diagnose, robot

from casadical import Measurements, identify
from casadical.core.transforms import frame, from_rpy
from casadical.diagnosis.refit import refit
from casadical.diagnosis.text import as_json, page_of
from casadical.effects import JointErrorCurve
from casadical.identification.accuracy import errors, predicted

NOISE = 2e-5
SIZE = 2e-4
CURVE = JointErrorCurve(None, (0.0, SIZE, SIZE, 0.0, 0.0, 0.0), 4, 17)
CANDIDATES = ["backlash", "gear_eccentricity", "frame_drift"]


def measured(built, poses, seed, name):
    rng = np.random.default_rng(seed)
    lower, upper = np.array([(j.lower, j.upper) for j in built.joints]).T
    q = rng.uniform(lower, upper, (poses, 6))
    m = Measurements(q=q, kind="position", position=np.zeros((poses, 3)), source=name)
    return replace(m, position=predicted(built, m)[0] + NOISE * rng.normal(size=(poses, 3)))


def curves(seed):
    rng = np.random.default_rng(seed)
    return {p.name: SIZE * rng.normal() for p in CURVE.parameters()}


@pytest.fixture(scope="module")
def built():
    return robot("ur10e").with_effect(CURVE).with_values({**curves(3), "a2": robot("ur10e").parameters["a2"].value})


@pytest.fixture(scope="module")
def first(built):
    m = measured(built, 120, 1, "first.csv")
    return identify(robot("ur10e").with_effect(CURVE), m, ("kinematic", "compliance", CURVE.label), priors=True).robot


def elsewhere(built):
    T = frame(from_rpy(np.array([0.1, -0.2, 2.0])), np.array([0.7, -1.5, 0.3]))
    return replace(built, base=replace(built.base, T=T))


@pytest.mark.slow
def test_what_is_known_and_did_not_change_is_no_cause(built, first):
    m = measured(elsewhere(built), 40, 2, "second.csv")
    found = diagnose(robot("ur10e"), m, CANDIDATES, prior=first)
    assert found.verdict == "none"
    assert [(c.effect, c.joint) for c in found.changes] == [(CURVE.label, 2), (CURVE.label, 3)]
    assert max(c.probability for c in found.changes) < 0.1
    assert found.gap.before < 3 * NOISE
    page = page_of(found)
    assert "PRIOR    from first.csv: joint_error_curve" in page
    assert "joint_error_curve, joint 3: changed since then with probability 0.0" in page
    answer = as_json(found, "second")["prior"]
    assert answer["campaign"] == "first.csv"
    assert [c["joint"] for c in answer["changed"]] == [2, 3]
    assert errors(refit(found.case, (), found.noise).robot, measured(elsewhere(built), 200, 9, "")).mean() < 4 * NOISE


@pytest.mark.slow
def test_a_joint_with_another_gear_is_named(built, first):
    """Joint 3 has another curve; joint 2 is still known, and nothing else is claimed."""
    other = {name: value for name, value in curves(7).items() if name.endswith("q3")}
    m = measured(elsewhere(built.with_values(other)), 60, 4, "second.csv")
    found = diagnose(robot("ur10e"), m, CANDIDATES, prior=first)
    probability = {c.joint: c.probability for c in found.changes}
    assert probability[3] > 0.99
    assert probability[2] < 0.1
    assert found.verdict == "none"
    assert found.gap.before < 4 * NOISE
    assert "joint 3: changed since then with probability 1.00; taken as new" in " ".join(page_of(found).split())

"""What changed since a reference: planted changes of a servo are found with their factor, another day is none."""

from dataclasses import replace

import numpy as np
import pytest

from casadical import Body, Joint, Robot
from casadical.core.telling.result import plain_text
from casadical.diagnosis.motion.change import changes_since, clear_changes
from casadical.diagnosis.motion.result import diagnose_log
from casadical.measurements.logs.log import JointLog
from casadical.robot.dynamics import Dynamics

BODY = Body(0.5, np.array([0.15, 0.0, 0.0]), np.diag([1e-3, 1e-3, 1e-3]))
ARM = Robot(name="two servos", joints=(Joint(alpha=np.pi / 2, body=BODY, name="a"), Joint(a=0.25, body=BODY, name="b")))
STEP, FINE, SECONDS = 0.02, 5e-4, 14.0
ONES = np.ones(2)


def log_of(seed, gain=ONES, dry=ONES, damping=ONES, late=ONES):
    """A log of explicit small steps with dry friction as an impulse (Moreau); arguments are factors on the servo."""
    rng, t = np.random.default_rng(seed), FINE * np.arange(round(SECONDS / FINE))
    w, phase = rng.uniform(0.4, 2.5, (3, 2, 1)), rng.uniform(0, 6, (3, 2, 1))
    command = 0.3 * np.sin(w * t + phase).sum(axis=0).T
    load = Dynamics(ARM).torque(command, *[np.zeros_like(command)] * 2)
    kp, dry, damping, inertia = [12.0, 8.0] * gain, [0.5, 0.3] * dry, [0.9, 0.4] * damping, np.array([0.03, 0.015])
    back, q, v, out = (0.03 * late / FINE).round().astype(int), command[0].copy(), np.zeros(2), np.empty_like(command)
    for k in range(len(t)):
        wanted = command[np.maximum(0, k - back), [0, 1]]
        v = v + FINE * (kp * (wanted - q) - damping * v - load[k]) / inertia
        v = np.sign(v) * np.maximum(np.abs(v) - FINE * dry / inertia, 0.0)
        q = q + FINE * v
        out[k] = q
    rows = slice(None, None, round(STEP / FINE))
    noise = rng.normal(0, 5e-4, out[rows].shape)
    return JointLog(t[rows], ("a", "b"), out[rows] + noise, command[rows], source=f"run {seed}")


@pytest.fixture(scope="module")
def reference():
    return log_of(1)


def clear(log, reference):
    return [*clear_changes(changes_since(ARM, log, ARM, reference))]


def test_dry_friction_that_has_grown_is_told_and_another_day_is_not(reference):
    assert not clear(log_of(2, dry=np.array([0.9, 1.1]), damping=np.array([1.1, 0.9])), reference)
    found = diagnose_log(ARM, log_of(2, dry=np.array([3.0, 1.1])), reference)
    (change,) = found.changed
    assert (change.effect, change.alike, change.joint) == ("coulomb_friction", ("load_friction",), 1)
    assert change.factor == pytest.approx(3.0, rel=0.15)
    told = " ".join(plain_text(found.blocks(), 200).split())
    assert "joint 1: dry friction x" in told
    assert "No cause is named" in told
    assert found.to_json()["causes"] == []
    assert found.to_json()["changes"][0]["clear"]
    assert found.verdict == "unknown"
    assert not replace(found, changes=()).changed


@pytest.mark.slow
@pytest.mark.parametrize(("name", "value", "effect", "joint", "factor"), [
    ("gain", [1.0, 0.5], "servo_stiffness", 2, 0.5), ("late", [5.0, 5.0], "transport_delay", None, 5.0),
    ("damping", [1.0, 3.0], "viscous_friction", 2, 3.0),
])  # fmt: skip
def test_gain_delay_and_damping_are_told(reference, name, value, effect, joint, factor):
    change, *more = clear(log_of(2, **{name: np.array(value)}), reference)
    assert (change.effect, change.joint) == (effect, joint)
    assert change.factor == pytest.approx(factor, rel=0.3)
    assert not more


@pytest.mark.slow
def test_a_response_that_does_not_fit_its_own_log_says_nothing(reference):
    log = log_of(2)
    noise = np.random.default_rng(0).normal(0, 0.5, len(log))
    shaken = replace(log, position=log.position + np.column_stack([noise, 0 * noise]))
    assert {change.joint for change in changes_since(ARM, shaken, ARM, reference)} == {2}

"""What a log with torques tells of bodies, against the known base parameters of a planar arm; contradicted models."""

from dataclasses import replace

import numpy as np
import pytest

from casadical import Body, Joint, Robot
from casadical.core.drive import Drive
from casadical.identification.inertial import contradictions, determined
from casadical.measurements.logs.log import JointLog
from casadical.robot.dynamics import Dynamics

T = np.arange(0, 20, 0.008)
BODY = Body(3.0, np.array([0.2, 0.03, 0.0]), np.diag([0.01, 0.06, 0.06]))
ROWS = (
    Joint(body=BODY, name="a"),
    Joint(alpha=np.pi / 2, a=0.1, body=BODY, name="b"),
    Joint(a=0.4, body=BODY, name="c"),
    Joint(alpha=-np.pi / 2, a=0.3, body=BODY, name="d"),
)
ARM = Robot("four", ROWS, drive=Drive(gear_ratio=100.0, torque_constant_Nm_per_A=0.1, rotor_inertia_kgm2=1e-5))


def motion(n, t=T, size=0.8):
    rng = np.random.default_rng(1)
    size, rate, start = size * rng.uniform(0.5, 1, (2, n)), rng.uniform(0.5, 3, (2, n)), rng.uniform(0, 6, (2, n))
    angle = rate * t[:, None, None] + start
    waves = ((np.sin, 1), (np.cos, 1), (np.sin, -1))
    return [(size * rate**k * f(angle)).sum(axis=1) * sign for k, (f, sign) in enumerate(waves)]


def log_of(robot, channel="torque", friction=0.5, **changes):
    """A log of the arm with Coulomb and viscous friction, a model 5 % off, and noise."""
    q, v, a = motion(robot.n)
    truth = Dynamics(robot)
    pi = truth.values * (1 + 0.05 * np.random.default_rng(2).normal(size=len(truth.values)))
    tau = truth.torque(q, v, a, pi) + friction * np.tanh(v / 0.01) + 0.3 * v
    tau += np.random.default_rng(3).normal(0, 0.05, tau.shape)
    names = tuple(joint.name or f"j{k}" for k, joint in enumerate(robot.joints))
    return JointLog(T, names, **({"position": q, channel: tau} | changes))


def test_base_parameters_of_a_planar_arm_are_the_known_ones() -> None:
    """Khalil and Dombre 2002, chapter 9: seven of 22; the second mass acts through the first link's moments."""
    rows = (Joint(body=BODY), Joint(a=0.4, body=BODY))
    planar = Robot("planar", rows, gravity=np.array([0.0, -9.81, 0.0]))
    found = determined(planar, log_of(planar))
    assert set(found.independent) == {"m2", "mx2", "my2", "Izz2", "mx1", "my1", "Ia2"}
    held = found.unidentifiable
    assert held["Ixx2"] == "it has no effect on what was measured"
    assert held["Izz1"].startswith("it loads the joints exactly as m2, mx1 do together")
    assert held["Ia1"] == held["Izz1"]


def test_count_of_base_parameters_is_the_rank_of_random_states() -> None:
    dynamics, rng = Dynamics(ARM), np.random.default_rng(0)
    q, v, a = rng.normal(size=(3, 400, 4))
    rank = np.linalg.matrix_rank(dynamics.regressor(q, v, a).reshape(-1, 44), tol=1e-8)
    assert len(determined(ARM, log_of(ARM)).independent) == rank


def test_joints_that_rest_determine_less() -> None:
    log = log_of(ARM)
    first = np.array([1, 0, 0, 0.0])
    q, v, a = np.random.default_rng(0).normal(size=(3, 400, 4)) * first
    rank = np.linalg.matrix_rank(Dynamics(ARM).regressor(q, v, a).reshape(-1, 44), tol=1e-8)
    found = determined(ARM, replace(log, position=log.position * first))
    assert len(found.independent) <= rank < 12  # moments that rest are offsets of the joints
    assert found.unidentifiable["Ia4"] == "it has no effect on what was measured"


def test_of_two_parameters_that_load_alike_the_mass_is_told() -> None:
    """Of the second body, held still and turned about an upright axis, two of mass, first moment and inertia show."""
    upright = Robot("upright", (Joint(body=BODY), Joint(a=0.4, body=BODY)))
    log = log_of(upright)
    found = determined(upright, replace(log, position=log.position * [1, 0]))
    assert {"m2", "mx2"} <= set(found.independent)
    assert "Izz2" in found.unidentifiable


def test_nothing_is_determined_without_a_signed_torque() -> None:
    log = log_of(ARM, "current")
    assert determined(ARM, replace(log, current=np.abs(log.current), current_unsigned=True)) is None
    assert determined(ARM, replace(log, current=None, command=log.position)) is None


def test_a_good_log_contradicts_nothing() -> None:
    assert contradictions(ARM, log_of(ARM)) == ()
    assert contradictions(ARM, log_of(ARM, "current")) == ()


SIGNS = {"b": np.array([1, -1, 1, 1.0]), "c": np.array([1, 1, -1, 1.0])}


@pytest.mark.parametrize("name", ["b", "c"])
def test_a_joint_that_counts_the_other_way(name) -> None:
    log = log_of(ARM)
    turned = replace(log, position=SIGNS[name] * log.position, torque=SIGNS[name] * log.torque)
    (said,) = contradictions(ARM, turned)
    assert said.startswith(f"{name} counts the other way than the model, torque included: so the model explains ")
    assert "Turn the sign" in said


@pytest.mark.parametrize("name", ["b", "c"])
def test_a_torque_against_its_angle(name) -> None:
    log = log_of(ARM)
    said = contradictions(ARM, replace(log, torque=SIGNS[name] * log.torque))
    assert said[0].startswith(f"the torque or current of {name} counts against its angle")


def test_friction_alone_tells_a_torque_against_its_angle() -> None:
    """Of the last joint, which carries little load."""
    log = log_of(ARM, friction=3.0)
    said = contradictions(ARM, replace(log, torque=log.torque * np.array([1, 1, 1, -1.0])))
    assert any(each.startswith("the torque or current of d counts against its angle") for each in said)


def test_joints_in_each_others_columns() -> None:
    log = log_of(ARM)
    order = [0, 2, 1, 3]
    said = contradictions(ARM, replace(log, position=log.position[:, order], torque=log.torque[:, order]))
    assert said[0].startswith("b and c stand in each other's columns: so the model explains ")


def test_what_a_robot_file_lacks_is_said_with_what_is_told_all_the_same() -> None:
    log = log_of(ARM, "current")
    (said,) = contradictions(replace(ARM, drive=None), log)
    assert "no gear ratio or torque constant is known: friction and its causes are identified in ampere" in said
    bare = replace(ARM, joints=tuple(replace(joint, body=None) for joint in ARM.joints))
    (said,) = contradictions(bare, log)
    assert "'four' states no masses: estimates from its reach stand in their place, so friction, delay and play" in said
    plain = replace(ARM, joints=tuple(replace(j, body=replace(BODY, inertia=None)) for j in ARM.joints))
    assert any("inertias of links 1, 2, 3, 4 are unknown" in each for each in contradictions(plain, log))
    narrow = replace(ARM, joints=(replace(ROWS[0], lower=-0.2, upper=0.2), *ROWS[1:]))
    said = " ".join(contradictions(narrow, log))
    assert "a reads -" in said
    assert "its range is -0.2 to 0.2 rad" in said


def test_torques_at_the_motors_side() -> None:
    log = log_of(ARM)
    (said,) = contradictions(ARM, replace(log, torque=log.torque / 100))
    assert said.startswith("torques are 0.01")
    assert "at the motor's side of the gears" in said
    assert "Multiply the columns by the gear ratio" in said

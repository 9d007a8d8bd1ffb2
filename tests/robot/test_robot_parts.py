"""Seams, nested loops, peak torques and written limits of small arms that are computed here by hand."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numeric_arm import shift, turn

from casadical import Body, FourBar, InputError, Joint, Placement, Robot
from casadical.effects import Effect
from casadical.robot.kinematics import link_frames
from casadical.robot.robot import MIN_TORQUE_OF_LARGEST
from casadical.robot.urdf import new_urdf

RIGHT = np.pi / 2


@dataclass(frozen=True)
class Everywhere(Effect):
    """One parameter at each seam."""

    name = "everywhere"
    size = dict.fromkeys(("spring", "turn", "link", "base", "tool", "seen"), (0.001, ""))

    def energy(self, context: Any) -> Any:
        return 0.5 * self.value(context, "spring") * context.q[1] ** 2

    def angle(self, context: Any, q: Any) -> Any:
        return self.value(context, "turn") * q

    def link(self, number: int, context: Any) -> Any:
        T = ca.SX.eye(4)
        if number == 1:
            T[2, 3] = self.value(context, "link")
        return T

    def base(self, context: Any) -> Any:
        T = ca.SX.eye(4)
        T[1, 3] = self.value(context, "base")
        return T

    def tool(self, context: Any) -> Any:
        T = ca.SX.eye(4)
        T[0, 3] = self.value(context, "tool")
        return T

    def measurement(self, point: Any, context: Any) -> Any:
        return point * (1 + self.value(context, "seen"))


@dataclass(frozen=True)
class Again(Everywhere):
    name = "again"


@pytest.mark.parametrize("name", ["base_x", "a1", "everywhere@2.turn"])
def test_values_are_finite(name: str) -> None:
    robot = replace(elbow(), base=Placement(np.eye(4), "pose")).with_effect(Everywhere(2))
    with pytest.raises(InputError, match="finite"):
        robot.with_values({name: np.nan})


def elbow() -> Robot:
    """A vertical axis and a horizontal one that is a spring, without masses."""
    joints = (Joint(d=0.3, lower=-3, upper=3), Joint(alpha=RIGHT, lower=-2, upper=2, compliance=1e-3))
    return Robot("elbow", joints, tool=Placement(shift(0.5, 0.0, 0.0)))


def by_hand(q: np.ndarray, v: dict[str, float]) -> np.ndarray:
    """The point that is measured. The spring turns joint 2 by its torque, -k q, at the pose that it has turned to."""
    v = {**dict.fromkeys(("spring", "turn", "link", "base", "tool", "seen"), 0.0), **v}
    # tau = -k q is taken where one step of the deflection has led (see `gravity_torques`).
    sunk = q[1] - 1e-3 * v["spring"] * q[1]
    angle = q[1] - 1e-3 * v["spring"] * sunk + v["turn"] * q[1]
    T = shift(0, v["base"], 0) @ turn("z", q[0]) @ shift(0, 0, 0.3 + v["link"]) @ turn("x", RIGHT) @ turn("z", angle)
    return (T @ [0.5 + v["tool"], 0, 0, 1])[:3] * (1 + v["seen"])


def position(arm: Robot, q: np.ndarray) -> np.ndarray:
    return np.asarray(arm.model.function("position", ("p",))(q, [], arm.parameters.values)).ravel()


READINGS = np.array([[0.3, 0.7], [-1.2, -0.4], [2.0, 1.5]])


@pytest.mark.parametrize("seam", [*Everywhere.size])
def test_every_seam_moves_the_point_as_it_says(seam: str) -> None:
    effect = Everywhere(2)
    size = 40.0 if seam == "spring" else 0.02
    arm = elbow().with_effect(effect).with_values({f"{effect.label}.{seam}": size})
    expected = [by_hand(q, {seam: size}) for q in READINGS]
    np.testing.assert_allclose([position(arm, q) for q in READINGS], expected, rtol=0, atol=1e-12)
    assert np.abs(np.array(expected) - [by_hand(q, {}) for q in READINGS]).max() > 1e-3


def test_effects_of_one_seam_add_up() -> None:
    one, two = Everywhere(2), Again(2)
    values = {f"{one.label}.turn": 0.01, f"{two.label}.turn": 0.02, f"{one.label}.seen": 0.1, f"{two.label}.seen": 0.2}
    arm = elbow().with_effect(one, two).with_values(values)
    assert repr(arm).endswith("parameters, with everywhere@2, again@2>")
    assert repr(elbow()).endswith("parameters>")
    expected = by_hand(READINGS[0], {"turn": 0.03}) * 1.1 * 1.2
    np.testing.assert_allclose(position(arm, READINGS[0]), expected, rtol=0, atol=1e-12)


def test_an_upright_joint_has_the_gear_of_a_twentieth() -> None:
    """Gravity does not turn a vertical axis; the horizontal one bears up to mass, arm and gravity."""
    joints = (Joint(lower=-3, upper=3), Joint(alpha=RIGHT, lower=-3, upper=3, body=Body(4.0, np.array([0.5, 0, 0]))))
    great = Robot("arm", joints, tool=Placement(np.eye(4))).torque_scale
    assert great[1] == pytest.approx(4 * 9.81 * 0.5, rel=0.02)
    assert great[0] == pytest.approx(MIN_TORQUE_OF_LARGEST * great[1])
    rail = Joint(kind="prismatic", lower=0, upper=1, body=Body(50.0, np.zeros(3)))
    lifted = Robot("lift", (rail, *joints), tool=Placement(np.eye(4))).torque_scale
    assert lifted[1] == pytest.approx(MIN_TORQUE_OF_LARGEST * lifted[2])  # N m and N are not compared
    level = Robot("rail", (replace(rail, alpha=RIGHT), *joints), tool=Placement(np.eye(4))).torque_scale
    assert level[0] == pytest.approx(
        MIN_TORQUE_OF_LARGEST**2 * 54 * 9.81, rel=0.01
    )  # was 5e-11: round-off over it was a load
    bare = Robot("arm", tuple(replace(j, body=None) for j in joints), tool=Placement(np.eye(4)))
    assert (bare.torque_scale > 0).all()  # something to divide by
    upright = tuple(replace(j, alpha=0.0, a=0.8) for j in joints)
    scara = Robot("scara", upright, tool=Placement(np.eye(4)))
    # Torques of a base that leans by a degree were 1e9 times the great ones: 400 km of a friction's wind-up.
    assert scara.torque_scale == pytest.approx([MIN_TORQUE_OF_LARGEST**2 * 4 * 9.81 * 1.6] * 2, rel=0.01)


def nested(theta: tuple[float, float] = (0.0, 0.0)) -> Robot:
    """Two loops in a plane; the second one's ground bar is on the link that the first one drives."""
    bars = {"crank": 0.42, "coupler": 0.78, "rocker": 0.4}
    joints = (
        Joint(lower=-0.5, upper=0.5),
        Joint(a=0.8, lower=1.2, upper=1.8, theta=theta[0]),
        Joint(a=0.8, lower=2.6, upper=3.0, theta=theta[1]),
    )
    loops = (FourBar(driven=2, carrier=1, **bars), FourBar(driven=3, carrier=2, **bars))
    return Robot("nested", joints, loops=loops, tool=Placement(np.eye(4)))


@pytest.mark.parametrize("theta", [(0.0, 0.0), (0.05, -0.08)])
def test_nested_loops_close_with_the_cranks_that_theta_turns(theta: tuple[float, float]) -> None:
    robot = nested(theta)
    values = dict(zip(robot.parameters.names, robot.parameters.values, strict=True))
    q = np.array([0.2, 1.5, 2.9])
    turned = [np.arctan2(float(T[1, 0]), float(T[0, 0])) for T in link_frames(robot, list(q), values)]
    for k, frame in ((1, 0.0), (2, turned[0])):  # the first loop as the base sees it, the second as link 1 does
        crank = 0.42 * np.exp(1j * (q[k] + theta[k - 1]))
        ground, rocker = (np.exp(1j * (turned[at] - frame)) for at in (k - 1, k))
        assert abs(crank - 0.8 * ground - 0.4 * rocker) == pytest.approx(0.78, abs=1e-9)


def test_a_nested_loop_is_assembled_on_the_link_as_it_stands() -> None:
    """At mid range the first loop turns its link by -5 deg, far from the reading of its crank, -38 deg."""
    joints = (Joint(lower=-0.5, upper=0.5), Joint(a=0.8, lower=5.57, upper=5.67), Joint(a=0.8, lower=2.84, upper=2.94))
    loops = (FourBar(driven=2, carrier=1, crank=0.86, coupler=0.71, rocker=0.39),
             FourBar(driven=3, carrier=2, crank=0.36, coupler=0.53, rocker=0.95))  # fmt: skip
    robot = Robot("nested", joints, loops=loops, tool=Placement(np.eye(4)))
    values = dict(zip(robot.parameters.names, robot.parameters.values, strict=True))
    turned = [np.arctan2(float(T[1, 0]), float(T[0, 0])) for T in link_frames(robot, [0.0, 5.62, 2.89], values)]
    ground, rocker = turned[1] - turned[0], turned[2] - turned[0]
    between = 0.36 * np.exp(2.89j) - 0.8 * np.exp(1j * ground)
    opened = np.arccos((abs(between) ** 2 + 0.95**2 - 0.53**2) / (2 * abs(between) * 0.95))
    both = np.angle(np.exp(1j * (np.angle(between) + np.array([opened, -opened]) - 2.89)))  # against the crank
    uncrossed = both[np.argmin(np.abs(both))]
    assert np.angle(np.exp(1j * (rocker - 2.89))) == pytest.approx(uncrossed, abs=1e-9)


def test_a_urdf_has_the_limits_and_the_tool_of_the_robot() -> None:
    joints = (Joint(lower=-1.25, upper=2.5), Joint(alpha=RIGHT, kind="prismatic", lower=-0.1, upper=0.4))
    tool = shift(0.1, 0.2, 0.3) @ turn("z", 0.4)
    root = ET.fromstring(new_urdf(Robot("two", joints, tool=Placement(tool))))
    limits = [(float(x.get("lower", "")), float(x.get("upper", ""))) for x in root.iter("limit")]
    assert limits == [(-1.25, 2.5), (-0.1, 0.4)]
    origin = root.findall("joint")[-1].find("origin")
    assert origin is not None
    assert [float(v) for v in origin.get("xyz", "").split()] == pytest.approx([0.1, 0.2, 0.3])
    assert [float(v) for v in origin.get("rpy", "").split()] == pytest.approx([0, 0, 0.4])

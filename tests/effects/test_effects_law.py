"""Laws given as text: what each place does to the robot, by another way; files; what is refused."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from bench import campaign, robot, with_columns
from scipy.spatial.transform import Rotation

from casadical.core.basics import InputError
from casadical.core.parts import Body, Joint
from casadical.diagnosis.linearisation import signatures
from casadical.effects import BearingPlay, Law, LinkMasses, PayloadError
from casadical.effects.definition import hardening_spring
from casadical.effects.formula_effect import grown_link
from casadical.export.mjcf.mjcf import counterparts
from casadical.export.omission import left_out
from casadical.identification.accuracy import predicted
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements, unmeasured
from casadical.robot.robot import Robot
from casadical.robot.robot_file import read_robot, write_robot

NAME = "ur10e"
VECTOR = (("a", 3e-5), ("b", 3e-5), ("c", 3e-5))


def with_law(law: Law, *values: float) -> Robot:
    names = [p.name for p in law.parameters()]
    return robot(NAME).with_effect(law).with_values(dict(zip(names, values, strict=True)))


def shift(law: Law, *values: float) -> np.ndarray:
    poses = with_columns(campaign(NAME)[:30], [law])
    return predicted(with_law(law, *values), poses)[0] - predicted(robot(NAME), poses)[0]


def rotation(name: str) -> np.ndarray:
    return robot(name).base.T[:3, :3]


def turned(joint: int, angle: np.ndarray) -> np.ndarray:
    """What a wrong reading of one joint does, to 1e-2 or so, for torques change with it."""
    poses = campaign(NAME)[:30]
    q = poses.q.copy()
    q[:, joint - 1] += angle
    return predicted(robot(NAME), replace(poses, q=q))[0] - predicted(robot(NAME), poses)[0]


def test_a_law_of_a_joint_adds_to_its_reading() -> None:
    poses = campaign(NAME)[:30]
    law = Law(3, "joint", "a * max(0, abs(q2) - 0.4) + b * payload * q5**2", (("a", 3e-5), ("b", 3e-5)))
    assert law.conditions == ("payload_kg",)
    angle = 4e-4 * np.maximum(0, np.abs(poses.q[:, 1]) - 0.4)
    angle += 1e-5 * poses.conditions["payload_kg"] * poses.q[:, 4] ** 2
    expected = turned(3, angle)
    np.testing.assert_allclose(shift(law, 4e-4, 1e-5), expected, rtol=0, atol=1e-2 * np.abs(expected).max())


def test_the_tilt_of_a_link_about_its_own_axis_is_its_joints_angle() -> None:
    same = Law(4, "joint", "a * sin(3*q4)"), Law(4, "tilt", "[0, 0, a] * sin(3*q4)")
    np.testing.assert_allclose(shift(same[0], 2e-4), shift(same[1], 2e-4), rtol=0, atol=1e-11)
    assert np.abs(shift(same[0], 2e-4)).max() > 1e-5


def test_every_joint_follows_its_own_driver() -> None:
    law = Law(None, "joints", "a * sin(5*q)")
    alone = sum(turned(j, 1e-5 * j * np.sin(5 * campaign(NAME).q[:30, j - 1])) for j in range(1, 7))
    found = shift(law, *(1e-5 * j for j in range(1, 7)))
    np.testing.assert_allclose(found, alone, rtol=0, atol=1e-2 * np.abs(alone).max())


def test_the_foot_moves_everything_with_time() -> None:
    poses = with_columns(campaign(NAME)[:30], [Law(None, "base shift", "[a, b, c] * t", VECTOR)])
    law = Law(None, "base shift", "[a, b, c] * step(t - 0.5)", VECTOR)
    when = (poses.conditions["progress"] > 0.5)[:, None]
    found = shift(law, 1e-4, 2e-4, -3e-4)
    np.testing.assert_allclose(found, when * (rotation(NAME) @ [1e-4, 2e-4, -3e-4]), rtol=0, atol=1e-12)


def test_the_beam_moves_points_along_it() -> None:
    station = (3.0, 1.0, 0.5)
    law = Law(None, "beam", "a * sin(6*r)", station=station)
    p = predicted(robot(NAME), campaign(NAME)[:30])[0]
    way = p - station
    r = np.linalg.norm(way, axis=1, keepdims=True)
    np.testing.assert_allclose(shift(law, 1e-4), way / r * 1e-4 * np.sin(6 * r), rtol=0, atol=1e-12)
    assert law.of_measurement


def test_an_instrument_whose_place_is_not_given_stands_in_the_origin() -> None:
    p = predicted(robot(NAME), campaign(NAME)[:30])[0]
    np.testing.assert_allclose(shift(Law(None, "beam", "a * r"), 1e-4), 1e-4 * p, rtol=0, atol=1e-12)


def test_a_link_that_grows_moves_its_end_along_itself() -> None:
    frames = [np.eye(4), np.eye(4)]
    for k, T in enumerate(frames):
        T[:3, :3], T[:3, 3] = Rotation.from_euler("xyz", [0.3 + k, -0.2, 0.5]).as_matrix(), [0.1 + k, 0.4, -0.2 * k]
    context = SimpleNamespace(frames=[ca.SX(T) for T in frames])
    for number, before in ((1, np.eye(4)), (2, frames[0])):
        here, expected = frames[number - 1], np.eye(4)
        expected[:3, 3] = 1e-3 * here[:3, :3].T @ (here[:3, 3] - before[:3, 3])
        np.testing.assert_allclose(ca.evalf(grown_link(number, context, ca.SX(1e-3))).full(), expected, atol=1e-15)


def test_a_hardening_spring_is_fitted_by_least_squares() -> None:
    made: dict[str, float] = {}
    simulator = SimpleNamespace(peak_torque=lambda joint: 500.0, drive=lambda joint: SimpleNamespace(compliance=4e-7))
    simulator.with_drive = lambda effect, spring, **numbers: made.update(numbers)
    hardening_spring(SimpleNamespace(joint=2, label="spring"), simulator, {"bend": 3e-5})
    load = np.linspace(-1.2, 1.2, 97)
    d = (2e-4 * load - 3e-5 * load**3) / 1e-4  # in tenths of a milliradian
    k1, k3 = np.linalg.lstsq(np.column_stack([d, d**3]), 500.0 * load, rcond=None)[0]
    assert (made["k1"], made["k3"]) == pytest.approx((k1 * 1e4, k3 * 1e12), rel=1e-9)


def test_laws_are_no_candidates_of_their_own() -> None:
    assert [*Law.candidates(robot(NAME))] == []


def test_the_head_moves_points_across_the_beam_by_the_sense_of_its_last_turn() -> None:
    station = (3.0, 1.0, 0.5)
    law = Law(None, "across", "a * head * r", station=station)
    assert law.conditions == ("head_3000_1000_500mm",)
    assert law.of_measurement
    p, seen = predicted(robot(NAME), campaign(NAME)[:30])[0], campaign(NAME).position[:30]
    way, turn = p - station, np.angle((seen - station) @ [1, 1j, 0])
    sense = np.sign(np.angle(np.exp(1j * np.diff(turn, prepend=turn[0]))))
    aside = np.stack([-way[:, 1], way[:, 0], 0 * sense], axis=1) / np.hypot(way[:, 0], way[:, 1])[:, None]
    expected = 2e-5 * (sense * np.linalg.norm(way, axis=1))[:, None] * aside
    np.testing.assert_allclose(shift(law, 2e-5), expected, rtol=0, atol=1e-12)
    assert law.label == "law at the beam's side by head, r"
    with pytest.raises(InputError, match="unknown name 'head'"):
        Law(None, "distance", "a * head")


def test_a_payload_law_is_an_error_of_its_mass() -> None:
    poses = campaign(NAME)[:30]
    found = shift(Law(None, "payload", "a * payload"), 0.01)
    kg = poses.conditions["payload_kg"]
    heavier = replace(poses, conditions={**poses.conditions, "payload_kg": kg * (1 + 0.01 * kg)})
    expected = predicted(robot(NAME), heavier)[0] - predicted(robot(NAME), poses)[0]
    assert np.abs(expected).max() > 1e-6
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3 * np.abs(expected).max())


LAWS = [
    Law(3, "joint", "a * max(0, abs(tau3) - 0.3) + b * sign(tau2)*tau2**2", (("a", 3e-5), ("b", 3e-5))),
    Law(2, "tilt", "[a, b, c] * warmth_600s", VECTOR),
    Law(5, "shift", "[a, b, c] * tanh((q4 - 0.2) / 0.3)", VECTOR),
    Law(None, "tool shift", "[a, b, c] * step(t - 0.5)", VECTOR),
    Law(None, "base tilt", "[a, b, c] * m2x", VECTOR),
    Law(None, "joints", "a * approach * abs(tau) + b * tanh(move)", (("a", 3e-5), ("b", 3e-5))),
    Law(None, "beam", "a * r**2 * gz", (("a", 3e-5),), (1.0, 2.0, 0.5)),
    Law(None, "across", "a * r * head", (("a", 3e-5),), (1.0, -2.0, 0.5)),
    Law(4, "joint", "a * heat2_600s"),
    Law(None, "payload", "a * t", (("a", 0.05),)),
]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.place)
def test_the_column_of_a_law_is_what_it_does_as_read_from_a_file(law: Law, tmp_path: Path) -> None:
    poses = with_columns(campaign(NAME)[:40], [law])
    size = np.array([size for size, _ in law.sizes().values()])
    E, _, _ = signatures(robot(NAME), [law], poses, robot(NAME).parameters.values)
    values = 0.1 * size * np.random.default_rng(0).normal(size=len(size))
    both = []
    for sign in (1, -1):
        write_robot(with_law(law, *(sign * values)), tmp_path / "law.toml")
        again = read_robot(tmp_path / "law.toml")
        assert again.effects == (law,)
        both.append(predicted(again, poses)[0])
    moved = (both[0] - both[1]) / 2
    assert np.abs(moved).max() > 1e-8
    np.testing.assert_allclose(E @ values, moved, rtol=0, atol=2e-4 * np.abs(moved).max())


def test_a_file_with_a_bad_formula_is_refused(tmp_path: Path) -> None:
    write_robot(with_law(Law(2, "joint", "a * abs(tau3)"), 1e-4), tmp_path / "law.toml")
    text = (tmp_path / "law.toml").read_text().replace("abs(tau3)", "eval(tau3)")
    (tmp_path / "bad.toml").write_text(text)
    with pytest.raises(InputError, match=r"bad.toml: effect\[1\].*column 5: unknown function 'eval'"):
        read_robot(tmp_path / "bad.toml")


def test_an_approach_is_from_either_side() -> None:
    with pytest.raises(InputError, match="may be zero"):
        with_law(Law(2, "joint", "a * exp(1 / (approach2 - 0.5))"), 1e-4)


def test_a_simulator_has_no_counterpart() -> None:
    whole = with_law(Law(2, "joint", "a * abs(tau3)"), 1e-4)
    omissions = counterparts(whole).left_out
    with pytest.raises(InputError, match=r"law at joint 2 by tau3: no counterpart in MuJoCo; lost without it: 0\."):
        left_out(whole, omissions, "a MuJoCo model", leave_out=False)
    assert len(left_out(whole, omissions, "a MuJoCo model", leave_out=True)) == 1


def test_a_link_without_mass_is_named_where_a_simulator_has_none() -> None:
    (masses,) = LinkMasses.candidates(robot("ur10e"))
    whole = robot("ur10e").with_effect(masses).with_values({"link_masses.m2": -1.5})
    (omission,) = counterparts(whole).left_out
    assert "the mass of link 2 came out negative" in str(omission)
    loaded = replace(robot("ur10e"), payload=Body(5.0, np.zeros(3))).with_effect(PayloadError(None))
    found = counterparts(loaded.with_values({"payload_error.mass": -1.0}))
    assert ([o.label for o in found.left_out], found.payload_factor) == (["payload_error"], 1.0)


def test_a_bearings_play_is_that_under_its_whole_weight() -> None:
    flange = BearingPlay(1)
    lying = Robot("lying", (Joint(alpha=np.pi / 2, body=Body(10.0, np.array([0.5, 0.0, 0.0]))),))
    poses = unmeasured(np.radians([[0.0], [40.0]]))
    loose = lying.with_effect(flange).with_values({"bearing_play@1.drop": 1e-4})
    moved = predicted(loose, poses)[0] - predicted(lying, poses)[0]
    # All of the weight lies across the axis; a share s of it moves the ring by s / sqrt(s^2 + 0.01).
    np.testing.assert_allclose(moved, np.tile([0.0, 0.0, -1e-4 / np.sqrt(1.01)], (2, 1)), atol=1e-9)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"formula": "a * q7"}, "q7; robot 'Universal Robots UR10e, synthetic' has joints 1 to 6"),
        ({"formula": "a * speed"}, "column 5: unknown name 'speed'; allowed are a, q1"),
        ({"formula": "a * q2 + 0.1"}, "must be zero where a are zero"),
        ({"formula": "q2"}, "factor 'a' is not in it"),
        ({"formula": "[a, 0, 0] * q2"}, "seam 'joint' needs 1 of its components"),
        ({"formula": "a * q2", "seam": "elbow"}, "seam = 'elbow'; allowed: joint, joints, tilt"),
        ({"formula": "a * q2", "seam": "beam"}, "joint does not belong at the seam 'beam'"),
        ({"formula": "a * q2", "factors": [["aa", 1e-5]]}, "different single letters"),
        ({"formula": "a * q2", "factors": [["a", 0.0]]}, "must be above 0, and 1000 at most"),
        ({"formula": 3}, "must be a valid string"),
    ],
)
def test_what_is_no_law_is_refused(settings: dict[str, object], message: str) -> None:
    with pytest.raises(InputError) as caught:
        robot(NAME).with_effect(Law.from_dict({"joint": 2, "settings": settings}))
    assert message in str(caught.value)


def test_a_payload_law_needs_no_loads_and_a_payload() -> None:
    with pytest.raises(InputError, match="unknown name 'tau2'"):
        Law(None, "payload", "a * tau2")
    law = Law(None, "payload", "a * t")
    with pytest.raises(InputError, match="declares no payload"):
        law.refuse_joints(replace(robot(NAME), payload=None))


def test_moves_follow_the_order_of_measuring() -> None:
    q = np.array([[0.1], [0.5], [0.2]])
    m = Measurements(q, "position", np.zeros((3, 3)), conditions={"time_s": np.array([20.0, 0.0, 10.0])})
    moves = derive(m, ["move1", "move2"])
    np.testing.assert_allclose(moves[0].conditions["move1"], [-0.1, 0.0, -0.3])
    assert moves[1] == ("move2",)

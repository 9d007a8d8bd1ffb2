"""What an effect is where a file says nothing: its settings; and how the springs of simulators are put together."""

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from bench import campaign, robot, with_columns

from casadical import Body, InputError, Joint, Placement, Robot
from casadical.diagnosis.candidates import candidates_of
from casadical.diagnosis.settings_search import neighbours
from casadical.effects import (
    Backlash,
    Effect,
    FrictionWindup,
    GearMesh,
    GravityCompensator,
    JointErrorCurve,
    LinkFlexure,
    MissingCompliance,
    NonlinearStiffness,
    SmrOffset,
    TransmissionRipple,
)
from casadical.effects.base import RIGID_STIFFNESS, Counterparts, Drive
from casadical.effects.plugins import effects_by_name
from casadical.effects.registry import BacklashByLoad, FrameSettling, HoseDrag
from casadical.effects.smooth import AnyOfLoad, AnyOfOtherAngle, SmoothInJoints
from casadical.export.mjcf.mjcf import counterparts
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import Measurements

# Files that give no settings are read with these: no version may change them.
SETTINGS = {
    "axis_wobble": {"cycles": 1, "still": False},
    "base_compliance": {"below": 0.0},
    "cross_coupling": {"source": 1},
    "frame_settling": {"shape": 1.0, "settles": 0.1},
    "frame_step": {"at": 0.5},
    "friction_windup": {},
    "joint_coupling": {"source": 1},
    "joint_zero_step": {"at": 0.5},
    "link_flexure": {"member": 2, "spread": False},
    "load_hysteresis": {"power": 1},
    "nonlinear_stiffness": {"knee": 0.3},
    "transmission_ripple": {"cycles": 2.0, "load": 0.0},
}


@pytest.mark.parametrize("name", SETTINGS)
def test_settings_that_a_file_does_not_give(name: str) -> None:
    kind = effects_by_name()[name]
    joint = 2 if name not in ("frame_settling", "frame_step") else None
    effect = kind.from_dict({"name": name, **({"joint": joint} if joint else {})})
    assert {f.name: getattr(effect, f.name) for f in fields(effect) if f.name != "joint"} == SETTINGS[name]


def test_a_frame_settles_within_a_fiftieth_to_a_third_of_the_campaign() -> None:
    assert [e.settles for e in FrameSettling.candidates(robot("ur10e"))] == [0.02, 0.05, 0.12, 0.3]
    assert float(FrameSettling().course(SimpleNamespace(conditions={"progress": 0.0}))) == 0


@pytest.mark.parametrize(
    ("turntables", "mass", "shoulder"), [(1, 9.0, {2}), (2, 9.0, {3}), (0, 9.0, {1}), (1, 0.0, set())]
)
def test_a_balancer_is_at_the_joint_that_gravity_loads(turntables: int, mass: float, shoulder: set[int]) -> None:
    """Upper arm and forearm behind joints of vertical axes: the first horizontal axis bears both."""
    bar = Body(mass, np.array([0.3, 0.0, 0.0]))
    links = [Joint(d=0.1, body=bar)] * turntables + [Joint(alpha=np.pi / 2, body=bar), Joint(a=0.6, body=bar)]
    assert {e.joint for e in GravityCompensator.candidates(Robot("arm", tuple(links)))} == shoulder


def test_links_of_any_length_but_castings_bend() -> None:
    links = [Joint(a=a, d=d) for a, d in ((5.0, 0), (1.0, 0), (0.2, 0), (0.0, 0.8))]
    arm = Robot("arm", tuple(links), tool=Placement(np.eye(4)))
    assert [e.member for e in LinkFlexure.candidates(arm)] == [1, 3]  # what is before joint 1 is no link


def plain(joints: int = 3) -> Counterparts:
    torques = np.array([100.0, 50.0, 20.0])[:joints]
    return Counterparts((Drive(),) * joints, torques, np.full(joints, 0.5), range(1, joints + 1))


def test_an_axis_without_a_spring_stays_rigid_beside_those_that_have_one() -> None:
    found = plain().with_springs("link_flexure", {"rx": 1e-4, "ry": 0.0, "rz": -2e-4}, 2)
    assert found.flexures[2] == ((5e5, np.inf, np.inf), False)  # 50 N m of joint 2, the greater at its ends
    assert [(o.label, o.parts) for o in found.left_out] == [("link_flexure", ("rz",))]
    foot = plain().with_springs("base_compliance", {"rx": 2e-4, "ry": 1e-4}, 0)
    assert foot.base == pytest.approx((5e5, 1e6))
    assert not plain().with_springs("base_compliance", {"rx": 0.0, "ry": 0.0}, 0).written


def test_springs_of_links_are_of_the_joints_at_their_ends_and_none_where_nothing_weighs() -> None:
    torques = np.array([900.0, 800.0, 0.05, 0.02])
    gantry = Counterparts((Drive(),) * 4, torques, np.full(4, 0.5), (3, 4))  # two slides before two turning joints
    sizes = {"rx": 1e-4, "ry": 1e-4, "rz": 1e-4}
    stiffness = [gantry.with_springs("link_flexure", sizes, k).flexures[k][0][0] for k in (1, 2, 3)]
    assert stiffness == pytest.approx([9e6, 500.0, 500.0])
    light = replace(gantry, torque_scale=np.full(4, 5e-11))
    assert [o.why for o in light.with_springs("base_compliance", {"rx": 1e-4, "ry": 1e-4}, 0).left_out] == [
        "no weight loads it"
    ]


def test_the_last_link_does_not_bend() -> None:
    arm = Robot("arm", (Joint(a=1.0), Joint(a=1.0)), tool=Placement(np.eye(4)))
    with pytest.raises(InputError, match="member = 2 is the last link"):
        arm.with_effect(LinkFlexure(None, 2))


def test_dry_friction_of_a_rigid_joint_winds_nothing_up() -> None:
    found = FrictionWindup(2).counterpart(plain(), {"constant": 4e-5, "load": 0.0})
    assert found.drive(2).friction == 0
    assert [o.label for o in found.left_out] == ["friction_windup@2"]


def test_the_mean_load_of_a_simulators_joint_is_that_of_random_readings() -> None:
    arm = robot("kr210")
    q = np.random.default_rng(1).uniform(*arm.limits, (2000, arm.n))
    expected = np.abs(arm.loads(q, {})).mean(axis=0)
    np.testing.assert_allclose(
        counterparts(arm.with_effect(MissingCompliance(3))).mean_load, expected, rtol=0.15, atol=1e-3
    )


@pytest.mark.parametrize("load", [-0.7, 0.05, 1.0])
def test_any_function_of_load_saturates_twice_and_is_even_twice(load: float) -> None:
    effect = AnyOfLoad(3)
    context = SimpleNamespace(load=lambda joint: {3: load}[joint], conditions={"approach3": -1.0})
    found = {name: float(value) for name, _, value in effect.terms(context)}
    own = {"s": np.tanh(8 * load), "t": np.tanh(2 * load), "e": np.hypot(load, 0.01), "q": load**2}
    assert found == pytest.approx(own | {"a": -1.0} | {f"a{name}": -value for name, value in own.items()})


def test_settings_of_a_backlash_that_are_not_given_are_among_those_that_are_tried() -> None:
    tried = [effect for effect in Backlash.candidates(robot("ur10e")) if effect.joint == 2]
    for name in ("friction", "width"):
        low, high = (pick(getattr(effect, name) for effect in tried) for pick in (min, max))
        assert low < getattr(Backlash(2), name) < high
    assert {e.width for e in BacklashByLoad.candidates(robot("ur10e"))} == {0.003, 0.01, 0.03, 0.1, 0.3}


def test_two_joints_are_tried_each_alone_and_both_with_equal_settings() -> None:
    variants = [*Backlash.variants(Robot("arm", (Joint(), Joint(a=0.5))))]
    alone, both = ([each for each in variants if len(each) == count] for count in (1, 2))
    assert len(variants) == len(alone) + len(both) == 3 * len(both) > 0
    for one, other in both:
        assert (one.joint, other.joint) == (1, 2)
        assert replace(one, joint=2) == other


def test_a_joint_that_stood_at_too_few_angles_has_no_curve() -> None:
    curve = JointErrorCurve(orders=9, spread=(1e-4, 1e-4, 1e-4))
    assert curve.for_poses(300, (18, 19, 140)).spread == (0.0, 1e-4, 1e-4)  # 19 angles determine nine orders
    assert curve.for_poses(36, (18, 19, 36)).spread == curve.spread


def test_friction_finds_the_spring_that_another_effect_brings() -> None:
    soft, joint = robot("kr210"), 3
    stiff = replace(soft, joints=tuple(replace(j, compliance=None) for j in soft.joints))
    windup, spring = FrictionWindup(joint), MissingCompliance(joint)
    values = {f"{spring.label}.deflection": 2e-4, f"{windup.label}.constant": 4e-5}
    found = counterparts(stiff.with_effect(windup, spring).with_values(values))
    great = stiff.torque_scale[joint - 1]
    assert found.drive(joint).stiffness == pytest.approx(great / 2e-4)
    # The spring gives way by the windup under the friction.
    assert found.drive(joint).friction == pytest.approx(4e-5 * great / 2e-4)
    assert found.left_out == ()


def test_a_bedded_gear_gives_way_softly_between_stops() -> None:
    found = NonlinearStiffness(2, 0.4).counterpart(plain(), {"bend": 1e-4})
    drive = found.drive(2)
    # A line through zero and the stop is within 8.3 % of the bend of tanh, everywhere.
    torque = np.linspace(0, 50, 501)
    line = np.minimum(torque / drive.give_stiffness, drive.give)
    assert np.abs(line - 1e-4 * np.tanh(torque / 50 / 0.4)).max() < 0.085 * 1e-4
    assert Drive().stiffness == RIGID_STIFFNESS


def test_an_effect_without_values_has_no_counterpart() -> None:
    arm = robot("kr210")
    assert counterparts(arm.with_effect(NonlinearStiffness(2))).drives == counterparts(arm).drives


def test_any_function_of_another_angle_is_that_angles() -> None:
    arm, poses = robot("ur10e"), campaign("ur10e")[::20]
    effect = AnyOfOtherAngle(3, 2)
    values = {f"{effect.label}.s1": 3e-5, f"{effect.label}.c2": -4e-5}
    found = predicted(arm.with_effect(effect).with_values(values), poses)[0]
    q = poses.q.copy()
    q[:, 2] += 3e-5 * np.sin(q[:, 1]) - 4e-5 * np.cos(2 * q[:, 1])
    # The reading moves the torques with it, the effect does not: to a hundredth of what it does.
    expected = predicted(arm, replace(poses, q=q))[0]
    whole = np.abs(expected - predicted(arm, poses)[0]).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=0.01 * whole)
    first = SmoothInJoints(None, 6, 3, 5).terms(SimpleNamespace(q=np.arange(6.0)))[0]
    assert first == ("ss", 1.0, np.sin(2) * np.sin(4))


NAME = "ur10e"


def shift(effect: Effect, values: dict[str, float], poses: Measurements, name: str = NAME) -> np.ndarray:
    """What the effect does to the positions, shape (n, 3) [m]."""
    poses = with_columns(poses, [effect])
    whole = robot(name).with_effect(effect).with_values({f"{effect.label}.{k}": v for k, v in values.items()})
    return predicted(whole, poses)[0] - predicted(robot(name), poses)[0]


@pytest.mark.parametrize("part", ["along", "across", "above"])
def test_an_offset_of_the_reflector_has_its_length(part: str) -> None:
    off = shift(SmrOffset(None, (4.0, -2.0, 1.0)), {part: 1e-5}, campaign(NAME)[:20])
    np.testing.assert_allclose(np.linalg.norm(off, axis=1), 1e-5, rtol=1e-9)


def test_a_hose_without_a_declared_load_ends_at_the_last_frame() -> None:
    loads = (None, Body(1e-9, np.zeros(3)))
    arms = (replace(robot(NAME), payload=load).with_effect(HoseDrag(None)) for load in loads)
    bare, loaded = (predicted(arm.with_values({"hose_drag.tension": 0.1}), campaign(NAME)[:5])[0] for arm in arms)
    np.testing.assert_allclose(bare, loaded, rtol=0, atol=1e-12)


def test_known_ratio_is_not_refined_away() -> None:
    assert neighbours(GearMesh(3, 171.5), 1.0) == []
    assert neighbours(TransmissionRipple(3, 4.0), 1.0) != []


def test_a_reflector_straight_above_the_instrument_or_in_it_has_a_position() -> None:
    """Across the beam has no direction there; the offset is left out, and nothing is NaN."""
    poses = campaign(NAME)
    seen = predicted(robot(NAME), poses)[0][0]
    for station in (seen, seen - [0.0, 0.0, 1.5]):
        effect = SmrOffset(None, tuple(float(x) for x in station))
        moved = shift(effect, dict.fromkeys(effect.sizes(), 1e-5), poses)[0]
        assert np.isfinite(moved).all()
        assert np.linalg.norm(moved) < 2e-5


def test_steps_are_looked_for_within_the_campaign_only() -> None:
    """What moves at once at a share of the campaign: no candidate at or beyond its ends, and none twice."""
    steps = [e for c in candidates_of(robot(NAME), "extended") for v in c.variants for e in v if hasattr(e, "at")]
    for kind in {type(e) for e in steps}:
        times = {e.at for e in steps if type(e) is kind}
        assert len(times) > 5
        assert 0 < min(times) < 0.1
        assert 0.9 < max(times) < 1

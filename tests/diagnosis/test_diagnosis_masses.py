"""Declared masses and mass centres of links that are wrong: a cause of their own, or part of the base model."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cases import diagnose, practice, robot, simulated
from planted import planted

from casadical.core.basics import InputError
from casadical.core.parts import Body, BodyWidth, Joint
from casadical.diagnosis.candidates import candidates_of
from casadical.effects import Context, LinkMasses, NonlinearStiffness
from casadical.identification.accuracy import predicted
from casadical.identification.identification import identify
from casadical.robot.robot import Robot
from casadical.robot.robot_file import read_robot, write_robot


def misdeclared(name: str, seed: int) -> Robot:
    """The robot with masses off by 10 to 30 % and mass centres by up to 30 mm per coordinate."""
    rng = np.random.default_rng(seed)
    joints = [
        replace(
            j,
            body=j.body
            and replace(
                j.body,
                mass=j.body.mass * (1 + rng.choice([-1, 1]) * rng.uniform(0.1, 0.3)),
                com=j.body.com + rng.uniform(-0.03, 0.03, 3),
            ),
        )
        for j in robot(name).joints
    ]
    return replace(robot(name), joints=tuple(joints))


@pytest.mark.slow
def test_wrong_masses_are_named_as_such_and_a_cause_beside_them_is_found() -> None:
    declared = misdeclared("kr210", 3)
    d = diagnose(declared, simulated("kr210", 21, n=70))
    assert (d.verdict, [c.label for c in d.causes]) == ("explained", ["link_masses"])
    assert d.causes[0].estimates == {}
    assert d.effects()[0].summary[0] == ("one sigma of each mass", "20, 20, 20, 20, 20, 20", "%")
    beside = diagnose(declared, simulated("kr210", 21, planted("gear_eccentricity", 4, size=200e-6), n=70))
    assert {c.label for c in beside.causes} == {"link_masses", "gear_eccentricity@4"}
    # Refitted, masses come nearer to the true ones where gravity shows them.
    refit = d.refit()
    true, said = (np.array([j.body.mass * j.body.com[0] for j in r.joints]) for r in (robot("kr210"), declared))
    v = {n: x for n, x in refit.robot.effect_values.items() if n.startswith("link_masses.")}
    found = np.array(
        [j.body.mass * ((1 + v[f"link_masses.m{i}"]) * j.body.com[0] + v[f"link_masses.x{i}"]) for i, j in
         enumerate(declared.joints, 1)]
    )  # fmt: skip
    assert abs(found[2] - true[2]) < abs(said[2] - true[2])


@pytest.mark.slow
@pytest.mark.parametrize("stiffnesses", [True, False])
def test_as_a_nuisance_they_are_in_the_base_model_and_never_named(stiffnesses: bool) -> None:
    """Also of a file that declares no stiffness, as a URDF: those of the joints are found with the masses."""
    declared = misdeclared("kr210", 3)
    if not stiffnesses:
        declared = replace(declared, joints=tuple(replace(j, compliance=None) for j in declared.joints))
    d = diagnose(declared, simulated("kr210", 21, n=70), masses="nuisance")
    assert (d.verdict == "none" or not stiffnesses, d.causes) == (True, ())
    assert d.gap.before < 5e-5
    names = d.case.given.parameters.names
    assert d.case.base.prior[names.index("link_masses.m2")] == pytest.approx(0.2)
    assert d.case.base.prior[names.index("link_masses.x2")] == pytest.approx(0.03)
    found = identify(robot("kr210"), simulated("kr210", 21, n=40))
    with pytest.raises(InputError, match="identified already"):
        diagnose(found, masses="nuisance")


def test_widths_are_those_of_the_robot_file(tmp_path: Path) -> None:
    own = replace(robot("ur10e"), body_width=BodyWidth.model_validate({"mass_share": 0.1, "com_mm": 5.0}))
    write_robot(own, tmp_path / "own.robot.toml")
    again = read_robot(tmp_path / "own.robot.toml")
    assert again.body_width == own.body_width
    (effect,) = LinkMasses.candidates(again)
    sizes = effect.sizes()
    assert (sizes["m3"], sizes["y3"]) == ((0.1, "kg/kg"), (0.005, "m"))
    exact = replace(own, body_width=BodyWidth.model_validate({"mass_share": 0.0, "com_mm": 0.0}))
    assert not list(LinkMasses.candidates(exact))
    assert "link_masses" not in {c.label for c in candidates_of(exact, "standard")}


def test_a_mass_centre_that_nobody_declared_is_as_uncertain_as_the_link_is_long() -> None:
    """`new` writes [0, 0, 0] where a centre is not known."""
    bare = robot("ur10e")
    joints = [replace(j, body=j.body and replace(j.body, com=np.zeros(3))) for j in bare.joints]
    (effect,) = LinkMasses.candidates(replace(bare, joints=tuple(joints)))
    assert effect.centre[1] == pytest.approx(0.5 * abs(bare.joints[2].a), rel=0.1)  # the upper arm
    assert min(effect.centre) >= 0.03


def test_a_robot_without_masses_or_springs_has_no_such_cause() -> None:
    bare = robot("ur10e")
    massless = tuple(replace(j, body=None) for j in bare.joints)
    stiff = tuple(replace(j, compliance=None) for j in bare.joints)
    assert not list(LinkMasses.candidates(replace(bare, joints=massless)))
    assert not list(LinkMasses.candidates(replace(bare, joints=stiff)))


def test_great_torques_and_forces_are_not_compared() -> None:
    """A sliding joint that carries 1000 N leaves the least torque of turning joints as it is without it."""
    arm = robot("ur10e")
    slider = Joint(alpha=0.0, kind="prismatic", lower=0.0, upper=1.0, body=Body(500.0, np.zeros(3)))
    whole = replace(arm, joints=(slider, *arm.joints))
    scale = whole.torque_scale
    assert scale[0] > 4000  # N, of 500 kg and the arm
    assert scale[1:] == pytest.approx(arm.torque_scale, rel=0.1)  # of other random readings
    context = Context(whole, scale, None, {}, {}, (), None)
    assert float(context.peak_moment) == pytest.approx(float(arm.torque_scale.max()), rel=0.1)


def test_the_greatest_torque_may_be_that_of_the_first_joint() -> None:
    """Of two parallel upright-turning joints, the first carries both links."""
    heavy = Joint(alpha=np.pi / 2, body=Body(10.0, np.array([0.5, 0.0, 0.0])))
    arm = Robot("lying", (heavy, Joint(a=1.0, body=Body(1.0, np.array([0.2, 0.0, 0.0])))))
    context = Context(arm, arm.torque_scale, None, {}, {}, (), None)
    assert float(context.peak_moment) == arm.torque_scale[0] > arm.torque_scale[1]


FEW = ["gear_eccentricity@2", "nonlinear_stiffness@2", "link_masses"]


@pytest.mark.parametrize(("hidden", "said"), [("y2", True), ("nonlinear_stiffness@2", False)])
def test_a_claim_that_hangs_on_the_masses_says_so(hidden: str, said: bool) -> None:
    """A mass centre that is 45 mm off looks like an eccentric gear; no mass bends a spring like a cubic one."""
    clean, arm = simulated("ur10e", 21, n=60), robot("ur10e")
    effect = next(iter(LinkMasses.candidates(arm))) if said else NonlinearStiffness(2)
    name = "y2" if said else next(iter(effect.sizes()))
    true = arm.with_effect(effect).with_values({f"{effect.label}.{name}": 0.045 if said else 2e-4})
    shift = predicted(true, clean)[0] - predicted(arm, clean)[0]
    d = diagnose(arm, replace(clean, position=clean.position + shift), FEW)
    (cause,) = d.causes
    assert cause.label == ("gear_eccentricity@2" if said else hidden)
    assert cause.confidence > 0.9
    words = [text for text in d.case.assumed if "hangs on them" in text]
    assert bool(words) == said
    assert all("it is nothing (" in text for text in words)


def test_an_effect_of_all_joints_is_no_rival_of_a_cause_that_does_not_hang_on_the_masses() -> None:
    d = diagnose(robot("ur10e"), practice("ur10e-P06"), ["friction_windup", "link_masses"])
    assert [c.label for c in d.causes if c.confidence > 0.9] == ["friction_windup@3"]
    assert not [text for text in d.case.assumed if "hangs on them" in text]

"""Effects that a file defines: what they do, judged and kept as the package's own; what is refused."""

import pickle
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import casadi as ca
import numpy as np
import pytest
from bench import campaign, robot

from casadical.core.basics import InputError
from casadical.core.reading import load_toml
from casadical.diagnosis.candidates import candidates_of
from casadical.diagnosis.linearisation import signatures
from casadical.effects import Effect, JointScale, Law, ThermalGrowth, setting
from casadical.effects.definition import LISTED_EFFECTS_FILE
from casadical.effects.plugins import effects_by_name
from casadical.export.mjcf.mjcf import counterparts
from casadical.identification.accuracy import predicted
from casadical.robot.effect_tables import read_effects
from casadical.robot.robot_file import read_robot, write_robot

NAME = "ur10e"
SOFT_STOP = """
casadical = 2

[[definition]]
name = "soft_stop"
signature = "a joint that gives way near the end of its range"
physics = "A rubber stop pushes the joint back."
settings.start = {default = 1.5, grid = [1.0, 1.5, 2.0], about = "where the stop begins [rad]"}
sizes = {give = [50e-6, "rad"]}
formulas.joint = "-give * sign(q{joint}) * max(0, abs(q{joint}) - start)"
"""


@dataclass(frozen=True)
class SoftStop(Effect):
    """The same in Python."""

    start: float = setting(1.5, (1.0, 1.5, 2.0))

    name: ClassVar[str] = "soft_stop"
    physics: ClassVar[str] = "A rubber stop pushes the joint back."

    def sizes(self):
        return {"give": (50e-6, "rad")}

    def angle(self, context, q):
        return -self.value(context, "give") * ca.sign(q) * ca.fmax(ca.fabs(q) - self.start, 0)


def defined(folder: Path, text: str = SOFT_STOP) -> type[Effect]:
    path = folder / "own.effect.toml"
    path.write_text(text)
    (kind,) = read_effects(path).kinds
    return kind


def test_a_definition_is_what_a_class_of_python_is(tmp_path: Path) -> None:
    kind = defined(tmp_path)
    poses = campaign(NAME)[:40]
    theirs, ours = (candidates_of(robot(NAME), [k]) for k in (kind, SoftStop))
    assert [c.label for c in theirs] == [c.label for c in ours]
    assert [e.to_dict() for c in theirs for v in c.variants for e in v] == [
        e.to_dict() for c in ours for v in c.variants for e in v
    ]
    for effect, same in ((kind(5, 1.2), SoftStop(5, 1.2)), (kind(2), SoftStop(2))):
        E, S = (signatures(robot(NAME), [e], poses, robot(NAME).parameters.values)[0] for e in (effect, same))
        assert np.abs(S).max() > 0
        np.testing.assert_allclose(E, S, rtol=0, atol=1e-14 * np.abs(S).max())


def test_a_robot_file_holds_the_definition(tmp_path: Path) -> None:
    effect = defined(tmp_path)(5, 1.2)
    whole = robot(NAME).with_effect(effect, JointScale(2)).with_values({"soft_stop@5.give": 3e-4})
    write_robot(whole, tmp_path / "own.toml")
    again = read_robot(tmp_path / "own.toml")
    assert again.effects == whole.effects
    assert [d["name"] for d in load_toml(tmp_path / "own.toml")["definition"]] == ["soft_stop"]
    poses = campaign(NAME)[:20]
    np.testing.assert_allclose(predicted(again, poses)[0], predicted(whole, poses)[0], rtol=0, atol=1e-12)
    write_robot(robot(NAME).with_effect(JointScale(2)), tmp_path / "listed.toml")
    assert "definition" not in load_toml(tmp_path / "listed.toml")


def test_an_effect_goes_to_another_process(tmp_path: Path) -> None:
    for effect in (defined(tmp_path)(5, 1.2), JointScale(3), ThermalGrowth(None, 300.0)):
        again = pickle.loads(pickle.dumps(effect))
        assert again == effect
        assert type(again) is type(effect)


def test_the_list_of_the_package_is_a_file_like_any_other(tmp_path: Path) -> None:
    text = LISTED_EFFECTS_FILE.read_text().replace('name = "', 'name = "my_')
    text = re.sub(r"\b(sin|cos|step)\b(?!\()", r"\1_", text)  # functions; only the package names parameters so
    (tmp_path / "all.effect.toml").write_text(text)
    kinds = read_effects(tmp_path / "all.effect.toml").kinds
    for kind in kinds:
        listed = effects_by_name()[kind.name.removeprefix("my_")]
        assert [e.to_dict().get("settings") for e in kind.candidates(robot(NAME))] == [
            e.to_dict().get("settings") for e in listed.candidates(robot(NAME))
        ]
    assert len(kinds) > 25


def test_an_energy_bends_the_joints_by_its_slope(tmp_path: Path) -> None:
    """No listed effect is given as an energy; its column is what the robot with it does."""
    text = """
casadical = 2
[[definition]]
name = "own"
signature = "an own effect"
sizes = {a = [10.0, "-"]}
formulas.energy = "0.5 * a * q2**2"
"""
    effect, poses, arm = defined(tmp_path, text)(), campaign(NAME)[:40], robot(NAME)
    E, _, _ = signatures(arm, [effect], poses, arm.parameters.values)
    whole = arm.with_effect(effect)
    both = [predicted(whole.with_values({"own.a": value}), poses)[0] for value in (1.0, -1.0)]
    moved = (both[0] - both[1]) / 2
    assert np.abs(moved).max() > 1e-8
    np.testing.assert_allclose(E[:, :, 0], moved, rtol=0, atol=2e-4 * np.abs(moved).max())
    lever = arm.with_values({f"c{j}": 0.0 for j in (1, 3, 4, 5, 6)}).with_effect(effect)
    bent = replace(poses, q=poses.q - arm.parameters["c2"].value * poses.q * (np.arange(6) == 1))
    expected, rigid = (predicted(lever.with_only(()), m)[0] for m in (bent, poses))
    found = predicted(lever.with_values({"own.a": 1.0}), poses)[0] - rigid
    np.testing.assert_allclose(found, expected - rigid, rtol=0, atol=1e-2 * np.abs(found).max())


def test_a_logged_column_may_be_called_head(tmp_path: Path) -> None:
    text = """
casadical = 2
[[definition]]
name = "own"
signature = "an own effect"
sizes = {a = [1e-4, "rad"]}
needs = ["head"]
formulas.joint = "a * head"
"""
    effect = defined(tmp_path, text)(2)
    assert effect.conditions == ("head",)
    m = campaign(NAME)[:20]
    m = replace(m, conditions={**m.conditions, "head": np.linspace(0, 1, 20)})
    assert np.abs(signatures(robot(NAME), [effect], m, robot(NAME).parameters.values)[0]).max() > 0


def test_a_counterpart_is_named(tmp_path: Path) -> None:
    text = SOFT_STOP.replace("give", "k").replace("formulas.", 'counterpart = "gear ratio"\nformulas.')
    stiff = robot(NAME).with_effect(defined(tmp_path, text)(3)).with_values({"soft_stop@3.k": 1e-4})
    assert counterparts(stiff).drive(3).ratio == pytest.approx(1.0001)


AIMED = """
casadical = 2

[[definition]]
name = "aimed"
signature = "seen askew"
physics = "A mark of glass is seen through its edge."
settings.station = {default = [4.0, 0.0, 1.0]}
settings.towards = {default = [0.0, 0.0, 2.0]}
sizes = {a = [50e-6, "m"]}
formulas.beam = "a * incidence"
"""


@pytest.mark.parametrize("looks", ["0.5", "[0.0, 0.0, 0.0]"])
def test_a_target_looks_in_a_direction(looks: str, tmp_path: Path) -> None:
    own, other = defined(tmp_path, AIMED)(), Law(None, "beam", "a * incidence", station=(4.0, 0.0, 1.0))
    m, arm = campaign(NAME), robot(NAME)
    columns = [signatures(arm, [e], m, arm.parameters.values)[0] for e in (own, other)]
    np.testing.assert_allclose(*columns)  # a direction of any length
    with pytest.raises(InputError, match="`towards` as a direction"):
        defined(tmp_path, AIMED.replace("[0.0, 0.0, 2.0]", looks))
    with pytest.raises(InputError, match="is no direction"):
        Law(None, "beam", "a * incidence", towards=(0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("max(0,", "eval(0,", "definition[1].formulas: formula '-give * sign(q1) * eval(0, abs(q1) - start)', column "),
        ("q{joint}", "q{arm}", "no setting 'arm'; allowed: joint, start"),
        ("- start", "- begin", "unknown name 'begin'; allowed are give, start, q1"),
        ("-give *", "give * 0 + 1 *", "it must be zero where give are zero"),
        ("formulas.joint", "formulas.elbow", "formulas.elbow: no seam; allowed: joint, tilt"),
        ("formulas.joint", "formulas.tilt", "seam 'tilt' needs 3 of its components"),
        ("formulas.joint", "formulas.beam", "formulas.beam: it needs a setting `station`"),
        ("{give = [50e-6", "{more = [1.0, 'm'], give = [50e-6", "sizes.more: is in no formula"),
        ("50e-6", "0.0", "sizes.give: one sigma of 0.0; must be above 0"),
        ("settings.start", "settings.give", "give: a name of small letters"),
        ("{give = [50e-6", "{gx = [1.0, 'm'], give = [50e-6", "gx: is a variable of formulas; give the parameter"),
        ("{give = [50e-6", "{sin = [1.0, 'm'], give = [50e-6", "sin: is a function of formulas; give the parameter"),
        ('name = "soft_stop"', 'name = "backlash"', "there is an effect 'backlash' already"),
        ('name = "soft_stop"', 'name = "Soft stop"', "definition[1].name = 'Soft stop'"),
        ("[1.0, 1.5, 2.0]", '"far"', "grid"),
        ("[1.0, 1.5, 2.0]", "[1, 2]", "must hold values like the default one, 1.5"),
        ("[1.0, 1.5, 2.0]", '"near"', "only for the number of a joint"),
        ("[1.0, 1.5, 2.0]", "[1.0], steps = true", "needs a grid of two values or more"),
        ("default = 1.5, grid = [1.0, 1.5, 2.0]", 'default = "far"', "unknown name 'start'"),
        ("about =", "abuot =", "unknown key (is about meant?)"),
        ("physics", 'counterpart = "magnet"\nphysics', "counterpart = 'magnet': allowed: gear ratio, foot"),
        ("signature", "# signature", "signature: is missing"),
        ("[[definition]]", "[[effect]]", "unknown key"),
    ],
)
def test_what_is_no_definition_is_refused(old: str, new: str, message: str, tmp_path: Path) -> None:
    assert old in SOFT_STOP
    with pytest.raises(InputError) as caught:
        defined(tmp_path, SOFT_STOP.replace(old, new))
    assert str(caught.value).startswith("own.effect.toml: ")
    assert message in str(caught.value)


def test_an_effect_of_a_joint_needs_its_number_and_one_that_there_is(tmp_path: Path) -> None:
    kind = defined(tmp_path)
    with pytest.raises(InputError, match="soft_stop: joint is missing"):
        robot(NAME).with_effect(kind())
    with pytest.raises(InputError, match="has joints 1 to 6"):
        robot(NAME).with_effect(kind(7))


def test_a_file_of_neither_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.effect.toml").write_text("casadical = 2\n")
    with pytest.raises(InputError, match=r"neither \[\[effect\]\] nor \[\[definition\]\]"):
        read_effects(tmp_path / "empty.effect.toml")


def test_equal_definitions_make_one_class(tmp_path: Path) -> None:
    """One class for equal definitions, whatever file they are in."""
    (tmp_path / "other").mkdir()
    assert defined(tmp_path) is defined(tmp_path / "other")
    assert replace(defined(tmp_path)(2), start=1.0) == defined(tmp_path / "other")(2, 1.0)


def test_numbers_of_an_effect_of_ones_own_are_printed_in_the_unit_that_it_declares(tmp_path: Path) -> None:
    for kind in (defined(tmp_path), SoftStop):
        (give,) = kind(joint=2).parameters()
        assert (give.readable_unit, give.readable(2e-4)) == ("rad", 2e-4)
    (half,) = effects_by_name()["gear_eccentricity"](joint=2).parameters()[:1]
    assert half.readable_unit == "deg"

"""Robots with effects as files: the same positions, the same knowledge, and every fault by its key."""

import re
import tomllib
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from bench import FIRST, campaign, robot, with_columns

from casadical import Body, InputError, Joint, Robot, identify, read_robot, write_robot
from casadical.core.files import write_together
from casadical.diagnosis.candidates import candidates_of
from casadical.effects import Backlash, Effect, JointErrorCurve, ThermalGrowth
from casadical.identification.accuracy import predicted
from casadical.robot.effect_tables import text_of
from casadical.robot.robot import MAX_BLOCK_PARAMETERS, Covariance, Knowledge, RemainingErrors, blocks
from casadical.robot.robot_file import robot_files, robot_from, to_toml
from casadical.robot.robot_schema import _Body, far_centre

# What reads distances or full poses has columns of its own, of where it measures to.
OF_INSTRUMENTS = {
    "wire_offset", "wire_scale", "wire_drift", "station_step", "wire_step", "lens_scale", "hand_eye_step", "stand_step",
}  # fmt: skip


def every_effect(name: str, rng: np.random.Generator, listed: bool) -> tuple[Effect, ...]:
    """One effect of every label, its settings drawn from the grid and moved off it."""
    by_label: dict[str, list[Effect]] = {}
    for c in (c for c in candidates_of(robot(name), "extended") if c.name not in OF_INSTRUMENTS):
        for effect in (e for v in c.variants for e in v if c.listed is listed):
            by_label.setdefault(effect.label, []).append(effect)
    chosen = [found[rng.integers(len(found))] for found in by_label.values()]
    drawn = []
    for effect in chosen:
        settings = {f.name: getattr(effect, f.name) for f in fields(effect)}
        moved = {k: v * rng.uniform(0.9, 1.1) for k, v in settings.items() if isinstance(v, float) and k != "lag"}
        drawn.append(replace(effect, **moved))
    return tuple(drawn)


@pytest.mark.parametrize("name", [n if n == "ur10e" else pytest.param(n, marks=pytest.mark.slow) for n in FIRST])
@pytest.mark.parametrize("listed", [True, False])
def test_every_effect_gives_the_same_positions_after_its_file(name: str, listed: bool, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    effects = every_effect(name, rng, listed)
    whole = robot(name).with_effect(*effects)
    values = {p.name: rng.normal(0, p.scale) for e in effects for p in e.parameters()}
    values |= {
        p.name: p.value + 1e-3 * rng.normal() * p.prior for p in robot(name).parameters if p.group != "compliance"
    }
    whole = whole.with_values(values)
    write_robot(whole, tmp_path / "robot.toml")
    again = read_robot(tmp_path / "robot.toml")
    assert again.effects == effects
    assert again.effect_values == whole.effect_values
    m = with_columns(campaign(name), effects)[::5]
    bare = whole.with_only(())
    there = predicted(whole, m)[0]
    assert np.linalg.norm(there - predicted(bare, m)[0], axis=1).min() > 1e-6
    np.testing.assert_allclose(predicted(again, m)[0], there, rtol=0, atol=1e-12)


EFFECTS = (Backlash(5), ThermalGrowth())
FREE = ("kinematic", "compliance", *(e.label for e in EFFECTS))


@cache
def learnt() -> Robot:
    return identify(
        robot("hh800").with_effect(*EFFECTS), with_columns(campaign("hh800"), EFFECTS), FREE, priors=True
    ).robot


def test_what_an_identification_knows_is_kept(tmp_path: Path) -> None:
    m = with_columns(campaign("hh800"), EFFECTS)
    found = identify(robot("hh800").with_effect(*EFFECTS), m, FREE, priors=True, loss="linear")
    write_robot(found.robot, tmp_path / "robot.toml")
    known = read_robot(tmp_path / "robot.toml").knowledge
    assert known is not None
    (block,) = known.covariance
    assert block.names == found.names
    error = np.sqrt(
        np.diag(found.covariance)
    )  # in these units: an element's own digits are no measure where it is small
    np.testing.assert_allclose((block.matrix - found.covariance) / np.outer(error, error), 0, atol=1e-11)
    assert (known.campaign, known.poses) == ("hh800-P01.csv", len(m))
    np.testing.assert_allclose(known.readings, np.column_stack([m.q.min(axis=0), m.q.max(axis=0)]), atol=1e-15)
    assert known.conditions["payload_kg"] == (0.0, 300.0)
    assert known.conditions["approach5"] == (-1.0, 1.0)
    low, high = known.conditions["temperature_degC"]
    assert (low, high) == (m.conditions["temperature_degC"].min(), m.conditions["temperature_degC"].max())


def test_a_result_is_written_with_the_digits_that_are_known() -> None:
    """Numbers that another processor rounds otherwise are the same file, and the same robot to 1e-9 m."""
    known = learnt()
    rng = np.random.default_rng(0)

    def moved(values: np.ndarray) -> np.ndarray:
        return values * (1 + 1e-13 * rng.uniform(-1, 1, np.shape(values)))

    values = {name: float(moved(v)) for name, v in known.effect_values.items()}
    (block,) = known.knowledge.covariance
    wobble = moved(block.matrix)
    learned = replace(known.knowledge, covariance=(Covariance(block.names, (wobble + wobble.T) / 2),))
    joints = tuple(replace(j, a=float(moved(j.a)), theta=float(moved(j.theta))) for j in known.joints)
    other = replace(known, joints=joints, effect_values=values, knowledge=learned)
    assert to_toml(known) != to_toml(other)
    text = to_toml(known, reproducible=True)
    assert text == to_toml(other, reproducible=True)
    again = robot_from(tomllib.loads(text), "robot.toml")
    m = with_columns(campaign("hh800"), EFFECTS)[::5]
    np.testing.assert_allclose(predicted(again, m)[0], predicted(known, m)[0], rtol=0, atol=1e-9)
    (kept,) = again.knowledge.covariance
    combined = rng.normal(size=(50, len(block.names)))  # of any combination of parameters, the variance
    ours, theirs = (np.einsum("ki,ij,kj->k", combined, b.matrix, combined) for b in (block, kept))
    np.testing.assert_allclose(theirs, ours, rtol=1e-4)


def test_what_is_held_stays_known_and_what_is_free_is_known_anew() -> None:
    m = with_columns(campaign("hh800"), EFFECTS)[:60]
    again = identify(learnt(), m, ("kinematic",))
    before, after = learnt().knowledge, again.robot.knowledge
    assert again.robot.effect_values == learnt().effect_values
    assert after.std_errors["backlash@5.half"] == before.std_errors["backlash@5.half"]
    assert after.std_errors["tool_x"] != before.std_errors["tool_x"]
    assert after.poses == before.poses  # the effects' own
    freed = identify(learnt(), m, ("placement", "backlash@5"), loss="linear").robot.knowledge
    assert freed.poses == 60
    assert freed.std_errors["backlash@5.half"] > before.std_errors["backlash@5.half"]
    assert freed.std_errors["thermal_growth.alpha"] == before.std_errors["thermal_growth.alpha"]


def test_large_covariances_are_kept_effect_by_effect() -> None:
    rng = np.random.default_rng(0)
    names = [f"a.{k}" for k in range(70)] + [f"b.{k}" for k in range(60)]
    A = rng.normal(size=(130, 130))
    C = A @ A.T
    C[5] = C[:, 5] = np.nan  # a parameter at its bound
    first, second = blocks(names, [n[0] for n in names], C)
    assert len(names) > MAX_BLOCK_PARAMETERS
    assert first.names == tuple(n for n in names[:70] if n != "a.5")
    assert second.names == tuple(names[70:])
    small = blocks(names[:9], [n[0] for n in names[:9]], np.eye(9))
    assert [len(block.names) for block in small] == [9]


def test_a_large_covariance_lies_in_a_file_beside_the_robot(tmp_path: Path) -> None:
    """Predicted sigmas are those before, and a file without its companion, or with another one, is refused."""
    curve = JointErrorCurve(orders=12)
    names = tuple(p.name for p in curve.parameters())
    A = np.random.default_rng(0).normal(size=(len(names), len(names) + 5))
    C = 1e-9 * A @ A.T
    known = replace(robot("ur10e").with_effect(curve), knowledge=Knowledge((Covariance(names, C),), "", 9, misfit=1.5))
    for reproducible in (False, True):
        write_together(robot_files(tmp_path / "arm.robot.toml", known, reproducible=reproducible))
        assert (tmp_path / "arm.robot.toml").stat().st_size < 40_000
        found = read_robot(tmp_path / "arm.robot.toml").knowledge
        (block,) = found.covariance
        assert found.misfit == 1.5
        variances = np.einsum("ij,ij->i", A.T @ block.matrix, A.T), np.einsum("ij,ij->i", A.T @ C, A.T)
        np.testing.assert_allclose(*map(np.sqrt, variances), rtol=1e-6)
    companion = tmp_path / "arm.covariance.npz"
    for content, said in ((b"PK", "not a zip file"), (None, "copy both together"), ("one row", "another robot file")):
        companion.unlink()
        if content == "one row":
            np.savez(companion, **{names[0]: np.ones(1)})
        elif content:
            companion.write_bytes(content)
        with pytest.raises(InputError, match=said):
            read_robot(tmp_path / "arm.robot.toml")
        companion.touch()


@dataclass(frozen=True)
class Own(Effect):
    name: ClassVar[str] = "own_effect"

    def sizes(self):
        return {"k": (1e-5, "rad")}

    def angle(self, context, q):
        return self.value(context, "k")


def test_an_effect_that_is_not_installed_is_written_and_read_only_where_its_class_is_given(tmp_path: Path) -> None:
    file, r = tmp_path / "robot.toml", robot("ur10e").with_effect(Own(3))
    with pytest.raises(InputError, match=r"no effect 'own_effect' is installed.*backlash.*casadical.effects"):
        write_robot(r, file)
    assert not file.exists()
    write_robot(r, file, effects=[Own])
    with pytest.raises(InputError, match=r"robot.toml: effect\[1\].no effect 'own_effect'"):
        read_robot(file)
    assert read_robot(file, effects=[Own]).effects == (Own(3),)


def test_ranges_of_a_prismatic_joint_are_in_millimetres(tmp_path: Path) -> None:
    base = 'casadical = 2\nname = "x"\n[[joint]]\ntype = "prismatic"\n[[joint]]\na_mm = 300\n'
    (tmp_path / "r.toml").write_text(base + "[learnt.readings]\nq1_mm = [-5, 20]\nq2_deg = [0, 90]\n")
    found = read_robot(tmp_path / "r.toml")
    np.testing.assert_allclose(found.knowledge.readings, [[-5e-3, 20e-3], [0, np.pi / 2]])
    assert "q1_mm = [-5.0, 20.0]" in to_toml(found)


GOOD = """
casadical = 2
name = "two joints"

[[joint]]
d_mm = 100

[[joint]]
a_mm = 300

[[effect]]
name = "backlash"
joint = 2
settings = {friction = 0.1, width = 0.05}
[effect.values]
half = {value = 5e-5, unit = "rad", std_error = 2e-6}

[[effect]]
name = "joint_scale"
joint = 1
[effect.values]
k = {value = 1e-5, unit = "rad/rad"}

[learnt]
poses = 40
[learnt.readings]
q1_deg = [-90, 90]
q2_deg = [0, 80]

[[covariance]]
names = ["backlash@2.half", "joint_scale@1.k"]
lower = [[4e-12], [1e-12, 9e-12]]
"""

FAULTS = {
    "an effect that is not there": (('"backlash"', '"backlsh"'), ["effect[1].no effect 'backlsh'", "backlash"]),
    "a joint that is not there": (("joint = 2", "joint = 3"), ["backlash: joint = 3", "joints 1 to 2"]),
    "a setting that is not there": (("friction = 0.1", "frict = 0.1"), ["effect[1].settings.frict", "friction, width"]),
    "another unit": (('"rad", std', '"mrad", std'), ["effect[1].values.half.unit = 'mrad'", "'rad'"]),
    "two errors": (("2e-6", "3e-6"), ["backlash@2.half: std_error = 3e-06", "says 2e-06"]),
    "one effect twice": (
        ("joint = 1\n", 'joint = 1\n[[effect]]\nname = "joint_scale"\njoint = 1\n'),
        ["joint_scale@1.k", "twice"],
    ),
    "covariance of nothing": (('"joint_scale@1.k"', '"a9"'), ["no parameter 'a9'", "joint_scale@1.k"]),
    "covariance in a square": (("[4e-12]", "[4e-12, 1e-12]"), ["covariance[1].lower", "[2, 2]", "1 to 2"]),
    "no covariance": (("[1e-12, 9e-12]", "[9e-12, 9e-12]"), ["covariance[1].", "least eigenvalue", "below zero"]),
    "a negative variance": (("9e-12", "-9e-12"), ["covariance[1].", "variance of joint_scale@1.k is -9e-12"]),
    "in two blocks": (
        ("[[covariance]]", '[[covariance]]\nnames = ["joint_scale@1.k"]\nlower = [[9e-12]]\n[[covariance]]'),
        ["joint_scale@1.k is in two blocks"],
    ),
    "a range the wrong way round": (("[0, 80]", "[80, 0]"), ["range of q2", "lower one must come first"]),
    "a range of another joint": (("q2_deg", "q3_deg"), ["learnt.readings.q3_deg", "q1_deg, q2_deg"]),
    "an old version": (("casadical = 2", "casadical = 1"), ["effect", "version 2"]),
    "a version to come": (
        ("casadical = 2", 'casadical = 3\nwritten_by = "casadical 0.7.0"\nnovelty = 1'),
        ["casadical = 3", "written by casadical 0.7.0", "reads files up to version 2", "install"],
    ),
}


BEYOND = [
    ('name="law"\nsettings={seam="joints", formula="a*q", count=1000000000}', "settings.count = 1000000000: allowed"),
    ('name="joint_error_curve"\nsettings={orders=1000000000}', "settings.orders = 1000000000: allowed"),
    ('name="joint_error_curve"\nsettings={orders=9000}', "108000 parameters; allowed: up to 3000"),
    ('name="joint_error_curve"\nsettings={knee=0}', "one sigma of s1_q1 is 0; it must be above 0"),
    ('name="joint_error_curve"\nsettings={orders=-1}', "settings.orders = -1: allowed"),
    ('name="session"\nsettings={which="b", zeros=1000000000}', "settings.zeros = 1000000000: allowed"),
    ('name="session"\nsettings={which="b", zeros=3}', "the model cannot be computed"),
    ('name="bearing_play"\njoint=1\nsettings={soft=0.0}', "the model cannot be computed"),
    ('name="frame_settling"\nsettings={settles=0.0}', "no finite position at readings"),
    ('name="load_hysteresis"\njoint=1\nsettings={power=1e9}', "settings.power = 1000000000.0: must be a valid integer"),
    ('name="load_hysteresis"\njoint=1\nsettings={power=1000}', "a power must be a whole number from 1 to 6"),
    ('name="law"\njoint=1\nsettings={seam="joint", formula="a/0"}', "column 3: may be zero"),
]


@pytest.mark.parametrize(("effect", "why"), BEYOND)
def test_settings_beyond_what_a_model_bears(effect: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text(f"{GOOD}\n[[effect]]\n{effect}\n")
    with pytest.raises(InputError, match=re.escape(why)):
        read_robot(tmp_path / "arm.toml")


def test_the_file_without_a_fault_is_read(tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text(GOOD)
    found = read_robot(tmp_path / "arm.toml")
    assert found.effect_values["backlash@2.half"] == 5e-5
    assert found.knowledge.std_errors == {"backlash@2.half": 2e-6, "joint_scale@1.k": 3e-6}
    assert found.knowledge.poses == 40


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_is_named(fault: str, tmp_path: Path) -> None:
    (old, new), words = FAULTS[fault]
    assert old in GOOD
    (tmp_path / "arm.toml").write_text(GOOD.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        read_robot(tmp_path / "arm.toml")
    for word in ("arm.toml", *words):
        assert word in str(error.value)


def test_an_error_beside_its_value_is_enough(tmp_path: Path) -> None:
    head, _, _ = GOOD.partition("[[covariance]]")
    (tmp_path / "arm.toml").write_text(head)
    found = read_robot(tmp_path / "arm.toml")
    assert found.knowledge.std_errors == {"backlash@2.half": 2e-6}
    text = "\n".join(text_of(found, found.effects, found.knowledge))
    assert "std_error = 2e-06" in text
    assert "[[covariance]]" not in text


@pytest.mark.parametrize("moments", [None, [1.0, 0.0, 0.0, 1.0, 0.0, 1.9], [1.0, 0.0, 0.0, 1.0, 0.0, 2.1]])
def test_moments_of_inertia_that_no_body_has_are_refused(moments: list[float] | None) -> None:
    if moments and moments[-1] > 2:
        with pytest.raises(ValueError, match="no body has such moments"):
            _Body(mass_kg=1.0, inertia_kgm2=moments)
    else:
        assert _Body(mass_kg=1.0, inertia_kgm2=moments).body().mass == 1.0


def test_a_mass_centre_is_within_twice_the_reach_and_a_metre() -> None:
    arm = Robot("arm", (Joint(a=0.5), Joint(a=0.7)))
    for metres, words in ((2 * arm.reach + 0.99, None), (2 * arm.reach + 1.01, 2)):
        far = far_centre(replace(arm, joints=(Joint(a=0.5), Joint(a=0.7, body=Body(1.0, np.array([0, metres, 0]))))))
        assert (far and far[0]) == words


def test_a_covariance_is_refused_where_it_is_made() -> None:
    with pytest.raises(InputError, match="not symmetric"):
        Covariance(("a", "b"), np.array([[1.0, 0.5], [0.0, 1.0]]))
    with pytest.raises(InputError, match=r"shape \(2, 2\) for 1 names"):
        Covariance(("a",), np.eye(2))
    Covariance(("a", "known"), np.diag([1.0, 0.0]))
    with pytest.raises(InputError, match="payload_kg"):
        Knowledge(conditions={"payload_kg": (3.0, 1.0)})


def test_remaining_errors_are_read_as_written_and_refused_where_they_do_not_fit() -> None:
    made = RemainingErrors(("a2", "a3"), np.array([[1e-4, 0.0, 1e-5], [2e-5, 3e-5, 0.0]]), 2e-5, 40)
    again = robot_from(tomllib.loads(to_toml(replace(robot("ur10e"), remaining=made))), "arm").remaining
    assert (again.names, again.rest, again.poses) == (made.names, made.rest, made.poses)
    np.testing.assert_allclose(again.factor, made.factor, rtol=1e-6)
    for factor in (made.factor.T, made.factor[0], made.factor * np.nan):
        with pytest.raises(InputError, match="a row of finite numbers for each name"):
            replace(made, factor=factor)


def test_of_parameters_that_a_robot_no_longer_has_nothing_is_written() -> None:
    known = Knowledge((Covariance(("a2", "gone"), np.eye(2)),))
    text = to_toml(replace(robot("ur10e"), knowledge=known))
    assert 'names = ["a2"]' in text
    assert "gone" not in text

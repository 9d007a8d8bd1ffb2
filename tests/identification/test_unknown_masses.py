"""Gravity without masses: deflections are found through the known geometry, stiffness is not claimed."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from arms import TRACKER, planted, positions, readings, six_axis, with_bodies

from casadical import Body, InputError, Joint, Robot, diagnose, identify, read_robot, write_robot
from casadical.core.parts import with_estimated_masses
from casadical.core.reporting.result import terminal
from casadical.diagnosis.statements import statements
from casadical.identification.accuracy import errors
from casadical.identification.figures import parameter_tables
from casadical.identification.gravity import as_json, gravity_deflections, in_words
from casadical.identification.identification import with_unknown_masses

MASSES = (20.0, 14.0, 6.0, 4.0, 2.0, 1.0)
CENTRES = ((0, 0, -0.1), (0.3, 0.02, 0.06), (0.03, 0.05, 0), (0, 0.02, -0.2), (0, 0.03, 0), (0, 0, -0.02))
COMPLIANCE = 2e-5


def arm() -> Robot:
    """With masses and springs; joints 1, 4 and 6 are rigid."""
    bodies = [Body(m, np.array(c, dtype=float)) for m, c in zip(MASSES, CENTRES, strict=True)]
    return with_bodies(six_axis(gravity_frame="base"), bodies, (2, 3, 5), COMPLIANCE)


def bare(robot: Robot) -> Robot:
    """The same without masses."""
    return replace(robot, joints=tuple(replace(j, body=None) for j in robot.joints))


def compliance_of(robot: Robot, joint: int) -> float:
    return robot.joints[joint - 1].compliance or 0.0


@cache
def made():
    """The robot as built, poses to identify from, and poses held out."""
    built = planted(arm(), 3, TRACKER)
    m = positions(built, readings(arm(), 200, 4), 5)
    return built, m[:100], m[100:]


@cache
def found():
    return identify(bare(arm()), made()[1], method="SKCM")


def test_held_out_errors_are_nearly_those_with_true_masses() -> None:
    _, fit, held = made()
    known = errors(identify(arm(), fit, method="SKCM").robot, held).mean()
    rigid = errors(identify(bare(arm()), fit, method="KM").robot, held).mean()
    unknown = errors(found().robot, held).mean()
    assert unknown < 1.15 * known < 0.3 * rigid


def test_deflections_are_those_of_the_robot_as_built_and_no_stiffness_is_claimed() -> None:
    built, fit, _ = made()
    tau = np.array([np.asarray(built.torque(q, built.parameters.values)).ravel() for q in fit.q])
    true = {i: compliance_of(built, i) * tau[:, i - 1] for i in (2, 3, 5)}
    told = {d.joint: d for d in gravity_deflections(found())}
    assert set(told) >= {2, 3}
    for joint in (2, 3):
        assert told[joint].change == pytest.approx(np.ptp(true[joint]), rel=0.1)
    text = in_words(found())
    assert text.startswith("deflection under gravity at joints 2, 3")
    assert "no stiffness follows" in text
    page = terminal_text(parameter_tables(found()))
    assert "Deflection under gravity at joints 2, 3" in page
    assert "Joint stiffness" not in page
    sure = [(d.joint, 1e3 * d.change, 1e3 * d.error) for d in told.values() if d.sure]
    for row, known in zip(as_json(found()), sure, strict=True):
        assert list(row.values()) == pytest.approx(known, abs=1e-5)
    assert in_words(identify(arm(), fit, method="SKCM")) == ""


def terminal_text(blocks) -> str:
    from rich.console import Console

    console = Console(width=300)
    with console.capture() as seen:
        console.print(terminal(blocks))
    return seen.get()


def test_estimates_are_marked_in_the_file_and_follow_the_reach(tmp_path: Path) -> None:
    small = with_estimated_masses(bare(arm()))
    assert small.masses == "estimated"
    bodies = [j.body for j in small.joints]
    assert sum(b.mass for b in bodies) == pytest.approx(10 * small.reach**3, rel=0.01)
    assert bodies[1].com == pytest.approx([0.25, 0, 0])  # the middle of the upper arm
    write_robot(small, tmp_path / "robot.toml")
    text = (tmp_path / "robot.toml").read_text()
    assert 'masses = "estimated"' in text
    again = read_robot(tmp_path / "robot.toml")
    assert (again.masses, again.body_width) == ("estimated", small.body_width)
    (tmp_path / "robot.toml").write_text(text.replace('"estimated"', '"guessed"'))
    with pytest.raises(InputError, match="masses"):
        read_robot(tmp_path / "robot.toml")


def test_a_calibrated_robot_keeps_what_was_found_of_its_masses(tmp_path: Path) -> None:
    write_robot(found().robot, tmp_path / "robot.toml")
    again = read_robot(tmp_path / "robot.toml")
    held = made()[2]
    assert errors(again, held) == pytest.approx(errors(found().robot, held), abs=1e-9)
    assert with_unknown_masses(again, (held,)) == (again, ())


def test_a_logged_payload_is_a_known_mass_at_an_unknown_centre() -> None:
    robot = bare(arm())
    m = made()[1]
    loaded = replace(m, conditions={"payload_kg": np.where(np.arange(len(m)) % 2, 5.0, 0.0)})
    with_load, free = with_unknown_masses(robot, (loaded,))
    assert free == ("link_masses", "payload_error")
    assert with_load.payload.mass == 5.0
    assert with_unknown_masses(robot, (m,))[1] == ("link_masses",)


def test_declared_masses_and_rigid_joints_stay_as_they_are() -> None:
    m = made()[1]
    declared = arm()
    assert with_unknown_masses(declared, (m,)) == (declared, ())
    rigid = replace(bare(arm()), joints=tuple(replace(j, compliance=None) for j in bare(arm()).joints))
    assert with_unknown_masses(rigid, (m,)) == (rigid, ())
    flat = Robot("flat", (Joint(compliance=0.0), Joint(a=0.4, compliance=0.0)))  # gravity turns no joint of it
    assert with_unknown_masses(flat, ())[1] == ("link_masses",)


WRONG = (7, 41)


@cache
def sagging():
    """The same arm as built, 60 poses with two wrong rows, and poses held out; its file says nothing of compliance."""
    _, fit, held = made()
    position = fit.position[:60].copy()
    position[list(WRONG)] += np.array([2e-3, -1e-3, 1.5e-3])
    return stiff(bare(arm())), replace(fit[:60], position=position), held


def stiff(robot: Robot) -> Robot:
    return replace(robot, joints=tuple(replace(j, compliance=None) for j in robot.joints))


def test_compliance_that_no_file_declares_is_found_and_said() -> None:
    robot, fit, held = sagging()
    known = errors(identify(arm(), fit, method="SKCM").robot, held).mean()
    tried = identify(robot, fit, method="SKCM")
    assert tried.tried.kept
    assert tried.outliers == tuple((0, i) for i in WRONG)
    assert errors(tried.robot, held).mean() < 1.2 * known
    assert "compliance is in the model" in tried.verdict
    assert {d.joint for d in gravity_deflections(tried) if d.sure} >= {2, 3}


def test_a_rigid_model_calls_no_row_an_outlier_that_the_compliant_one_explains() -> None:
    robot, fit, _ = sagging()
    rigid = identify(robot, fit, method="KM")
    assert rigid.outliers == tuple((0, i) for i in WRONG)
    assert "the standard errors of KM are too small" in rigid.verdict


def test_a_rigid_robot_stays_rigid() -> None:
    built = planted(stiff(arm()), 3, TRACKER)
    m = positions(built, readings(built, 60, 4), 5)
    found = identify(stiff(bare(arm())), m, method="SKCM")
    assert not found.tried.kept
    assert found.start.parameters.select(["compliance"]) == ()
    assert "too little for compliance" in found.verdict
    assert gravity_deflections(found) == ()


def test_of_deflections_that_are_not_certain_a_bound_is_given() -> None:
    built = planted(stiff(arm()), 3, TRACKER)
    m = positions(built, readings(built, 60, 4), 5)
    found = identify(bare(arm()), m, method="SKCM")
    text = in_words(found)
    assert text.startswith("deflection under gravity between poses: at most ")
    assert "(95 %), none is certain" in text
    assert all(d.change + 1.645 * d.error > 0 for d in gravity_deflections(found))


@pytest.mark.slow
def test_a_diagnosis_states_the_deflections_that_a_calibration_of_the_same_poses_states() -> None:
    """Also with wrong rows, which the base model of a diagnosis does not leave out."""
    robot, fit, _ = sagging()
    calibrated = identify(robot, fit, method="SKCM", loss="auto", priors="auto")
    d = diagnose(robot, fit, ["backlash"], laws=False)
    said = [s.text for s in statements(d) if s.about == "GRAVITY"]
    assert said == [in_words(calibrated)]
    assert in_words(d.identification) != said[0]
    built, (second, *_) = made()[0], gravity_deflections(d.gravity)
    tau = np.array([np.asarray(built.torque(q, built.parameters.values)).ravel() for q in fit.q])
    assert second.joint == 2
    assert second.change == pytest.approx(np.ptp(compliance_of(built, 2) * tau[:, 1]), abs=3 * second.error)

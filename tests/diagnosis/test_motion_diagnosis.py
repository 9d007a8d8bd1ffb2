"""Joint logs with causes from other friction laws than the diagnosis has: what is named, and what is not."""

import ast
import json
import re
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from plugin_site import installed
from typer.testing import CliRunner

from casadical import Body, InputError, Joint, Robot, write_robot
from casadical.cli.root import app
from casadical.core.drive import Drive
from casadical.core.linear_gaussian.search import Posterior
from casadical.core.reporting.blocks import Table
from casadical.core.reporting.result import plain_text
from casadical.diagnosis.candidates import own_causes
from casadical.diagnosis.motion.engine import (
    MIN_SPAN_RAD,
    Found,
    LogProblem,
    Rows,
    joint_of,
    next_cause,
    smooth_functions,
    with_candidates,
)
from casadical.diagnosis.motion.hypotheses import _plateaus
from casadical.diagnosis.motion.result import LogDiagnosis, diagnose_log
from casadical.diagnosis.motion.servo_rows import _prior
from casadical.diagnosis.motion.signals import arm_of, lagged, motion_of
from casadical.diagnosis.motion.view import log_view
from casadical.effects.motion import motion_effects
from casadical.effects.plugins import effects_by_name
from casadical.measurements.logs.findings import with_signs
from casadical.measurements.logs.log import JointLog
from casadical.project.diagnosis import read_logs
from casadical.robot.dynamics import Dynamics

ROOT = Path(__file__).parents[2]
RATE, SECONDS = 100.0, 12.0
STIFF, DAMPED, PER_AMPERE = np.array([9e3, 9e3, 3e3]), np.array([300.0, 300.0, 100.0]), 10.0


def three_joints():
    inertia = np.diag([0.05, 0.05, 0.02])
    joints = (
        Joint(d=0.3, body=Body(8.0, np.array([0.0, 0.0, -0.1]), inertia)),
        Joint(alpha=np.pi / 2, body=Body(6.0, np.array([0.2, 0.0, 0.0]), inertia)),
        Joint(a=0.5, body=Body(4.0, np.array([0.2, 0.02, 0.0]), inertia)),
    )
    drive = Drive(
        kp_Nm_per_rad=STIFF.tolist(), kd_Nms_per_rad=DAMPED.tolist(), gear_ratio=100.0, torque_constant_Nm_per_A=0.1,
        rotor_inertia_kgm2=1e-4, delay_s=0.004, log_rate_Hz=RATE, encoder_side="joint",
    )  # fmt: skip
    return Robot(name="three joints", joints=joints, drive=drive)


ROBOT = three_joints()


@cache
def simulated(seed, fault=None, runs=2):
    """A log: friction by a bristle model, autocorrelated noise; fault : changes torque, command and time."""
    rng, parts = np.random.default_rng(seed), []
    dry, viscous = np.array([6.0, 8.0, 3.0]) * rng.uniform(0.9, 1.1, 3), np.array([5.0, 6.0, 2.0])
    for run in range(1, runs + 1):
        t = np.arange(0, SECONDS, 1 / RATE)
        w, phase = rng.uniform(0.5, 2.5, (3, 3, 1)), rng.uniform(0, 6, (3, 3, 1))
        q = (np.array([0.5, 0.25, 0.15])[:, None, None] * np.sin(w * t + phase)).sum(axis=0).T
        q += np.array([0.0, 0.7, -0.8])
        v, a = (np.gradient(q, 1 / RATE, axis=0), np.gradient(np.gradient(q, 1 / RATE, axis=0), 1 / RATE, axis=0))
        bristle = np.zeros_like(q)
        for k in range(1, len(t)):
            bristle[k] = np.clip(bristle[k - 1] + (q[k] - q[k - 1]) / 2e-3, -1, 1)
        rough = np.zeros_like(q)
        for k in range(1, len(t)):
            rough[k] = 0.97 * rough[k - 1] + rng.normal(0, 0.05, 3)
        friction = dry * bristle * (1 + 0.2 * np.exp(-np.abs(v) / 0.1)) + viscous * np.tanh(v) + 0.02 * v**3
        tau = Dynamics(ROBOT).torque(q, v, a) + friction + rough
        late = np.zeros(3)
        if fault is not None:
            tau, late = fault(run, t, q, v, tau)
        servo = np.zeros_like(q)
        for k in range(1, len(t)):
            servo[k] = (tau[k] + DAMPED * RATE * servo[k - 1]) / (STIFF + DAMPED * RATE)
        command = (
            q + servo + 0.004 * v + np.array([np.interp(t + d, t, x) - x for d, x in zip(late, q.T, strict=True)]).T
        )
        read = np.round(q / 1e-5) * 1e-5
        parts.append((t, command, read, tau / PER_AMPERE + rng.normal(0, 0.02, tau.shape), np.full(len(t), run)))
    t, command, read, current, run = (np.concatenate(x) for x in zip(*parts, strict=True))
    return JointLog(t, ("1", "2", "3"), read, command=command, current=current, run=run, source=f"log {seed}")


@cache
def diagnosed(seed, fault=None):
    return diagnose_log(ROBOT, simulated(seed, fault))


def ripple(run, t, q, v, tau):
    tau[:, 1] += 6.0 * np.sin(9 * q[:, 1] + 1) + 1.5 * np.sin(18 * q[:, 1])
    return tau, np.zeros(3)


def contact(run, t, q, v, tau):
    tau[:, 2] += 12.0 * (run == 2) * np.sin(np.pi * np.clip((t - 5) / 1.2, 0, 1)) ** 0.5
    return tau, np.zeros(3)


def late(run, t, q, v, tau):
    return tau, np.array([0.0, 0.03, 0.0])


def late_all(run, t, q, v, tau):
    return tau, np.full(3, 0.03)


def drier(run, t, q, v, tau):
    tau[:, 0] += 8.0 * np.tanh(v[:, 0] / 5e-3)
    return tau, np.zeros(3)


def foreign(run, t, q, v, tau):
    tau[:, 1] += 8.0 * np.sin(2.3 * q[:, 0])
    return tau, np.zeros(3)


def wall(run, t, q, v, tau):
    tau[:, 2] += 6.0 * (run == 2) * (q[:, 2] > -0.75)
    return tau, np.zeros(3)


@pytest.mark.parametrize(("fault", "labels"), [
    (ripple, ["ripple@2"]), (contact, ["contact@3"]), (wall, ["contact@3"]),
    (late, ["transport_delay@2"]), (late_all, ["transport_delay"]),
])  # fmt: skip
def test_named(fault, labels):
    found = diagnosed(1, fault)
    assert [f.label for f in found.fitting] in (labels, [label.replace("transport_delay", "lag") for label in labels])
    assert found.verdict == "explained"
    before, after = found.gap()[1:]
    assert after.sum() < 1.001 * before.sum()


def test_the_time_of_a_contact_is_told():
    log = simulated(1, contact)
    found = diagnose_log(ROBOT, log)
    (joints,) = (b for b in found.blocks() if isinstance(b, Table) and b.columns[-1] == "most at")
    what, low, _, high = joints.rows[2][-1].split()
    assert what == "time"
    began = found.view.motion.time.max() - SECONDS  # the second run
    assert float(low) < began + 5.6 < float(high)


def ripple_and_late(run, t, q, v, tau):
    return ripple(run, t, q, v, tau)[0], np.array([0.0, 0.0, 0.03])


def spring_and_contact(run, t, q, v, tau):
    tau[:, 0] += 9.0 * (q[:, 0] - 0.1)
    return contact(run, t, q, v, tau)


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "labels"), [
    (ripple_and_late, {"ripple@2", "transport_delay@3"}), (spring_and_contact, {"spring@1", "contact@3"}),
])  # fmt: skip
def test_two_causes_of_one_log_are_both_told(fault, labels):
    found = diagnosed(4, fault)
    assert {f.label.replace("lag", "transport_delay") for f in found.fitting} == labels


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_of_a_healthy_arm_nothing_is_named(seed):
    found = diagnosed(seed)
    assert found.verdict == "none"
    assert "What fits" not in str(found.blocks())


def test_what_each_model_leaves_of_the_torque_is_told_of_thirds_that_were_not_fitted():
    """Friction is most of what the true bodies leave; the noise planted, of 0.2 N m and more, stays."""
    found = diagnosed(1)
    left = found.torques.models
    assert list(left) == ["the file's bodies", "fitted bodies", "and friction", "and friction that grows with load"]
    friction, noise = np.array([6.0, 8.0, 3.0]), 0.05 / np.sqrt(1 - 0.97**2)
    np.testing.assert_array_less(0.8 * friction, left["the file's bodies"])
    np.testing.assert_array_less(left["and friction"], 0.25 * friction)
    np.testing.assert_array_less(0.5 * noise, left["and friction"])
    assert re.search(r": fitted bodies \d\d\d? %, and friction 1?\d %", plain_text(found.blocks(), 400))
    assert found.to_json()["torque_by_model"]["and friction"] == left["and friction"].tolist()
    effects = found.torques.effects
    costs = {name: np.sqrt(cost) for name, cost in effects.costs().items()}
    np.testing.assert_allclose(costs["dry friction"], friction, rtol=0.3)
    q = found.view.motion.q
    gravity = Dynamics(ROBOT).torque(q, 0 * q, 0 * q)
    np.testing.assert_allclose(costs["gravity"][1:], np.sqrt((gravity**2).mean(axis=0))[1:], rtol=0.15)
    assert costs["gravity"][0] < 0.05 * costs["dry friction"][0]  # its axis is vertical
    np.testing.assert_allclose(effects.sum_of_parts, effects.before, rtol=0.3)
    assert found.to_json()["torque_effects"]["gravity"] == effects.without["gravity"].tolist()


def test_what_fits_is_true_of_runs_that_were_not_fitted_and_shrinks_their_gap():
    found = diagnosed(1, ripple)
    assert [f.label for f in found.fitting] == ["ripple@2"]
    (_, before, after), (held_out_before, held_out_after) = found.gap(), found.held_out_gap()
    assert held_out_after[1] < 0.5 * held_out_before[1]
    assert (held_out_after > 0.95 * after).all()
    assert (held_out_before > 0.95 * before).all()
    table = found.cause_effects.table()
    assert [row[0] for row in table.rows] == ["everything", "ripple@2", "(in sum)", "nothing"]
    assert table.rows[0][1:] == table.rows[1][1:] == tuple(f"{v:.3g}" for v in held_out_before)
    assert found.to_json()["cause_effects"]["ripple@2"] == pytest.approx(held_out_before)
    assert table in found.blocks()
    assert found.to_json()["joints"][1]["after_left_out"] == pytest.approx(held_out_after[1])


def test_runs_whose_clocks_differ_a_little_are_sampled_alike():
    """Of 125 rows a second every other one is taken; a hair more or less must not change that from run to run."""
    log = simulated(1)
    time = log.time * np.where(log.run == 1, 0.80001, 0.79999)
    motion = motion_of(JointLog(time, log.joints, log.position, log.command, run=log.run), arm_of(ROBOT), (3e-3,))
    counts = np.unique(motion.run, return_counts=True)[1]
    assert np.ptp(counts) <= 1
    np.testing.assert_allclose(np.diff(motion.time)[:-1].min(), motion.step, rtol=1e-6)


def test_with_commands_alone_the_position_error_is_judged():
    log = simulated(2)
    found = diagnose_log(ROBOT, JointLog(log.time, log.joints, log.position, log.command, run=log.run))
    assert found.verdict == "none"
    assert found.to_json()["gap"]["unit"] == "rad"
    model, usual, _ = found.gap()
    np.testing.assert_array_less(usual, 0.25 * model)


def test_of_commands_alone_the_damping_of_a_servo_acts_on_the_speed_or_on_its_error():
    """D on the speed's error moves the command ahead by kd / kp, 33 ms; D on the speed does not."""
    log = simulated(2)
    rates = [np.gradient(log.command[log.run == run], 1 / RATE, axis=0) for run in (1, 2)]
    other = replace(log, command=log.command + DAMPED / STIFF * np.concatenate(rates))
    arm = arm_of(ROBOT)
    views = [log_view(motion_of(replace(one, current=None), arm), arm) for one in (log, other)]
    shift = _prior(views[0])[0][:, 5] - _prior(views[1])[0][:, 5]
    np.testing.assert_allclose(shift, -DAMPED / STIFF)


def test_a_joint_that_never_moves_is_no_cause():
    log = simulated(2)
    held, command = log.position.copy(), log.command.copy()
    held[:, 2], command[:, 2] = 0.1, 0.1
    still = JointLog(log.time, log.joints, held, command, current=log.current, run=log.run)
    assert any("3 never moved" in text for text in diagnose_log(ROBOT, still).to_json()["cannot_tell"])


@pytest.mark.slow
def test_friction_that_has_grown_is_told_with_a_reference_alone():
    log = simulated(1, drier)
    assert not diagnose_log(ROBOT, log).fitting
    assert diagnose_log(ROBOT, log, simulated(7)).found[0].label == "coulomb_friction@1"


def test_what_is_on_no_list_is_not_named():
    found = diagnosed(1, foreign)
    assert not found.fitting
    assert found.verdict in ("unknown", "ambiguous")


@pytest.mark.parametrize(("smooth", "listed"), [(115.0, True), (125.0, False)])
def test_of_the_evidence_of_a_smooth_function_less_counts(smooth, listed):
    names = {f"{name}@2": SimpleNamespace(name=name, listed=name == "lag") for name in ("lag", "unknown")}
    ranking = Posterior.of_variants({("lag@2", 0): 100.0, ("unknown@2", 0): smooth}, dict.fromkeys(names, 0.1), 0.8)
    assert next_cause(SimpleNamespace(by_label=names), ranking).listed is listed


def one_way(run, t, q, v, tau):
    tau[:, 1] += 14 * np.exp(-(((q[:, 1] - 0.7) / 0.12) ** 2)) * np.clip(v[:, 1] / 0.01, 0, 1)
    return tau, np.zeros(3)


@pytest.mark.slow
def test_what_sticks_one_way_alone_is_no_ripple():
    found = diagnose_log(ROBOT, simulated(5, one_way, runs=4))
    first = found.found[0]
    assert not first.listed
    assert "joint 2 by angle, one way" in first.label
    assert not found.fitting


def test_faults_of_the_log_itself():
    log = simulated(2)
    kept = np.random.default_rng(0).uniform(size=len(log)) > 0.05
    (fault,) = diagnose_log(ROBOT, log[kept]).faults
    assert fault.name == "lost_samples"
    lost = (~kept).sum() / (len(log) - 2)  # of the steps of both runs, none lost at their ends
    assert f"missing ({100 * lost:.1f} %) or repeated (0.0 %)" in fault.sentence
    slow = JointLog(log.time * 1.04, log.joints, log.position, log.command, current=log.current, run=log.run)
    found = diagnose_log(ROBOT, slow)
    assert [f.name for f in found.faults] == ["clock_scale"]
    assert found.ranking[0] == {"effect": "clock_scale", "joint": None, "probability": 1.0}
    sizes = replace(log, current=None if log.current is None else np.abs(log.current))
    assert diagnose_log(ROBOT, with_signs(sizes)).verdict == "explained"
    assert [f.name for f in diagnose_log(ROBOT, with_signs(sizes)).faults] == ["unsigned_current"]


def test_gears_yield_to_the_torque_of_the_bodies_and_not_to_friction_at_the_motor():
    log, arm = simulated(1), arm_of(ROBOT)
    yields = [np.zeros_like(log.position[log.run == run]) for run in (1, 2)]
    for run, out in zip((1, 2), yields, strict=True):
        q = log.position[log.run == run]
        v = np.gradient(q, 1 / RATE, axis=0)
        out[:] = arm.regressor(q, v, np.gradient(v, 1 / RATE, axis=0)) @ arm.inertial / 1e4
    elastic = replace(log, command=log.command + np.concatenate(yields))
    soft = replace(arm, joint_stiffness=np.full(3, 1e4))
    rigid, found, before = (
        log_view(motion_of(own, of), of).response.std(axis=0)
        for own, of in ((log, arm), (elastic, soft), (elastic, arm))
    )
    assert (before > 3 * rigid).all()
    assert (found < 1.2 * rigid).all()


def table(log):
    named = {f"q{k + 1}_rad": log.position[:, k] for k in range(3)}
    named |= {f"command{k + 1}_rad": log.command[:, k] for k in range(3)}
    named |= {f"current{k + 1}_A": log.current[:, k] for k in range(3)}
    return pd.DataFrame({"time_s": log.time, "run": log.run, **named})


def test_the_command_recognises_a_log(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["casadical", "diagnose", "arm.toml", "motion.csv"])  # is repeated at the end
    robot, log, out = (str(tmp_path / n) for n in ("arm.toml", "motion.csv", "found.json"))
    table(simulated(1, contact)).to_csv(log, index=False)
    write_robot(ROBOT, robot)
    told = CliRunner().invoke(app, ["diagnose", robot, log, "--json", out])
    assert told.exit_code == 0, told.output
    assert "joint 3: a torque in a short part of one run" in " ".join(told.output.split())
    found = json.loads(Path(out).read_text())
    assert (found["verdict"], found["causes"]) == ("explained", found["fits"])
    assert [(cause["effect"], cause["joint"]) for cause in found["causes"]] == [("contact", 3)]
    assert len(told.output.splitlines()) <= 25
    refused = CliRunner().invoke(app, ["diagnose", robot, log, "--bootstrap", "50"])
    assert "--bootstrap: is for measured poses, not for joint logs" in str(refused.exception)


def pushed(run, t, q, v, tau):
    tau[:, 2] += 15 * np.sign(np.sin(0.4 * t))
    return tau, np.zeros(3)


@pytest.mark.slow
@pytest.mark.parametrize(("change", "sentence"), [
    (lambda t: t.assign(q2_rad=0.7 + 1e-3 * t["q2_rad"]), "joint 2 moves at"),
    (lambda t: t.drop(columns="run").assign(time_s=t["time_s"] - 3 * (t.index > 700)), "time jumps back"),
    (lambda t: t * [1, 1, 1, -1, 1, 1, -1, 1, 1, -1, 1], "joint 2 counts the other way than the model, torque"),
])  # fmt: skip
def test_the_command_says_what_is_odd_in_a_log_and_diagnoses_it(tmp_path, change, sentence):
    change(table(simulated(2))).to_csv(tmp_path / "log.csv", index=False)
    write_robot(ROBOT, tmp_path / "arm.toml")
    campaign = read_logs(tmp_path / "arm.toml", [tmp_path / "log.csv"])
    found = campaign.diagnosed()
    assert sentence in " ".join(plain_text(found.blocks(), 200).split())
    assert "Residual of each joint" in plain_text(found.blocks(), 200)


def test_a_log_that_is_refused_is_not_read_as_poses_as_well(tmp_path):
    log = simulated(2)
    rows = {"action": list(50 * log.command), "observation.state": list(50 * log.position), "timestamp": log.time}
    pd.DataFrame(rows).to_parquet(tmp_path / "log.parquet")
    write_robot(ROBOT, tmp_path / "arm.toml")
    told = CliRunner().invoke(app, ["diagnose", str(tmp_path / "arm.toml"), str(tmp_path / "log.parquet")])
    assert "degrees or, as LeRobot writes" in str(told.exception)
    assert "missing" not in str(told.exception)


@pytest.mark.slow
def test_what_touches_the_arm_all_along_is_told_with_what_would_help():
    told = " ".join(plain_text(diagnosed(2, pushed).blocks(), 200).split())
    assert "log one run in free air; the other joints are judged all the same" in told


def test_motion_without_commands_or_currents_is_a_log_that_says_what_it_lacks(tmp_path):
    table(simulated(2)).filter(regex="time|run|q").to_csv(tmp_path / "log.csv", index=False)
    write_robot(ROBOT, tmp_path / "arm.toml")
    campaign = read_logs(tmp_path / "arm.toml", [tmp_path / "log.csv"])
    with pytest.raises(InputError, match=r"neither commands nor a torque or current.* Log the commanded positions"):
        campaign.diagnosed()


@pytest.mark.slow
def test_a_folder_with_logs_is_diagnosed_by_those_to_be_fitted(tmp_path):
    for name in ("fitted", "kept"):
        table(simulated(1)[:600]).filter(regex="time|q|command").to_csv(tmp_path / f"{name}.csv", index=False)
    write_robot(ROBOT, tmp_path / "robot.toml")
    text = (
        'casadical = 1\ntitle = "arm"\nrobot = "robot.toml"\n[logs]\nidentify = ["fitted.csv"]\nreport = ["kept.csv"]\n'
    )
    (tmp_path / "problem.toml").write_text(text)
    told = CliRunner().invoke(app, ["diagnose", str(tmp_path)])
    assert told.exit_code == 0, told.output
    assert "fitted.csv" in told.output
    assert "kept.csv" not in told.output


@pytest.mark.slow
def test_it_says_what_such_a_log_cannot_tell():
    log = simulated(2)
    told = plain_text(diagnose_log(ROBOT, log).blocks(), 100)
    assert "--reference LOG" in " ".join(told.split())
    silent = JointLog(log.time, log.joints, log.position, current=log.current, run=log.run)
    assert any("log command1_rad" in text for text in diagnose_log(ROBOT, silent).to_json()["cannot_tell"])
    two = JointLog(log.time, log.joints[:2], log.position[:, :2], command=log.command[:, :2], run=log.run)
    with pytest.raises(InputError, match="has 2 joints"):
        diagnose_log(ROBOT, two)


def reached(module):
    """Sources of the package that a module's imports lead to, by module."""
    found, left = {}, [module]
    while left:
        name = left.pop()
        path = ROOT.joinpath(*name.split(".")).with_suffix(".py")
        path = path if path.is_file() else path.with_suffix("") / "__init__.py"
        if name not in found and path.is_file():
            found[name] = ast.parse(path.read_text())
            nodes = [node for node in ast.walk(found[name]) if isinstance(node, ast.ImportFrom) and node.module]
            of = [name for node in nodes for name in (node.module, *(f"{node.module}.{a.name}" for a in node.names))]
            left += [name for name in of if name.startswith("casadical.")]
    return found


@pytest.mark.slow
def test_causes_of_logs_and_of_poses_have_the_same_priors():
    """What judges a log reaches the priors and the posterior of what judges poses."""
    own, poses = (reached(f"casadical.diagnosis.{name}") for name in ("motion.engine", "diagnose"))
    assert {
        f"casadical.diagnosis.{name}" for name in ("posterior", "evidence", "candidates")
    } <= own.keys() & poses.keys()


def test_each_cause_has_sizes_a_phrase_and_a_counterpart_in_mujoco():
    for name, kind in motion_effects().items():
        assert "MuJoCo: " in kind.definition.physics, name
        assert all((kind.definition.signature, kind.definition.confused_with, kind.definition.sizes)), name


TOOTH = """casadical = 2
[[definition]]
name = "worn_tooth"
acts_at = "joints"
signature = "a worn tooth holds the joint near 0.7 rad"
sizes = {push = [0.1, "peak torque"]}
formulas.torque = "push * exp(-((q - 0.7) / 0.12) ** 2)"
"""


def worn(run, t, q, v, tau):
    tau[:, 1] += 10 * np.exp(-(((q[:, 1] - 0.7) / 0.12) ** 2))
    return tau, np.zeros(3)


def test_a_rival_wins_by_its_name_and_is_not_named_as_a_cause():
    """A bump at one angle; a gain that changes between runs; an integrator, whose part follows the torque late."""
    log = simulated(1)
    servo = log.current * PER_AMPERE / STIFF
    wound = np.concatenate([lagged(servo[log.run == k], 1.0, 1 / RATE) for k in (1, 2)])
    switched = replace(log, command=log.command + 0.5 * servo * [0, 1, 0] * (log.run == 2)[:, None])
    integrated = replace(log, command=log.command - 0.8 * wound * [0, 1, 0])
    for one, name in ((simulated(1, worn), "bump"), (switched, "gain_switching"), (integrated, "integrator_windup")):
        found = diagnose_log(ROBOT, one)
        assert found.found[0].label == f"{name}@2"
        assert (found.verdict, found.named) == ("unknown", ())
        words = " ".join(plain_text(found.blocks(), 200).split())
        assert f"no listed cause fits it, but {name.replace('_', ' ')} does: joint 2: " in words


def worn_and_contact(run, t, q, v, tau):
    return contact(run, t, q, v, worn(run, t, q, v, tau)[0])


def test_a_cause_is_named_although_another_joint_has_one_on_no_list():
    found = diagnosed(1, worn_and_contact)
    assert not any(f.listed for f in found.found if joint_of(f.label) == "2")
    assert [f.label for f in found.named] == ["contact@3"]
    assert "in joint 2 is more than on the list" in " ".join(plain_text(found.blocks(), 200).split())


def test_saturation_is_where_torque_or_speed_is_large_and_frees_the_noise_there():
    """The plateau of a torque is as noisy as the torque; a joint is left behind by 1 rad."""
    rng, t = np.random.default_rng(0), np.arange(4000)
    torque = np.clip(np.sin(t / 200), -0.6, 0.6) + rng.normal(0, 0.025, 4000)
    motion = SimpleNamespace(torque=torque[:, None], v=np.cos(t / 200)[:, None], step=1 / 60)
    view = SimpleNamespace(motion=motion, arm=SimpleNamespace(joints=1), response=torque)
    (candidate, signals), (_, by_speed) = _plateaus(view)
    assert candidate.label == "saturation@1"
    flat, mask = np.abs(np.sin(t / 200)) > 0.6, signals[0]["position", 0] != 0
    assert mask[flat].all()
    assert not mask[np.abs(np.sin(t / 200)) < 0.4].any()
    assert ((by_speed[0]["position", 0] != 0) == (np.abs(np.cos(t / 200)) > 0.8)).mean() > 0.95
    used, own = np.ones(4000, dtype=bool), np.array([0])
    for error, detected in ((1.0, True), (1e-3, False)):
        r = rng.normal(0, np.where(flat, error, 1e-3))
        rows = Rows("position", 0, used, r, np.ones((4000, 1)), own, 1e-3, t // 2000, 60.0)
        problem = LogProblem((rows,), np.zeros(1), np.eye(1))
        problem = replace(with_candidates(problem, [(candidate, signals)]), masks=frozenset([0]))
        ranking = problem.rank()
        assert (ranking.log_factor["saturation@1"] > 100) is detected
        assert (ranking.none < 1e-9) is detected
        assert len(problem.with_causes(own).rows) == 2


def test_a_cause_of_ones_own_is_judged_beside_the_list(tmp_path):
    (tmp_path / "tooth.effect.toml").write_text(TOOTH)
    own = own_causes([str(tmp_path / "tooth.effect.toml")])
    found = diagnose_log(ROBOT, simulated(1, worn), own=own)
    assert found.rankings[0].order[0] == "worn_tooth@2"
    assert "joint 2: a worn tooth holds the joint" in " ".join(plain_text(found.blocks(), 200).split())
    with pytest.raises(InputError, match="own ones are files"):
        own_causes(["lag"])
    of_poses = 'formulas.joint = "push * sin(q2)"'
    posed = TOOTH.replace('formulas.torque = "push * exp(-((q - 0.7) / 0.12) ** 2)"', of_poses)
    (tmp_path / "pose.effect.toml").write_text(posed)
    with pytest.raises(InputError, match="worn_tooth is of poses"):
        own_causes([str(tmp_path / "pose.effect.toml")])


PLUG_IN = """
from casadical.effects.definition import Definition, effect_class

Tooth = effect_class(Definition.model_validate({
    "name": "toy_tooth", "on_list": "motion", "acts_at": "joints", "signature": "a tooth of a toy",
    "physics": "It holds near one angle.", "sizes": {"push": (0.1, "peak torque")},
    "formulas": {"torque": "push * exp(-((q - 0.7) / 0.12) ** 2)"},
}), __name__)
"""


@pytest.mark.slow
def test_a_cause_of_an_installed_plug_in_is_judged_beside_the_list(tmp_path, monkeypatch):
    site = installed(tmp_path, "casadical.effects", "toy_tooth = toy_teeth:Tooth", PLUG_IN)
    monkeypatch.syspath_prepend(site)
    effects_by_name.cache_clear()
    motion_effects.cache_clear()
    try:
        assert "toy_tooth" in motion_effects()
        found = diagnose_log(ROBOT, simulated(1, worn))
    finally:
        sys.modules.pop("toy_teeth", None)
        monkeypatch.undo()
        effects_by_name.cache_clear()
        motion_effects.cache_clear()
    assert found.rankings[0].order[0] == "toy_tooth@2"
    assert "toy_tooth" not in motion_effects()


def sure(label: str, gain: float, rival: float = 0.0) -> Found:
    """A cause that is certain, with this log evidence and that of the best unlisted one."""
    return Found(Posterior(0.0, {label: gain}, {label: gain}, {label: 0}), label, True, 1.0, (label,), rival)


@pytest.mark.parametrize(
    ("name", "gain", "rival", "fits"),
    [
        ("spring", 73.0, 72.0, True),
        ("spring", 73.0, 74.0, False),
        ("spring", 71.0, 0.0, False),
        ("torque_constant", 21.0, 0.0, True),
        ("torque_constant", 19.0, 0.0, False),
        ("play", 500.0, 0.0, False),
    ],
)
def test_a_cause_fits_with_more_evidence_than_healthy_logs_and_smooth_functions_have(name, gain, rival, fits):
    assert sure(f"{name}@2", gain, rival).fits is fits


def test_of_one_joint_one_cause_is_named_and_of_commands_alone_none():
    labels = (("lag@1", 400.0), ("saturation@1", 120.0), ("ripple@2", 50.0), ("spring@3", 80.0))
    found = [sure(k, gain) for k, gain in labels]
    for torque, named in ((1.0, ["lag@1", "spring@3"]), (None, [])):
        view = SimpleNamespace(motion=SimpleNamespace(torque=torque))
        assert [f.label for f in LogDiagnosis(None, view, None, found, (), ()).named] == named


@pytest.mark.parametrize(("gain", "torque", "fits"), [(150, None, 0), (160, None, 1), (150, 1.0, 1)])
def test_of_commands_alone_a_cause_of_the_arm_needs_more_than_healthy_logs_have(gain, torque, fits):
    view = SimpleNamespace(motion=SimpleNamespace(torque=torque))
    found = [sure("warm_up", gain)]
    assert bool(LogDiagnosis(None, view, None, found, (), ()).fitting) == fits


@pytest.mark.parametrize(("unit", "factor", "word"), [("", 1e3, "mrad"), ("A", 1.0, "A")])
def test_residuals_of_joints_are_told_in_their_unit(unit: str, factor: float, word: str) -> None:
    gap, log, arm = [np.array([k * 1e-3]) for k in (4, 3, 2)], SimpleNamespace(joints=("a",)), SimpleNamespace(joints=1)
    one = SimpleNamespace(gap=lambda: gap, held_out_gap=lambda: (gap[0], np.array([1e-3])), unit=(unit, ""), log=log)
    one.arm, one._where = arm, lambda j: "-"
    table = LogDiagnosis._gap_table(one)
    assert f"rms [{word}]" in table.title
    assert table.rows == [("a", *(f"{factor * v * 1e-3:.3g}" for v in (4, 3, 2, 1)), "-")]


@pytest.mark.parametrize(("share", "tried"), [(0.999, False), (1.0, True)])
def test_smooth_causes_are_tried_in_joints_that_move_enough(share: float, tried: bool) -> None:
    time = np.linspace(0.0, 1.0, 60)
    q, one = share * MIN_SPAN_RAD * time[:, None], np.ones((60, 1))
    view = SimpleNamespace(motion=SimpleNamespace(q=q, v=one * time[:, None], time=time), variables={"load": q + one})
    rows = [SimpleNamespace(joint=0, used=np.ones(60, dtype=bool), kind="torque")]
    labels = [candidate.label for candidate, _ in smooth_functions(view, rows, np.ones(1))]
    assert ("smooth torque of joint 1 by load" in labels) is tried
    assert bool(labels) is tried

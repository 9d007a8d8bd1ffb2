"""Open-loop replay of joint logs: the response of joints found again, and real motions that were not fitted."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from casadical import Body, InputError, Joint, Robot, read_robot, write_robot
from casadical.cli.root import app
from casadical.core.drive import Drive
from casadical.core.reporting.figure import Figure
from casadical.core.reporting.result import plain_text
from casadical.diagnosis.motion.floor import stops_of
from casadical.diagnosis.motion.replay import replayed
from casadical.diagnosis.motion.response import fitted
from casadical.diagnosis.motion.result import diagnose_log
from casadical.effects import Backlash
from casadical.measurements.logs.log import JointLog, joined
from casadical.measurements.logs.reading import read_log
from casadical.robot.dynamics import Dynamics

ROOT = Path(__file__).parents[2]
GAIN, DRY, DAMPED, LATE = np.array([12.0, 8.0]), np.array([0.5, 0.3]), np.array([0.9, 0.4]), 0.03
STEP, FINE = 0.02, 0.0005


@pytest.fixture(scope="module")
def arm():
    body = Body(0.5, np.array([0.15, 0.0, 0.0]), np.diag([1e-3, 1e-3, 1e-3]))
    joints = (Joint(alpha=np.pi / 2, body=body), Joint(a=0.25, body=body))
    return Robot(name="two servos", joints=joints)


def moved(robot, seed, seconds=24.0, stop=-np.inf):
    """A log of small steps of an explicit integration, dry friction smoothed over a small speed.

    stop : angle below which the second joint does not come
    """
    rng, n = np.random.default_rng(seed), round(seconds / FINE)
    t = FINE * np.arange(n)
    w, phase = rng.uniform(0.4, 2.5, (3, 2, 1)), rng.uniform(0, 6, (3, 2, 1))
    command = 0.3 * np.sin(w * t + phase).sum(axis=0).T
    command[(t % 6) > 4.5] = command[np.searchsorted(t, t[(t % 6) > 4.5] // 6 * 6 + 4.5)]
    load = Dynamics(robot).torque(command, *[np.zeros_like(command)] * 2)
    inertia, q, v, out = np.array([0.03, 0.015]), command[0].copy(), np.zeros(2), np.empty_like(command)
    for k in range(n):
        wanted = command[max(0, k - round(LATE / FINE))]
        force = GAIN * (wanted - q) - DAMPED * v - load[k]
        v = v + FINE * (force - DRY * np.tanh(v / 3e-4)) / (inertia + FINE * DRY / 3e-4)
        q = q + FINE * v
        if q[1] < stop:
            q[1], v[1] = stop, 0.0
        out[k] = q
    every = slice(None, None, round(STEP / FINE))
    noise = rng.normal(0, 5e-4, out[every].shape)
    return JointLog(t[every], ("a", "b"), out[every] + noise, command[every], source=f"run {seed}")


def test_a_planted_response_is_found_and_predicts_other_runs(arm):
    logs = [moved(arm, seed) for seed in (1, 2)]
    found = replayed(arm, logs, [moved(arm, 3)])
    assert found.held_out
    assert (found.after < 0.1 * found.before).all()
    r = found.response
    for name, planted in (("gain", GAIN), ("friction", DRY), ("damping", DAMPED)):
        np.testing.assert_allclose(getattr(r, name), planted, rtol=0.25)
    np.testing.assert_allclose(r.delay, LATE, atol=0.012)
    np.testing.assert_allclose(r.friction / r.gain, DRY / GAIN, rtol=0.1)


def test_the_effect_table_shows_what_each_effect_costs(arm, monkeypatch):
    """An arm with dry friction, and one without: the row that leaves friction out says so."""
    rough = replayed(arm, [moved(arm, seed, 12.0) for seed in (1, 2)])
    found, band = rough.effects, int(np.argmax(DRY / GAIN))
    words = plain_text(rough.blocks(), 400)
    said = re.search(rf"Dry friction holds {rough.runs[0].joints[band]} up to ([\d.]+) mrad", words)
    assert float(said[1]) == pytest.approx(1e3 * DRY[band] / GAIN[band], rel=0.1)
    half = re.search(rf"{said[0]}[^;]*; twice the gain kp leaves ([\d.]+) mrad", words)
    assert float(half[1]) == pytest.approx(float(said[1]) / 2, rel=0.06)  # two digits
    droop = re.search(r"Gravity moves (.+?) up to ([\d.]+) mrad", words)
    j, none = rough.runs[0].joints.index(droop[1]), np.zeros((1, 2))
    steep = [np.abs(Dynamics(arm).torque(q[None], none, none)[0, j]) for run in rough.runs for q in run.command]
    assert float(droop[2]) == pytest.approx(1e3 * max(steep) / GAIN[j], rel=0.1)
    monkeypatch.setattr(f"{__name__}.DRY", np.array([1e-4, 1e-4]))
    slippery = replayed(arm, [moved(arm, seed, 12.0) for seed in (1, 2)])
    with_it, none = (np.sqrt(each.costs()["dry friction"]) for each in (found, slippery.effects))
    np.testing.assert_array_less(0.02, with_it)
    np.testing.assert_array_less(none, 0.002)
    assert "dry friction" in slippery.effects.sentence.partition("; ")[2]
    assert "dry friction" not in found.sentence.partition("; ")[2]
    assert "Dry friction holds" not in plain_text(slippery.blocks(), 400)
    written = slippery.to_json()
    assert written["summary"] == slippery.effects.sentence
    np.testing.assert_allclose(written["effects"]["delay"], slippery.effects.without["delay"], rtol=1e-6)


def with_current(log, stop):
    """A log with a current without its sign, which rises where the second command is beyond a stop."""
    current = np.full_like(log.position, 0.05)
    current[log.command[:, 1] < stop, 1] = 2.0
    return replace(log, current=current, current_unsigned=True)


def pendulum(seed, dry=0.12, late=LATE):
    """A robot of one servo under gravity, and two runs: small explicit steps, dry friction by a smoothed sign."""
    body = Body(0.5, np.array([0.15, 0.0, 0.0]), np.diag([1e-3, 1e-3, 1e-3]))
    drive = Drive(kp_Nm_per_rad=12.0, kd_Nms_per_rad=0.6, delay_s=LATE, rotor_inertia_at_joint_kgm2=0.02)
    robot = Robot(name="pendulum", joints=(Joint(alpha=np.pi / 2, body=body),), drive=drive)
    rng, n, runs = np.random.default_rng(seed), round(24 / FINE), []
    t, inertia, none = FINE * np.arange(n), 0.02 + 0.5 * 0.15**2 + 1e-3, np.zeros((1, 1))
    for number in (1, 2):
        w, phase = rng.uniform(0.4, 2.5, (3, 1)), rng.uniform(0, 6, (3, 1))
        command = 0.25 * np.sin(w * t + phase).sum(axis=0)
        pull = Dynamics(robot).torque(none, none, none)[0, 0]
        q, v, out = command[0], 0.0, np.empty(n)
        for k in range(n):
            force = 12.0 * (command[max(0, k - round(late / FINE))] - q) - 0.9 * v - pull * np.cos(q)
            v += FINE * (force - dry * np.tanh(v / 3e-4)) / (inertia + FINE * dry / 3e-4)
            q += FINE * v
            out[k] = q
        every = slice(None, None, round(STEP / FINE))
        noisy = (out[every] + rng.normal(0, 5e-4, out[every].shape))[:, None]
        runs.append(JointLog(t[every], ("a",), noisy, command[every, None], source=f"run {seed}, {number}"))
    return robot, joined(runs)


@pytest.mark.slow
def test_a_later_servo_is_told_and_friction_is_not_without_a_reference():
    robot, healthy = pendulum(1)
    assert not diagnose_log(robot, pendulum(3, 0.13)[1], healthy).found
    found = diagnose_log(robot, pendulum(2, late=LATE + 0.08)[1], healthy)
    assert found.found[0].label.partition("@")[0] in ("transport_delay", "lag")
    assert found.gap()[2][0] < 0.1 * found.gap()[0][0]
    alone = diagnose_log(robot, pendulum(2, 0.4)[1])
    assert not any("friction" in label for label in alone.rankings[0].order)
    assert "Friction cannot be judged without a log of the healthy arm" in plain_text(alone.blocks(), 400)


@pytest.mark.parametrize("unsigned", [True, False])
def test_a_stop_is_named_with_its_angle_and_replayed(arm, unsigned):
    logs = [moved(arm, seed, 12.0, -0.25) for seed in (1, 2)]
    logs = [with_current(log, -0.25) for log in logs] if unsigned else logs
    answer = diagnose_log(arm, logs[0])
    assert answer.verdict == "explained"
    (cause,) = answer.to_json()["causes"]
    assert (cause["effect"], cause["joint"]) == ("contact", 2)
    assert cause["angle_rad"] == pytest.approx(-0.25, abs=2e-3)
    assert "b stops at -0.25 rad (-14 deg)" in plain_text(answer.blocks(), 400)
    found = replayed(arm, logs[:1], logs[1:])
    assert found.after[1] < 0.01
    assert found.effects.without["stops"][1] > 0.05
    friction = next(block for block in found.blocks() if isinstance(block, Figure) and block.name == "replay/friction")
    assert max(len(s.x) for s in friction.series if s.name != "found") > 10  # speeds


def test_droop_stiction_and_lag_are_no_stop(arm):
    """Nor is a reading that stays where the current does not rise."""
    assert not stops_of(Dynamics(arm), [moved(arm, seed, 12.0) for seed in (1, 2, 3)])
    assert not stops_of(Dynamics(arm), [with_current(moved(arm, 1, 12.0, -0.25), -np.inf)])


@pytest.mark.slow
def test_runs_are_withheld_in_turn_where_none_are_kept_apart(arm):
    found = replayed(arm, [moved(arm, seed, 12.0) for seed in (4, 5)])
    assert found.held_out
    assert len(found.runs) == 2
    assert (found.after < 0.2 * found.before).all()
    alone = replayed(arm, [moved(arm, 4, 12.0)])
    assert not alone.held_out
    assert "log a second motion" in plain_text(alone.blocks(), 200)


@pytest.mark.slow
def test_prediction_knows_nothing_of_the_readings_but_the_first(arm):
    log = moved(arm, 6, 6.0)
    (response,) = fitted(arm, [log])
    other = np.concatenate([log.position[:1], np.zeros((len(log) - 1, 2))])
    blind = JointLog(log.time, log.joints, other, log.command)
    np.testing.assert_array_equal(response.predicted(blind), response.predicted(log))


@pytest.mark.slow
def test_without_commands_there_is_no_replay(arm):
    log = moved(arm, 6, 6.0)
    with pytest.raises(InputError, match="no commands, and so no replay"):
        fitted(arm, [JointLog(log.time, log.joints, log.position, torque=np.zeros_like(log.position))])


@pytest.mark.slow
def test_real_motions_of_an_so101_that_were_not_fitted():
    robot = read_robot(ROOT / "problems" / "so101" / "robot.toml")
    names = ("wave_motion", "staircase_motion", "reach_and_return", "circular_motion")
    logs = [read_log(ROOT / "data" / "so101_logs" / f"{name}.csv.gz", robot) for name in (*names, "symmetric_motion")]
    found = replayed(robot, logs[:-1], logs[-1:])
    assert (1e3 * found.before[:5] > [20, 35, 55, 15, 15]).all()
    assert (found.after[:5] < 0.25 * found.before[:5]).all()


@pytest.mark.slow
def test_rounding_of_readings_moves_no_parameter():
    """Each step multiplied it where the cost has kinks: processors ended at dampings that differed by 6e-4."""
    robot = read_robot(ROOT / "problems" / "so101" / "robot.toml")
    log = read_log(ROOT / "data" / "so101_logs" / "circular_motion.csv.gz", robot)
    rounding = 1 + 2e-16 * np.random.default_rng(0).standard_normal(log.position.shape)
    one, other = (fitted(robot, [each])[0] for each in (log, replace(log, position=rounding * log.position)))
    for name in ("gain", "friction", "damping", "inertia", "delay"):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=1e-9)


def test_the_command_replays_and_keeps_the_drives_in_a_robot_file(arm, tmp_path):
    for seed in (1, 2):
        log = moved(arm, seed, 8.0)
        columns = {"time_s": log.time}
        columns |= {f"command{k}_rad": log.command[:, k - 1] for k in (1, 2)}
        columns |= {f"q{k}_rad": log.position[:, k - 1] for k in (1, 2)}
        pd.DataFrame(columns).to_csv(tmp_path / f"log{seed}.csv", index=False)
    write_robot(arm, tmp_path / "arm.toml")
    asked = ["diagnose", *(str(tmp_path / name) for name in ("arm.toml", "log1.csv", "log2.csv"))]
    told = CliRunner().invoke(app, [*asked, "--out", str(tmp_path / "out"), "--json", str(tmp_path / "found.json")])
    assert told.exit_code == 0, told.output
    assert told.output.index("usual arm") < told.output.index("Replays without one effect")
    found = json.loads((tmp_path / "found.json").read_text())["replay"]
    assert found["held_out"]
    kept = read_robot(tmp_path / "out" / "diagnosed.robot.toml")
    assert kept.drive is not None
    assert kept.drive.table() == found["drive"]
    assert kept.drive.friction is not None


@pytest.mark.slow
def test_a_joint_that_was_sent_nowhere_gets_no_response_of_its_own(arm):
    log = moved(arm, 7, 12.0)
    still = np.full(len(log), 0.2)
    held = JointLog(log.time, log.joints, np.column_stack([log.position[:, 0], still]),
                    np.column_stack([log.command[:, 0], still]), source="held")  # fmt: skip
    found = replayed(arm, [held], [moved(arm, 8, 12.0)])
    assert list(found.response.moved) == [True, False]
    assert "Did not move in the fitted runs: b" in plain_text(found.blocks(), 200)
    assert found.after[1] < 1.2 * found.before[1]


@pytest.mark.slow
def test_the_report_of_logs_shows_errors_friction_and_hysteresis(arm, tmp_path):
    pytest.importorskip("plotly")
    replay = replayed(arm, [moved(arm, 1, 12.0)], [moved(arm, 2, 12.0)])
    figures = {block.name: block for block in replay.blocks() if isinstance(block, Figure)}
    assert set(figures) == {"replay/errors", "replay/friction", "replay/hysteresis"}
    assert len(figures["replay/friction"].panels) == 2
    law = next(s for s in figures["replay/friction"].series if s.name == "found")
    assert law.y[-1] == pytest.approx(DRY[0] + DAMPED[0] * law.x[-1], rel=0.25)


@pytest.mark.slow
def test_effects_of_poses_and_drives_of_logs_live_in_one_file(arm, tmp_path):
    with_both = arm.with_effect(Backlash(2))
    path = tmp_path / "diagnosed.robot.toml"
    path.write_text(replayed(with_both, [moved(with_both, 6, 6.0)]).files(tmp_path)[path], encoding="utf-8")
    kept = read_robot(path)
    assert [e.label for e in kept.effects] == ["backlash@2"]
    assert kept.drive is not None
    assert kept.drive.damping is not None


@pytest.mark.slow
def test_what_an_earlier_log_told_stays_where_a_later_one_moves_nothing(arm):
    (before,) = fitted(arm, [moved(arm, 1, 12.0)])
    log = moved(arm, 9, 8.0)
    still = np.full(len(log), 0.2)
    held = JointLog(log.time, log.joints, np.column_stack([log.position[:, 0], still]),
                    np.column_stack([log.command[:, 0], still]))  # fmt: skip
    (after,) = fitted(before.robot(), [held])
    for name in ("gain", "friction", "damping", "delay"):
        assert getattr(after, name)[1] == pytest.approx(getattr(before, name)[1], rel=0.2)

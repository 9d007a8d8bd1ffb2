"""Models that move as `[drive]` says: MuJoCo alone replays real commands as casadical does; URDF and JSON by names."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from casadical import Body, InputError, Joint, Robot, read_robot, robot_model, write_robot
from casadical.core.drive import Drive
from casadical.core.reporting.result import plain_text
from casadical.diagnosis.motion.replay import Replay, replayed
from casadical.diagnosis.motion.response import fitted, limits_of, response_of
from casadical.measurements.logs.log import JointLog
from casadical.measurements.logs.reading import read_log

ROOT = Path(__file__).parents[3]
FITTED = ("wave_motion", "circular_motion", "perturbation_test", "hold_under_gravity")
DRIVE = Drive(
    kp_Nm_per_rad=6.0, damping_Nms_per_rad=[0.4] * 6, friction_Nm=0.05, rotor_inertia_at_joint_kgm2=0.01,
    delay_s=0.012, torque_limit_Nm=3.0, bias_Nm=-0.02, command_filter_s=0.01,
)  # fmt: skip


@pytest.fixture(scope="module")
def so101():
    return read_robot(ROOT / "problems" / "so101" / "robot.toml")


def logged(robot, name):
    return read_log(ROOT / "data" / "so101_logs" / f"{name}.csv.gz", robot)


@pytest.fixture(scope="module")
def response(so101):
    return fitted(so101, [logged(so101, name) for name in FITTED])[0]


def of_file(robot, path, form):
    write_robot(robot, path)
    return robot_model(path, form)


def driven(mujoco, text, log):
    """Readings of a model that is loaded by MuJoCo and gets the commands of a log, interpolated; and torques."""
    model = mujoco.MjModel.from_xml_string(text)
    data, t = mujoco.MjData(model), log.time - log.time[0]
    data.qpos[:], out, torque = log.position[0], np.empty_like(log.position), np.empty_like(log.position)
    for k, now in enumerate(t):
        while data.time < now - 1e-9:
            data.ctrl[:] = [np.interp(data.time, t, column) for column in log.command.T]
            mujoco.mj_step(model, data)
        out[k], torque[k] = data.qpos, data.actuator_force
    return out, torque


@pytest.mark.slow
@pytest.mark.parametrize(("motion", "joints"), [("symmetric_motion", slice(5)), ("figure_eight", slice(1, 2))])
def test_mujoco_alone_replays_real_commands_as_well(so101, tmp_path, response, motion, joints):
    """In figure_eight the tool rests on a table time and again; what was fitted has that once, in another pose."""
    mujoco = pytest.importorskip("mujoco")
    log = logged(so101, motion)
    found = Replay(response, (log,), (response,), (response.predicted(log),), True)
    made = of_file(response.robot(), tmp_path / "arm.toml", "mjcf")
    left = np.sqrt(((log.position - driven(mujoco, made.text, log)[0]) ** 2).mean(axis=0))
    assert (left[joints] < 1.15 * found.after[joints]).all()
    assert (left[joints] < 0.4 * found.before[joints]).all()


PLANTED = Drive(
    kp_Nm_per_rad=[40.0, 25.0], friction_Nm=[0.9, 0.5], damping_Nms_per_rad=[2.5, 1.2],
    rotor_inertia_at_joint_kgm2=0.05, delay_s=0.01, floor_m=-0.13,
)  # fmt: skip


def recorded(mujoco, text, seed, seconds=24.0):
    """Position and torque of a planted arm that MuJoCo moves; commands go some 50 mm below its floor."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 0.02)
    w, phase = rng.uniform(0.4, 2.5, (3, 2, 1)), rng.uniform(0, 6, (3, 2, 1))
    command = 0.3 * np.sin(w * t + phase).sum(axis=0).T
    log = JointLog(t, ("a", "b"), command, command, source=f"run {seed}")
    q, torque = driven(mujoco, text, log)
    return replace(log, position=q + rng.normal(0, 5e-4, q.shape), torque=torque)


@pytest.mark.slow
def test_position_torque_and_floor_of_an_arm_in_mujoco_come_back(tmp_path):
    """Found from logs of a planted arm, the exported model gives another run: positions as printed, torques to 3 %."""
    mujoco = pytest.importorskip("mujoco")
    body = Body(0.5, np.array([0.15, 0.0, 0.0]), np.diag([1e-3, 1e-3, 1e-3]))
    arm = Robot(name="two servos", joints=(Joint(alpha=np.pi / 2, body=body), Joint(a=0.25, body=body)))
    truth = of_file(replace(arm, drive=PLANTED), tmp_path / "truth.toml", "mjcf").text
    logs = [recorded(mujoco, truth, seed) for seed in (2, 3)]
    for seed in (8, 5):  # off the floor; and on it, too
        log = recorded(mujoco, truth, seed)
        found = replayed(arm, logs, [log])
        assert found.response.floor.height == pytest.approx(-0.13, abs=2e-3)
        assert (found.after < 0.05 * found.before).all()
        made = of_file(found.response.robot(), tmp_path / "arm.toml", "mjcf").text
        q, torque = driven(mujoco, made, log)
        after = [np.sqrt(((a - b) ** 2).mean(axis=0)) for a, b in ((q, log.position), (torque, log.torque))]
        assert (after[0] < 1.15 * found.after + 1e-4).all()
        assert (after[1] < 0.03 * np.sqrt((log.torque**2).mean(axis=0))).all()
    assert "rests on a surface" in " ".join(plain_text(found.blocks(), 120).split())
    known = replace(arm, drive=found.response.drive())
    assert fitted(known, [recorded(mujoco, truth, 8)])[0].floor.height == found.response.drive().floor


def test_the_model_has_what_the_drive_says(so101, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    made = of_file(replace(so101, drive=DRIVE), tmp_path / "arm.toml", "mjcf")
    model = mujoco.MjModel.from_xml_string(made.text)
    # The delay of 12 ms and the filter of 10 ms are in damping and armature.
    np.testing.assert_allclose(model.dof_damping, 0.4 + 6.0 * 0.022)
    np.testing.assert_allclose(model.dof_armature, 0.01 + 0.4 * 0.022 + 6.0 * (0.012**2 / 2 + 0.012 * 0.01))
    assert model.na == model.nhistory == 0
    np.testing.assert_allclose(model.dof_frictionloss, 0.05)
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], 6.0)
    np.testing.assert_allclose(model.actuator_biasprm[:, :2], [[0.02, -6.0]] * 6)
    np.testing.assert_allclose(model.actuator_forcerange, [[-3.0, 3.0]] * 6)
    np.testing.assert_allclose(
        model.body("link2").inertia, np.sort(np.linalg.eigvalsh(so101.joints[1].body.inertia))[::-1]
    )
    assert "contain the delay of commands (up to 12 ms)" in made.text
    names = [row.name for row in so101.joints]
    assert [model.joint(i).name for i in range(6)] == names
    assert [model.actuator(i).name for i in range(6)] == names
    assert [model.actuator(i).trnid[0] for i in range(6)] == list(range(6))


@pytest.mark.parametrize(("delay", "within"), [(0.03, 1.5), (0.1, 12.0)])
def test_the_delay_within_damping_moves_as_mujocos_own_delay_does(so101, tmp_path, delay, within):
    """MuJoCo's delay, its history filled by hand, is the oracle; the model itself starts without that, off its zero."""
    mujoco = pytest.importorskip("mujoco")
    robot = replace(so101, drive=DRIVE.model_copy(update={"delay": None, "command_filter": None}))
    root = ET.fromstring(of_file(robot, tmp_path / "undelayed.toml", "mjcf").text)
    for node in root.iterfind("actuator/*"):
        node.attrib.update(delay=str(delay), nsample="60", interp="linear")
    delayed = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    late = replace(robot, drive=robot.drive.model_copy(update={"delay": delay}))
    made = mujoco.MjModel.from_xml_string(of_file(late, tmp_path / "late.toml", "mjcf").text)
    first, settled = np.full(6, 0.5), mujoco.MjData(made)
    settled.qpos[:] = settled.ctrl[:] = first
    mujoco.mj_step(made, settled, 2000)
    states, apart = [mujoco.MjData(model) for model in (delayed, made)], []
    for data in states:
        data.qpos[:] = settled.qpos
    for i in range(6):
        mujoco.mj_initCtrlHistory(delayed, states[0], i, None, np.full((60, 1), first[i]))
    for k in range(4000):
        for model, data in zip((delayed, made), states, strict=True):
            data.ctrl[:] = first + 0.3 * np.sin(2 * 0.002 * k)
            mujoco.mj_step(model, data)
        apart.append(states[1].qpos - states[0].qpos)
    assert 1e3 * np.sqrt((np.array(apart) ** 2).mean(axis=0)).max() < within


def test_drives_come_back_as_the_response_that_was_exported(so101):
    """Stops of one joint, and a floor, too."""
    stops = {"lower_stop": [-2.0, -1.8, -1.8, -1.7, -1.03, -0.3], "upper_stop": [2.0, 1.8, 1.8, 1.7, 3.0, 1.9]}
    r = response_of(replace(so101, drive=DRIVE.model_copy(update={**stops, "floor": 0.05})))
    again = response_of(r.robot())
    for name in ("gain", "bias", "friction", "damping", "inertia", "delay"):
        np.testing.assert_allclose(getattr(again, name), getattr(r, name), rtol=1e-3)
    assert again.floor.height == 0.05
    assert limits_of(again.stops, 6)[0].tolist() == stops["lower_stop"]


def test_a_stop_is_the_end_of_the_joints_range(tmp_path):
    """Found in a log of an arm that MuJoCo moves against a limit of its own, the exported model stops there, too."""
    mujoco = pytest.importorskip("mujoco")
    body = Body(0.5, np.array([0.15, 0.0, 0.0]), np.diag([1e-3, 1e-3, 1e-3]))
    joints = (Joint(alpha=np.pi / 2, body=body, name="pan"), Joint(a=0.25, body=body, name="tilt"))
    arm = Robot(name="two servos", joints=joints)
    planted = PLANTED.model_copy(update={"floor": None})
    truth = ET.fromstring(of_file(replace(arm, drive=planted), tmp_path / "truth.toml", "mjcf").text)
    next(node for node in truth.iter("joint") if node.get("name") == "tilt").set("range", "-0.25 3")
    text = ET.tostring(truth, encoding="unicode")
    logs = [recorded(mujoco, text, seed, 12.0) for seed in (1, 2)]
    found = replayed(arm, logs[:1], logs[1:])
    made = of_file(found.response.robot(), tmp_path / "arm.toml", "mjcf")
    model = mujoco.MjModel.from_xml_string(made.text)
    assert model.joint("tilt").range[0] == pytest.approx(-0.25, abs=3e-3)
    assert model.joint("pan").range[0] < -3.0
    left = np.sqrt(((driven(mujoco, made.text, logs[1])[0] - logs[1].position) ** 2).mean(axis=0))
    assert (left < 1.2 * found.after + 1e-3).all()


def test_export_replays_a_log_in_mujoco(so101, tmp_path, monkeypatch):
    """What the export says of a log is what MuJoCo, stepped here, does; and without MuJoCo it says so."""
    mujoco = pytest.importorskip("mujoco")
    write_robot(replace(so101, drive=DRIVE.model_copy(update={"command_filter": None})), tmp_path / "arm.toml")
    path = ROOT / "data" / "so101_logs" / "reach_and_return.csv.gz"
    made, log = robot_model(tmp_path / "arm.toml", "mjcf", campaign=path), logged(so101, "reach_and_return")
    told = re.search(r"([\d.]+) mrad rms before, ([\d.]+) with this model", made.lines[-1])
    for said, angles in zip(told.groups(), (log.command, driven(mujoco, made.text, log)[0]), strict=True):
        assert float(said) == pytest.approx(1e3 * np.sqrt(((log.position - angles) ** 2).mean()), rel=0.02)
    alone = robot_model(tmp_path / "arm.toml", "mjcf").lines[-1]
    assert float(re.search(r"([\d.]+) mrad rms from", alone)[1]) < 10
    still = replace(so101, drive=None)
    write_robot(still, tmp_path / "still.toml")
    with pytest.raises(InputError, match="a joint log, and no drives to replay it"):
        robot_model(tmp_path / "still.toml", "mjcf", campaign=path)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert "not replayed in MuJoCo" in robot_model(tmp_path / "arm.toml", "mjcf").lines[-1]


def test_what_mujoco_cannot_hold_is_said_in_units(so101, tmp_path):
    drive = DRIVE.model_copy(update={"ki": 1.0, "joint_stiffness": 500.0, "speed_limit": 2.0})
    lines = of_file(replace(so101, drive=drive), tmp_path / "arm.toml", "mjcf").lines
    assert [line.split(":")[0] for line in lines[:-1]] == [
        "LEFT OUT integral gain", "LEFT OUT gear springs behind the motor's encoder", "LEFT OUT speed limit of 2 rad/s",
    ]  # fmt: skip
    assert "mrad" in lines[0]
    assert "mrad" in lines[1]


def test_a_drive_of_gains_alone_changes_no_model(so101, tmp_path):
    gains = Drive(kp_Nm_per_rad=6.0)
    with_gains = of_file(replace(so101, drive=gains), tmp_path / "a.toml", "mjcf").text
    assert with_gains == of_file(replace(so101, drive=None), tmp_path / "b.toml", "mjcf").text
    with pytest.raises(InputError, match="lacking: damping, friction, rotor_inertia_at_joint"):
        robot_model(tmp_path / "a.toml", "actuators")


def test_a_urdf_has_damping_and_friction(so101, tmp_path):
    root = ET.fromstring(of_file(replace(so101, drive=DRIVE), tmp_path / "arm.toml", "urdf").text)
    dynamics = [node.attrib for node in root.iter("dynamics")]
    assert dynamics == [{"damping": "0.4", "friction": "0.05"}] * 6


def test_actuators_by_joint_names(so101, tmp_path):
    made = of_file(replace(so101, drive=DRIVE), tmp_path / "arm.toml", "actuators")
    found = json.loads(made.text)
    assert found["stiffness"] == {row.name: 6.0 for row in so101.joints}
    assert found["delay_s"]["elbow_flex"] == 0.012
    assert set(found) >= {"damping", "friction", "armature", "effort_limit", "constant_torque"}

"""Models that move as `[drive]` says: MuJoCo alone replays real commands as casadical does; URDF and JSON by names."""

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from casadical import InputError, read_robot, robot_model, write_robot
from casadical.core.drive import Drive
from casadical.diagnosis.motion.replay import replayed
from casadical.measurements.logs.reading import read_log

ROOT = Path(__file__).parents[3]
FITTED = ("wave_motion", "staircase_motion", "reach_and_return", "circular_motion")
DRIVE = Drive(
    kp_Nm_per_rad=6.0, damping_Nms_per_rad=[0.4] * 6, friction_Nm=0.05, rotor_inertia_at_joint_kgm2=0.01,
    delay_s=0.012, torque_limit_Nm=3.0, bias_Nm=-0.02, command_filter_s=0.01,
)  # fmt: skip


@pytest.fixture(scope="module")
def so101():
    return read_robot(ROOT / "problems" / "so101" / "robot.toml")


def of_file(robot, path, form):
    write_robot(robot, path)
    return robot_model(path, form)


def driven(mujoco, text, log):
    """Readings of a model that is loaded by MuJoCo and gets the commands of a log, interpolated."""
    model = mujoco.MjModel.from_xml_string(text)
    data, t = mujoco.MjData(model), log.time - log.time[0]
    data.qpos[:], out = log.position[0], np.empty_like(log.position)
    for i in range(model.nu):
        if samples := int(model.actuator_history[i, 0]):
            mujoco.mj_initCtrlHistory(model, data, i, None, np.full((samples, 1), log.command[0, i]))
    for k, now in enumerate(t):
        while data.time < now - 1e-9:
            data.ctrl[:] = [np.interp(data.time, t, column) for column in log.command.T]
            mujoco.mj_step(model, data)
        out[k] = data.qpos
    return out


def test_mujoco_alone_replays_real_commands_as_well(so101, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    logs = [read_log(ROOT / "data" / "so101_logs" / f"{name}.csv.gz", so101) for name in (*FITTED, "symmetric_motion")]
    found = replayed(so101, logs[:-1], logs[-1:])
    made = of_file(found.response.robot(), tmp_path / "arm.toml", "mjcf")
    left = np.sqrt(((logs[-1].position - driven(mujoco, made.text, logs[-1])) ** 2).mean(axis=0))
    assert (left < 1.15 * found.after).all()
    assert (left[:5] < 0.4 * found.before[:5]).all()


def test_the_model_has_what_the_drive_says(so101, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    made = of_file(replace(so101, drive=DRIVE), tmp_path / "arm.toml", "mjcf")
    model = mujoco.MjModel.from_xml_string(made.text)
    np.testing.assert_allclose(model.dof_armature, 0.01)
    np.testing.assert_allclose(model.dof_damping, 0.4)
    np.testing.assert_allclose(model.dof_frictionloss, 0.05)
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], 6.0)
    np.testing.assert_allclose(model.actuator_biasprm[:, :2], [[0.02, -6.0]] * 6)
    np.testing.assert_allclose(model.actuator_forcerange, [[-3.0, 3.0]] * 6)
    np.testing.assert_allclose(model.actuator_delay, 0.012)
    np.testing.assert_allclose(model.actuator_dynprm[:, 0], 0.01)
    np.testing.assert_allclose(
        model.body("link2").inertia, np.sort(np.linalg.eigvalsh(so101.joints[1].body.inertia))[::-1]
    )
    assert made.lines == ()


def test_what_mujoco_cannot_hold_is_said_in_units(so101, tmp_path):
    drive = DRIVE.model_copy(update={"ki": 1.0, "joint_stiffness": 500.0, "speed_limit": 2.0})
    lines = of_file(replace(so101, drive=drive), tmp_path / "arm.toml", "mjcf").lines
    assert [line.split(":")[0] for line in lines] == [
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

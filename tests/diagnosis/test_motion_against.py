"""Published parameters beside a planted arm's logs: true ones are not contradicted, a wrong one is, and it alone."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_motion_replay import DAMPED, DRY, GAIN, LATE, moved
from typer.testing import CliRunner

from casadical import Body, InputError, Joint, Robot, read_robot, write_robot
from casadical.cli.root import app
from casadical.diagnosis.motion.against import read_parameters
from casadical.diagnosis.motion.replay import replayed

BODY = Body(0.5, np.array([0.15, 0.0, 0.0]), np.diag([1e-3, 1e-3, 1e-3]))
ARM = Robot(name="two servos", joints=(Joint(alpha=np.pi / 2, body=BODY, name="a"), Joint(a=0.25, body=BODY, name="b")))
MJCF = """
<mujoco>
  <default>
    <joint damping="0.3"/>
    <default class="servo">
      <joint frictionloss="0.1" armature="0.02"/>
      <position kp="50" kv="0.5"/>
      <default class="strong"><position kp="80"/></default>
    </default>
  </default>
  <worldbody>
    <body childclass="servo">
      <joint name="a" axis="0 0 1"/><geom size="0.1"/>
      <body><joint name="b" axis="0 1 0" frictionloss="0.4" damping="0.7"/><geom size="0.1"/></body>
    </body>
  </worldbody>
  <actuator>
    <position class="strong" joint="b"/>
    <general joint="a" gear="2" gainprm="30" biastype="affine" biasprm="0 -30 -0.25"/>
  </actuator>
</mujoco>
"""


def table(path, **columns):
    pd.DataFrame({"joint": ["b", "a"], **{name: v[::-1] for name, v in columns.items()}}).to_csv(path, index=False)
    return path


def test_blanks_behind_commas_are_no_part_of_names(tmp_path):
    (tmp_path / "a.csv").write_text("joint, kp, friction\na, 3, 0.5\nb, 4, 0.25\n")
    found = read_parameters(tmp_path / "a.csv", ARM)
    assert (found["kp"].tolist(), found["friction"].tolist()) == ([3.0, 4.0], [0.5, 0.25])


def test_true_parameters_are_not_contradicted_and_a_wrong_one_is(tmp_path):
    planted = {"kp": GAIN, "friction": DRY, "damping": DAMPED, "delay": np.full(2, LATE)}
    true = table(tmp_path / "true.csv", **planted)
    wrong = table(tmp_path / "wrong.csv", **{**planted, "friction": DRY * [3.0, 1.0]})
    none = table(tmp_path / "none.csv", friction=[0.0, 0.0])
    found = replayed(ARM, [moved(ARM, seed) for seed in (1, 2)], [moved(ARM, 3, 12.0)], against=[true, wrong, none])
    right, off, zero = found.against
    assert right.count("contradicted") == 0
    assert right.count("agrees") >= 4
    places = [(joint, k) for joint, row in enumerate(off.verdicts) for k, v in enumerate(row) if v == "contradicted"]
    assert places == [(0, 1)]
    np.testing.assert_allclose(off.values[:, 1], 1e3 * DRY * [3.0, 1.0] / GAIN)
    assert zero.verdicts == (("", "contradicted", "", "", ""),) * 2
    assert (right.rms < 0.1 * found.before).all()
    assert off.rms[0] > 2 * right.rms[0]


def test_an_mjcf_is_read_as_mujoco_reads_it(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    path = tmp_path / "arm.xml"
    path.write_text(MJCF)
    model, found = mujoco.MjModel.from_xml_string(MJCF), read_parameters(path, ARM)
    np.testing.assert_allclose(found["friction"], model.dof_frictionloss)
    np.testing.assert_allclose(found["armature"], model.dof_armature)
    # Torques by finite differences of a MuJoCo step: with the angle, and with the speed.
    data = mujoco.MjData(model)

    def torque(q, v):
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, 0.0
        mujoco.mj_forward(model, data)
        return data.qfrc_actuator - model.dof_damping * v

    zero, ones = np.zeros(2), np.ones(2)
    np.testing.assert_allclose(found["kp"], torque(zero, zero) - torque(ones, zero))
    np.testing.assert_allclose(found["damping"], torque(zero, zero) - torque(zero, ones))
    path.write_text(MJCF.replace("kv=", "dampratio="))  # its damping depends on the inertias
    np.testing.assert_array_equal(np.isnan(read_parameters(path, ARM)["damping"]), [False, True])


def test_published_sets_are_of_the_joints_of_the_so101():
    root = Path(__file__).parents[2]
    robot, files = read_robot(root / "problems/so101/robot.toml"), (root / "data/so101_logs/published").glob("*.csv")
    gains = [read_parameters(path, robot)["kp"] for path in files]
    assert np.shape(gains) == (6, 6)
    assert np.isfinite(gains).all()


def test_files_that_say_nothing_of_the_arm_are_refused(tmp_path):
    (tmp_path / "a.csv").write_text("joint,stiffness\na,3\n")
    with pytest.raises(InputError, match="needs a column joint, and some of kp"):
        read_parameters(tmp_path / "a.csv", ARM)
    (tmp_path / "b.csv").write_text("joint,kp\nx,3\ny,3\nz,3\n")
    with pytest.raises(InputError, match="joints x, y, z; the robot has a, b"):
        read_parameters(tmp_path / "b.csv", ARM)
    (tmp_path / "c.xml").write_text("<mujoco/>")
    with pytest.raises(InputError, match="no position or general actuator"):
        read_parameters(tmp_path / "c.xml", ARM)
    with pytest.raises(InputError, match="no such file"):
        read_parameters(Path("nowhere.csv"), ARM)


@pytest.mark.slow
def test_the_command_judges_published_parameters(tmp_path):
    log = moved(ARM, 1, 8.0)
    columns = {"time_s": log.time}
    columns |= {f"command{k}_rad": log.command[:, k - 1] for k in (1, 2)}
    columns |= {f"q{k}_rad": log.position[:, k - 1] for k in (1, 2)}
    pd.DataFrame(columns).to_csv(tmp_path / "log.csv", index=False)
    write_robot(ARM, tmp_path / "arm.toml")
    wrong = table(tmp_path / "wrong.csv", kp=GAIN, friction=5 * DRY)
    asked = ["diagnose", *map(str, (tmp_path / "arm.toml", tmp_path / "log.csv", "--against", wrong))]
    told = CliRunner().invoke(app, [*asked, "--json", str(tmp_path / "found.json")])
    assert told.exit_code == 0, told.output
    assert told.output.index("contradict") < told.output.index("(in sum)")
    (found,) = json.loads((tmp_path / "found.json").read_text())["replay"]["against"]
    verdicts = {(row["joint"], row["parameter"]): row["verdict"] for row in found["parameters"]}
    assert verdicts["a", "F/kp [mrad]"] == "contradicted"

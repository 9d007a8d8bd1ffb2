"""The calibrated geometry in a user's own MuJoCo model, whose frames are not ours."""

import re
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from marks import MUJOCO

from casadical.core.basics import InputError
from casadical.core.transforms import frame, from_rpy, quaternion
from casadical.export.mjcf.into_mjcf import into_mjcf
from casadical.export.mjcf.mjcf import numbers
from casadical.export.model_file import robot_model
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import Measurements
from casadical.project.problem import read_campaign_robot
from casadical.robot.axes import row_matrix
from casadical.robot.robot import Robot

pytestmark = MUJOCO
ROOT = Path(__file__).parents[3]
JOINTS = tuple(f"axis_{c}" for c in "abcdef")
FOOT = frame(from_rpy(np.array([0.3, -0.2, 1.1])), np.array([0.5, -1.0, 0.7]))


def users_model(robot: Robot, seed: int = 0) -> str:
    """The nominal arm in a user's manner: foot anywhere, link frames anywhere, a mount between links, a geom each."""
    rng = np.random.default_rng(seed)
    root = ET.Element("mujoco", model="mine")
    ET.SubElement(root, "compiler", angle="radian")
    node = ET.SubElement(root, "worldbody")
    before, T = np.eye(4), FOOT
    for i, (name, row) in enumerate(zip(JOINTS, robot.joints, strict=True), 1):
        T = T @ row_matrix(row)
        C = frame(from_rpy(rng.normal(size=3)), rng.normal(size=3) * 0.2)
        mount = frame(from_rpy(rng.normal(size=3)), rng.normal(size=3) * 0.1)
        for label, place in ((f"mount{i}", mount), (f"part{i}", np.linalg.inv(before @ mount) @ T @ C)):
            node = ET.SubElement(node, "body", name=label, pos=numbers(*place[:3, 3]))
            node.set("quat", numbers(*quaternion(place[:3, :3])))
        inside = np.linalg.inv(C)
        ET.SubElement(node, "joint", name=name, pos=numbers(*inside[:3, 3]), axis=numbers(*inside[:3, 2]))
        ET.SubElement(node, "geom", size="0.05", mass="5")
        before = T @ C
    return ET.tostring(root, encoding="unicode")


def calibrated(robot: Robot) -> Robot:
    rng = np.random.default_rng(1)
    size = {"m": 1e-3, "rad": 2e-3}
    chosen = [p for p in robot.parameters if p.group in ("geometry", "tool")]
    return robot.with_values({p.name: p.value + rng.normal(0, size[p.unit]) for p in chosen})


@pytest.fixture
def robot() -> Robot:
    return read_campaign_robot(ROOT / "problems" / "kr210")


def test_the_users_model_gets_the_calibrated_kinematics(robot: Robot, tmp_path: Path) -> None:
    import mujoco

    (tmp_path / "mine.xml").write_text(users_model(robot))
    after = calibrated(robot)
    text = into_mjcf(robot, after, tmp_path / "mine.xml", JOINTS)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    rigid = after.with_values(dict.fromkeys(after.parameters.select(["compliance"]), 0.0))
    q = np.random.default_rng(2).uniform(-1.5, 1.5, (10, 6))
    p, _ = predicted(rigid, Measurements(q=q, kind="position", position=np.zeros((10, 3))))
    for k in range(10):
        data.qpos[:] = q[k]
        mujoco.mj_kinematics(model, data)
        local = np.linalg.inv(robot.base.T) @ np.append(p[k], 1)
        assert np.allclose(data.site("casadical_measured").xpos, (FOOT @ local)[:3], rtol=0, atol=1e-9)
    assert [model.geom(g).size[0] for g in range(model.ngeom)] == [0.05] * 6  # the rest of the model stays


def test_springs_are_added_beside_the_joints_when_asked_for(robot: Robot, tmp_path: Path) -> None:
    import mujoco

    (tmp_path / "mine.xml").write_text(users_model(robot))
    model = mujoco.MjModel.from_xml_string(into_mjcf(robot, robot, tmp_path / "mine.xml", JOINTS, springs=True))
    for name, row in zip(JOINTS, robot.joints, strict=True):
        spring, own = model.joint(f"{name}_spring"), model.joint(name)
        assert spring.stiffness[0] == pytest.approx(1 / row.compliance)
        assert np.allclose(spring.axis, own.axis)
        assert np.allclose(spring.pos, own.pos)
        assert spring.bodyid == own.bodyid


@pytest.mark.parametrize("springs", [False, True])
def test_springs_that_were_not_asked_for_are_said_to_lack(springs: bool, robot: Robot, tmp_path: Path) -> None:
    (tmp_path / "mine.xml").write_text(users_model(robot))
    nominal = ROOT / "problems" / "kr210" / "robot.toml"
    mine, names = tmp_path / "mine.xml", ",".join(JOINTS)
    made = robot_model(nominal, "mjcf", nominal=nominal, into=mine, joints=names, springs=springs)
    assert made.lines == (() if springs else ("LEFT OUT springs of the joints; --springs adds them",))


def test_another_arm_is_refused(robot: Robot, tmp_path: Path) -> None:
    (tmp_path / "mine.xml").write_text(users_model(robot.with_values({"a2": 1.16})))
    with pytest.raises(InputError, match="is not that of the nominal robot's joint"):
        into_mjcf(robot, robot, tmp_path / "mine.xml", JOINTS)
    with pytest.raises(InputError, match=r"no joint 'wrist'; there are axis_a"):
        into_mjcf(robot, robot, tmp_path / "mine.xml", (*JOINTS[:5], "wrist"))
    with pytest.raises(InputError, match="5 names for the 6 joints"):
        into_mjcf(robot, robot, tmp_path / "mine.xml", JOINTS[:5])
    with pytest.raises(InputError, match="closed loop"):
        into_mjcf(read_campaign_robot(ROOT / "problems" / "hh800"), robot, tmp_path / "mine.xml", JOINTS)
    begin, last, end = re.split(r'(?=<body name="part6")|(?<=/></body>)', users_model(robot), maxsplit=2)
    last = re.sub(r'pos="([^ "]+)', lambda m: f'pos="{float(m[1]) - 0.001!r}', last, count=1)
    text = f'{begin}<frame pos="0.001 0 0">{last}</frame>{end}'
    (tmp_path / "framed.xml").write_text(text)
    with pytest.raises(InputError, match=r"body 'part6' does not move to its target \(.* m or rad off\)"):
        into_mjcf(robot, robot, tmp_path / "framed.xml", JOINTS)
    (tmp_path / "bad.xml").write_text("<mujoco><worldbody><bod/></worldbody></mujoco>")
    with pytest.raises(InputError, match="MuJoCo cannot read it"):
        into_mjcf(robot, robot, tmp_path / "bad.xml", JOINTS)

"""Forward kinematics, gravity torques and rest of serial arms against Pinocchio, on a URDF built from the DH rows."""

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

from casadical.blind_check.numpy_physics.machine import moments, placed, settle, tool_point
from casadical.blind_check.numpy_physics.plant import Plant

from .robots import ARM, random_arm, stops_at


def urdf(robot: dict[str, Any]) -> str:
    """A URDF with the robot's joints, links and payload; the payload is a seventh body fixed to link 6."""
    text = ['<robot name="r"><link name="l0"/>']
    for i, row in enumerate(robot["modified_dh"]):
        alpha, theta = np.deg2rad(row["alpha_deg"]), np.deg2rad(row["theta0_deg"])
        tilt = Rotation.from_euler("x", alpha)
        place = tilt.apply([row["a_m"], 0.0, row["d_m"]])
        text.append(_link(f"l{i + 1}", robot["mass_kg"][i], robot["com_m"][i]))
        text.append(_joint(f"j{i + 1}", "revolute", i, place, tilt * Rotation.from_euler("z", theta)))
    text.append(_link("l7", robot["payload"]["mass_kg"], robot["payload"]["com_m"]))
    text.append(_joint("j7", "fixed", 6, np.zeros(3), Rotation.identity()))
    return "".join(text) + "</robot>"


def _link(name: str, mass: float, com: Any) -> str:
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    return f'<link name="{name}"><inertial><mass value="{float(mass)!r}"/>{_origin(com)}{inertia}</inertial></link>'


def _joint(name: str, kind: str, parent: int, place: Any, turned: Rotation) -> str:
    limits = '<limit lower="-9" upper="9" effort="1" velocity="1"/><axis xyz="0 0 1"/>' if kind == "revolute" else ""
    ends = f'<parent link="l{parent}"/><child link="l{parent + 1}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{_origin(place, turned.as_euler("xyz"))}{limits}</joint>'


def _origin(xyz: Any, rpy: Any = (0, 0, 0)) -> str:
    place, angles = (" ".join(repr(float(x)) for x in v) for v in (xyz, rpy))
    return f'<origin xyz="{place}" rpy="{angles}"/>'


class Oracle:
    def __init__(self, robot: dict[str, Any], base: np.ndarray) -> None:
        self.model = pin.buildModelFromXML(urdf(robot))
        self.model.gravity.linear = base[:3, :3].T @ np.array([0, 0, -9.81])
        self.data = self.model.createData()
        self.base, self.reflector = base, np.asarray(robot["tool_m"], float)

    def position(self, q: np.ndarray) -> np.ndarray:
        pin.forwardKinematics(self.model, self.data, q)
        return self.base[:3, :3] @ self.data.oMi[6].act(self.reflector) + self.base[:3, 3]

    def weight_torque(self, q: np.ndarray) -> np.ndarray:
        return -pin.computeGeneralizedGravity(self.model, self.data, q)


ROBOTS = [ARM, *(random_arm(seed) for seed in range(5))]


@pytest.fixture(params=range(len(ROBOTS)))
def pair(request: pytest.FixtureRequest) -> tuple[Plant, Oracle]:
    robot = ROBOTS[request.param]
    base = np.eye(4)
    base[:3, :3] = Rotation.from_rotvec([0.03, -0.02, 0.4]).as_matrix()
    base[:3, 3] = 0.02, -0.01, 0.03
    return replace(Plant.from_dict(robot), base=base), Oracle(robot, base)


def test_positions_and_torques(pair: tuple[Plant, Oracle]) -> None:
    plant, oracle = pair
    q = np.random.default_rng(1).uniform(-3, 3, (40, 6))
    rest = placed(plant, stops_at(q, plant.payload_kg), q)
    np.testing.assert_allclose(tool_point(rest), [oracle.position(x) for x in q], atol=1e-12)
    np.testing.assert_allclose(moments(rest), [oracle.weight_torque(x) for x in q], atol=1e-9)


def test_rest_is_where_springs_and_weights_agree(pair: tuple[Plant, Oracle]) -> None:
    plant, oracle = pair
    plant = replace(plant, stiffness=np.array([2e5, 1e5, 2e5, 1e5, 5e4, 4e4]))
    q = np.random.default_rng(2).uniform(-3, 3, (10, 6))
    found = tool_point(settle(plant, stops_at(q, plant.payload_kg)))
    for reading, point in zip(q, found, strict=True):
        true = fsolve(lambda x, r=reading: x - r - oracle.weight_torque(x) / plant.stiffness, reading, xtol=1e-11)
        np.testing.assert_allclose(point, oracle.position(true), atol=1e-9)
        assert np.linalg.norm(point - oracle.position(reading)) > 1e-3

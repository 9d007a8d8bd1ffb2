"""Pinocchio's forward kinematics and gravity torques of a serial arm, on a URDF built from its DH rows."""

from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation


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


class PinocchioArm:
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

"""The rest of a robot without effects, by Pinocchio's kinematics and gravity torques and a fixed point; no engine."""

import numpy as np
import pinocchio as pin
from scipy.optimize import brentq

from casadical.blind_check.mujoco_physics import Plant
from casadical.blind_check.mujoco_physics.plant import close_loop, pivot


def model(machine: Plant, payload_kg: float) -> pin.Model:
    """The robot without its crank in Pinocchio, placed joint by joint; universe = measuring frame."""
    built, parent, before = pin.Model(), 0, np.linalg.inv(machine.base)
    for i in range(6):
        place = pin.SE3(np.linalg.solve(before, machine.home[i]))
        parent = built.addJoint(parent, pin.JointModelRZ(), place, f"joint{i + 1}")
        built.appendBodyToJoint(parent, pin.Inertia(machine.mass[i], machine.com[i], np.eye(3)), pin.SE3.Identity())
        before = machine.home[i]
    built.appendBodyToJoint(parent, pin.Inertia(payload_kg, machine.payload_com, np.eye(3)), pin.SE3.Identity())
    return built


def rest(machine: Plant, payload_kg: float, q: np.ndarray) -> np.ndarray:
    """The reflector (3,) [m] at rest: the motors' springs carry the weights, through the loop by virtual work."""
    built = model(machine, payload_kg)
    data, turned = built.createData(), q
    for _ in range(40):
        angles = turned.copy()
        weights = pin.computeGeneralizedGravity(built, data, _tree(machine, built, data, angles)).copy()
        if machine.four_bar is not None:
            ahead, behind = (
                np.array([_tree(machine, built, data, angles + s * 1e-5 * e)[2] for e in np.eye(6)]) for s in (1, -1)
            )
            weights = weights * [1, 1, 0, 1, 1, 1] + weights[2] * (ahead - behind) / 2e-5
        turned = q - weights / machine.stiffness
    pin.forwardKinematics(built, data, _tree(machine, built, data, turned))
    return data.oMi[6].act(machine.reflector)


def _tree(machine: Plant, built: pin.Model, data: pin.Data, angles: np.ndarray) -> np.ndarray:
    """Angles of the tree's joints at those of the motors; a loop's elbow is where the coupler keeps its length."""
    bar = machine.four_bar
    if bar is None:
        return angles
    near = float(close_loop(machine, angles[None, 2] - angles[None, 1]).passive[0])

    def too_long(elbow: float) -> float:
        at = np.where(np.arange(6) == 2, elbow, angles)
        pin.forwardKinematics(built, data, at)
        crank = angles[2] - angles[1] + bar.crank_zero_rad  # seen from link 2
        end = data.oMi[2].act(bar.crank_m * np.array([np.cos(crank), np.sin(crank), 0.0]))
        return float(np.linalg.norm(data.oMi[3].act(_rocker_end(machine)) - end)) - bar.coupler_m

    return np.where(np.arange(6) == 2, brentq(too_long, near - 0.01, near + 0.01, xtol=1e-14), angles)


def _rocker_end(machine: Plant) -> np.ndarray:
    """The coupler's ball joint on link 3, (3,) [m] in its frame; in the plane of link 2 at zero readings."""
    bar = machine.four_bar
    towards = np.array([np.cos(bar.passive_offset_rad), -np.sin(bar.passive_offset_rad)])
    home = machine.at_home(2, np.append(pivot(machine) + bar.rocker_m * towards, 0.0))
    return machine.home[2, :3, :3].T @ (home - machine.home[2, :3, 3])

"""Gravity torques on the actuated joints, as minus the gradient of the potential energy; compliance (paper, eq. 4)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import casadi as ca

from casadical.core.transforms import Symbolic, apply
from casadical.robot.kinematics import Values

if TYPE_CHECKING:
    from casadical.robot.robot import Robot


def gravity_energy(robot: Robot, frames: Sequence[Symbolic], gravity: Symbolic, payload_kg: Symbolic) -> Symbolic:
    """Potential energy [J] of all bodies and of the payload.

    frames : T_01..T_0n in the robot's base frame; gravity : shape (3,) [m/s^2] in the same frame
    payload_kg : mass on the flange at this pose, its mass centre as declared
    """
    loads = [(j.body.mass, j.body.com, T) for j, T in zip(robot.joints, frames, strict=True) if j.body]
    if robot.payload:
        loads.append((payload_kg, robot.payload.com, frames[-1]))
    energy: Symbolic = 0.0
    for mass, com, T in loads:
        energy = energy - mass * ca.dot(gravity, apply(T, ca.DM(com)))
    return energy


def gravity_torques(energy: Symbolic, q: Symbolic) -> Symbolic:
    """tau = -dV/dq, shape (n,): the effective torques on the actuated joints, right for closed loops too."""
    return -ca.gradient(energy, q)


def deflections(robot: Robot, torque: Symbolic, values: Values) -> Symbolic:
    """Joint deflections c_i tau_i, shape (n,) [rad or m] (paper, eq. 4)."""
    return ca.vertcat(*(values.get(f"c{i}", 0.0) * torque[i - 1] for i in range(1, robot.n + 1)))

"""Gravity torques on the actuated joints, as minus the gradient of the potential energy; compliance (paper, eq. 4)."""

from collections.abc import Sequence

import casadi as ca

from casadical.core.arm import Arm
from casadical.core.transforms import Symbolic, apply
from casadical.effects import Context
from casadical.robot.kinematics import Values


def gravity_energy(arm: Arm, frames: Sequence[Symbolic], gravity: Symbolic, payload_kg: Symbolic) -> Symbolic:
    """Potential energy [J] of all bodies and of the payload.

    frames : T_01..T_0n in the robot's base frame; gravity : shape (3,) [m/s^2] in the same frame
    payload_kg : mass on the flange at this pose, its mass centre as declared
    """
    loads = [(j.body.mass, j.body.com, T) for j, T in zip(arm.joints, frames, strict=True) if j.body]
    if arm.payload:
        loads.append((payload_kg, arm.payload.com, frames[-1]))
    energy: Symbolic = 0.0
    for mass, com, T in loads:
        energy = energy - mass * ca.dot(gravity, apply(T, ca.DM(com)))
    return energy


def gravity_torques(context: Context, added: Symbolic = 0.0) -> Symbolic:
    """tau = -dV/dq, shape (n,) [N m or N]: on the actuated joints, right for closed loops too.

    Evaluated at the pose after one deflection step. added : potential energy of effects [J]
    """
    arm, q = context.arm, context.q
    energy = gravity_energy(arm, context.frames, context.gravity, context.conditions.get("payload_kg", 0.0))
    tau = -ca.gradient(ca.SX(energy + added), q)
    return ca.substitute(tau, q, q + deflections(arm, tau, context.values))


def deflections(arm: Arm, torque: Symbolic, values: Values) -> Symbolic:
    """Joint deflections c_i tau_i, shape (n,) [rad or m] (paper, eq. 4)."""
    return ca.vertcat(*(values.get(f"c{i}", 0.0) * torque[i - 1] for i in range(1, arm.n + 1)))

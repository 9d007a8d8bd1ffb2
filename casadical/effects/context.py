"""What an effect may look at where it enters the model."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce

import casadi as ca

from casadical.core.parts import Arm
from casadical.core.transforms import Symbolic, apply


@dataclass(frozen=True)
class Context:
    """What an effect may look at; every entry but the first is symbolic.

    arm : rows, masses, limits, loops, payload
    torque_scale : shape (n,) [N m or N]: great gravity torques on each joint (see `Robot.torque_scale`)
    q : shape (n,) [rad or m]: joint readings
    conditions : logged columns by name (payload_kg, temperature_degC, progress, approach1, ...)
    values : the value of every parameter of the model, by name [SI]
    frames : T_01..T_0n, the rigid links' frames in the robot's base frame, each (4, 4)
    gravity : shape (3,) [m/s^2]: in the robot's base frame
    torque : shape (n,) [N m or N]: of gravity on the actuated joints; None at the seam `energy`, which makes it

    Examples
    --------
    >>> seen = []
    >>> class Look(casadical.Effect):
    ...     name = "look"
    ...
    ...     def joint_angle(self, context):
    ...         seen.append(context)
    ...         return super().joint_angle(context)
    >>> size = robot.with_effect(Look()).position.n_in()
    >>> context = seen[0]
    >>> context.load(1).shape, context.moment(1).shape, context.greatest(1, 2).shape
    ((1, 1), (3, 1), (1, 1))
    """

    arm: Arm
    torque_scale: Symbolic
    q: Symbolic
    conditions: Mapping[str, Symbolic]
    values: Mapping[str, Symbolic]
    frames: tuple[Symbolic, ...]
    gravity: Symbolic
    torque: Symbolic = None

    def load(self, joint: int | None) -> Symbolic:
        """Gravity torque on a joint (1-based) as a share of its great torques."""
        assert joint is not None
        return self.torque[joint - 1] / self.torque_scale[joint - 1]

    def moment(self, link: int) -> Symbolic:
        """Moment [N m] of all weight from a link (1-based) on, about its origin; in the base frame, shape (3,)."""
        origin = self.frames[link - 1][:3, 3]
        joints = self.arm.joints
        loads = [(j.body.mass, apply(T, ca.DM(j.body.com))) for j, T in zip(joints, self.frames, strict=True) if j.body]
        loads = loads[sum(1 for j in joints[: link - 1] if j.body) :]
        if self.arm.payload:
            mass = self.conditions.get("payload_kg", self.arm.payload.mass)
            loads.append((mass, apply(self.frames[-1], ca.DM(self.arm.payload.com))))
        total = ca.SX.zeros(3)
        for mass, centre in loads:
            total = total + ca.cross(centre - origin, mass * self.gravity)
        return total

    @property
    def great_moment(self) -> Symbolic:
        """The greatest of the turning joints' great torques [N m]; of an arm that only slides, of its forces [N]."""
        return self.greatest(1, self.arm.n)

    def greatest(self, first: int, last: int) -> Symbolic:
        """The greatest great torque of the turning joints (1-based) from the first to the last [N m].

        Where none of them turns, of all of them [N]: moments and forces are not compared.
        """
        there = range(first, last + 1)
        turning = [j for j in there if j in self.arm.revolute] or there
        return reduce(ca.fmax, [self.torque_scale[j - 1] for j in turning])

"""The state of the machine, with the torques by which effects are sized."""

from dataclasses import dataclass

from casadical.blind_check.mujoco_physics import cause as statics
from casadical.blind_check.mujoco_physics.cause import moments
from casadical.blind_check.mujoco_physics.plant import Array

GRAVITY = 9.81

__all__ = ["GRAVITY", "State", "moments"]


@dataclass(frozen=True)
class State(statics.State):
    """n poses at rest, or on the way to it; rated : (6,), the largest torque of the weights on each joint [N m]."""

    rated: Array

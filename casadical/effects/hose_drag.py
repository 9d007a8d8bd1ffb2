"""A hose or cable from the forearm to the tool pulls at the wrist."""

from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadical.core.arm import Arm
from casadical.core.transforms import Symbolic, apply
from casadical.effects.base import Context, Effect, setting


@dataclass(frozen=True)
class HoseDrag(Effect):
    """clip : where the hose is held, as a share of the way from the elbow to the wrist

    side : how far beside the forearm, as a share of its length
    """

    clip: float = setting(0.7, (0.3, 0.6, 0.9))
    side: float = setting(0.1, (0.0, 0.2))

    name = "hose_drag"
    on_list = "extended"
    signature = "a pull at the wrist that grows as hose or cable is drawn out"
    physics = (
        "A dress pack is a weak spring with some tension from its clip on the forearm to the load; its pull turns the "
        "wrist joints through their own springs, by the slope of its length."
    )
    confused_with = "gear_eccentricity and joint_scale of joint 5; any smooth error of the wrist"
    # Torque at the last joint but one, as a share of its great torques.
    size = {"tension": (0.1, ""), "spring": (0.2, "")}

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return super().candidates(arm) if arm.n >= 6 else ()

    def energy(self, context: Context) -> Symbolic:
        arm, n = context.arm, context.arm.n
        elbow, wrist = context.frames[n - 4], context.frames[n - 3][:3, 3]
        forearm = wrist - elbow[:3, 3]
        beside = elbow[:3, 2] * self.side * ca.sqrt(ca.sumsqr(forearm))
        clip = elbow[:3, 3] + self.clip * forearm + beside
        end = arm.payload.com if arm.payload else [0.0, 0.0, 0.0]
        length = ca.sqrt(ca.sumsqr(apply(context.frames[-1], ca.DM(end)) - clip) + 1e-6)
        rows = context.values[f"d{n - 1}"] ** 2 + context.values[f"d{n}"] ** 2 + float(np.dot(end, end))
        usual = ca.sqrt(rows + 1e-3) + (1 - self.clip) * ca.sqrt(ca.sumsqr(forearm))
        drawn = length / usual - 1
        pull = context.torque_scale[n - 2]
        return pull * (self.value(context, "tension") * drawn + self.value(context, "spring") * drawn**2)

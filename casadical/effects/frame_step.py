"""A frame of the robot, or the measuring frame, shifts and turns at once during the campaign."""

from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca

from casadical.core.arm import Arm
from casadical.core.transforms import Symbolic, small_frame
from casadical.effects.base import Context, Effect, setting
from casadical.effects.grids import FEW_TIMES


@dataclass(frozen=True)
class FrameStep(Effect):
    """at : when, as a share of the campaign; without a joint, the measuring frame moves against the robot's foot"""

    at: float = setting(0.5, FEW_TIMES, steps=True)

    name = "frame_step"
    on_list = "extended"
    signature = "a jump of the foot, the instrument or one link, in all six freedoms"
    needs = ("progress",)
    physics = "A foot that slips in its anchors, a knocked tripod or a bolted flange that slips moves as a body."
    confused_with = "target_shift and joint_zero_step at the same time; frame_drift"
    size = dict.fromkeys("xyz", (6e-5, "m")) | {f"r{c}": (4e-5, "rad") for c in "xyz"}

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(frame, at) for frame in (None, *arm.numbers[:-1]) for at in FEW_TIMES)

    def _six(self, context: Context) -> list[Symbolic]:
        after = context.conditions["progress"] > self.at
        return [self.value(context, name) * after for name in self.size]

    def link(self, number: int, context: Context) -> Symbolic:
        return small_frame(*self._six(context)) if number == self.joint else ca.SX.eye(4)

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        if self.joint is not None:
            return point
        x, y, z, *turn = self._six(context)
        return point + ca.vertcat(x, y, z) + ca.cross(ca.vertcat(*turn), point)

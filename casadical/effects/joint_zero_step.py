"""A joint's zero jumps once during the campaign."""

from dataclasses import dataclass

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect, setting
from casadical.effects.grids import TIMES


@dataclass(frozen=True)
class JointZeroStep(Effect):
    """at : when, as a share of the campaign."""

    at: float = setting(0.5, TIMES, steps=True)

    name = "joint_zero_step"
    on_list = "standard"
    signature = "a jump of one joint's zero"
    needs = ("progress",)
    physics = "A slipped belt or collision, or a re-mastered axis, shifts the zero of one joint."
    confused_with = "target_shift at the same time; thermal_zero_drift while the arm warms up"
    size = {"step": (80e-6, "rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        return self.value(context, "step") * (context.conditions["progress"] > self.at)

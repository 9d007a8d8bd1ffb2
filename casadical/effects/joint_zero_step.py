"""A joint's zero jumps once during the campaign."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from casadical.core.arm import Arm
from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect
from casadical.effects.grids import TIMES


@dataclass(frozen=True)
class JointZeroStep(Effect):
    """at : when, as a share of the campaign."""

    at: float = field(default=0.5, metadata={"spacing": TIMES[1] - TIMES[0]})

    name = "joint_zero_step"
    on_list = "standard"
    signature = "a jump of one joint's zero"
    needs = ("progress",)
    physics = "A slipped belt or collision, or a re-mastered axis, shifts the zero of one joint."
    confused_with = "target_shift at the same time; thermal_zero_drift while the arm warms up"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(j, t) for j in arm.numbers for t in TIMES)

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {"step": (80e-6, "rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        return self.value(context, "step") * (context.conditions["progress"] > self.at)

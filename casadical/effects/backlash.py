"""Play in a gear, taken up by the gravity torque, or by the approach where there is little torque."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class Backlash(Effect):
    """The flank changes where gravity overcomes friction.

    friction : torque below which the approach decides; width : of the change; shares of the joint's great torques
    """

    friction: float = 0.05
    width: float = 0.03

    name: ClassVar[str] = "backlash"
    physics: ClassVar[str] = (
        "The tooth rests on the flank to which gravity pushes it; where friction holds it against gravity, on the "
        "flank that drove it there (Ruderman, Hoffmann and Bertram 2009)."
    )
    confused_with: ClassVar[str] = "friction_windup where the torque is small; nonlinear_stiffness where it is large"

    @property
    def conditions(self) -> tuple[str, ...]:
        return (f"approach{self.joint}",)

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {"half": (50e-6, "rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:  # noqa: ARG002 - a function of torque and approach
        assert self.joint is not None
        # The link lies behind its last motion.
        push = context.load(self.joint) - self.friction * context.conditions[f"approach{self.joint}"]
        return self.value(context, "half") * ca.tanh(push / self.width)

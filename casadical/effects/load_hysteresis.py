"""A joint's spring holds back part of its deflection against the last motion, the more the higher the load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class LoadHysteresis(Effect):
    """power : of the load in the loop's half width; 1 dry friction in the teeth, 2 inner friction of the material"""

    power: int = 1

    name: ClassVar[str] = "load_hysteresis"
    physics: ClassVar[str] = (
        "Loading and unloading a gear follow two branches; their distance grows with the torque (dry friction), or "
        "with its square (inner friction, as in Rayleigh's law). Nothing of it is left at an idle joint."
    )
    confused_with: ClassVar[str] = "friction_windup, whose load part it is; tell by both approaches at no load"

    @property
    def conditions(self) -> tuple[str, ...]:
        return (f"approach{self.joint}",)

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {"half": (40e-6, "rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:  # noqa: ARG002 - a function of approach and torque
        assert self.joint is not None
        load = ca.sqrt(context.load(self.joint) ** 2 + 1e-6)
        return -self.value(context, "half") * context.conditions[f"approach{self.joint}"] * load**self.power

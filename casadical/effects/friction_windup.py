"""The joint stays wound up against its last motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class FrictionWindup(Effect):
    name: ClassVar[str] = "friction_windup"
    physics: ClassVar[str] = (
        "Dry friction, part constant and part growing with the load, holds the spring of the drive train against the "
        "last motion (Ruderman 2012)."
    )
    confused_with: ClassVar[str] = "backlash where the joint's torque is small"

    @property
    def conditions(self) -> tuple[str, ...]:
        return (f"approach{self.joint}",)

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {"constant": (40e-6, "rad"), "load": (40e-6, "rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:  # noqa: ARG002 - a function of approach and torque
        assert self.joint is not None
        against = -context.conditions[f"approach{self.joint}"]
        load = ca.sqrt(context.load(self.joint) ** 2 + 1e-4)
        return against * (self.value(context, "constant") + self.value(context, "load") * load)

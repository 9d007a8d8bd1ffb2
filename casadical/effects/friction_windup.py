"""The joint stays wound up against its last motion."""

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect
from casadical.effects.counterparts import Counterparts


@dataclass(frozen=True)
class FrictionWindup(Effect):
    name = "friction_windup"
    on_list = "standard"
    signature = "a lag behind the last motion"
    physics = (
        "Dry friction, part constant and part growing with the load, holds the spring of the drive train against the "
        "last motion (Ruderman 2012)."
    )
    confused_with = "backlash where the joint's torque is small"
    size = {"constant": (40e-6, "rad"), "load": (40e-6, "rad")}

    @property
    def conditions(self) -> tuple[str, ...]:
        return (f"approach{self.joint}",)

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        against = -context.conditions[f"approach{self.joint}"]
        load = ca.sqrt(context.load(self.joint) ** 2 + 1e-4)
        return against * (self.value(context, "constant") + self.value(context, "load") * load)

    def counterpart(self, found: Counterparts, v: Mapping[str, float]) -> Counterparts:
        soft = found.drive(self.joint).compliance
        if soft <= 0:
            return found.without_sign(self.label)
        assert self.joint is not None
        wound = v["constant"] + v["load"] * float(found.mean_load[self.joint - 1])
        if wound <= 0:
            return found.without(self.label, "its friction came out negative")
        found = found.with_drive(self.joint, friction=wound / soft)
        return found.noted(f"{self.label}: dry friction of {wound / soft:.4g} N m, at its mean load")

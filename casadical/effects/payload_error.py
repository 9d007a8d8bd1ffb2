"""The declared payload has another mass and mass centre."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from casadical.core.arm import Arm
from casadical.core.parts import Body
from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect
from casadical.effects.counterparts import Counterparts


@dataclass(frozen=True)
class PayloadError(Effect):
    name = "payload_error"
    on_list = "standard"
    signature = "torque errors where the payload is mounted"
    needs = ("payload_kg",)
    physics = "Gravity on the true payload differs from the declared one; it acts through the joints' springs."
    confused_with = "nonlinear_stiffness; compliance of the wrist where the payload never changes"
    size = {"mass": (0.06, "kg/kg"), **dict.fromkeys("xyz", (0.03, "m"))}

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(),) if arm.payload else ()

    def energy(self, context: Context) -> Symbolic:
        payload = context.arm.payload
        if payload is None:
            return 0.0
        kg, T = context.conditions["payload_kg"], context.frames[-1]
        shift = ca.vertcat(*(self.value(context, c) for c in "xyz"))
        moment = self.value(context, "mass") * ca.DM(payload.com) + shift
        point = T[:3, :3] @ moment + self.value(context, "mass") * T[:3, 3]
        return -kg * ca.dot(context.gravity, point)

    def counterpart(self, found: Counterparts, v: Mapping[str, float]) -> Counterparts:
        """The true mass, and the centre whose first moment is that of the effect."""
        declared = found.payload
        if declared is None:
            return super().counterpart(found, v)
        factor = 1 + v["mass"]
        centre = declared.com + np.array([v[c] for c in "xyz"]) / factor
        found = replace(found, payload=Body(declared.mass * factor, centre), payload_factor=factor)
        return found.noted(
            f"payload_error: {declared.mass * factor:.4g} kg in place of {declared.mass:.4g} kg, centre moved"
        )

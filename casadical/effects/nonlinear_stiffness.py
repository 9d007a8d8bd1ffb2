"""A joint is softer at small torque than at large."""

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect, setting
from casadical.effects.counterparts import Counterparts

# tanh(x) is nearest to SLOPE x that stops at STOP, off by OFF at most.
SLOPE, STOP, OFF = 0.76, 0.92, 0.083


@dataclass(frozen=True)
class NonlinearStiffness(Effect):
    """knee : torque at which the joint has stiffened, as a share of its great torques."""

    knee: float = setting(0.3, (0.1, 0.2, 0.4, 0.7))

    name = "nonlinear_stiffness"
    on_list = "standard"
    signature = "deflection that saturates with torque (gear bedding in)"
    physics = (
        "Gear teeth and strain-wave cups bed in: the deflection saturates, c tau + b tanh(tau / knee) "
        "(Kircanski and Goldenberg 1997)."
    )
    confused_with = "backlash on the side of the gravity torque; cubic stiffness; payload_error"
    size = {"bend": (60e-6, "rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        return self.value(context, "bend") * ca.tanh(context.load(self.joint) / self.knee)

    def counterpart(self, found: Counterparts, v: Mapping[str, float]) -> Counterparts:
        if v["bend"] <= 0:
            return found.without_sign(self.label)
        stiffness = self.knee * found.great(self.joint) / (SLOPE * v["bend"])
        found = found.with_drive(self.joint, give=STOP * v["bend"], give_stiffness=stiffness)
        off = 1e6 * OFF * v["bend"]
        return found.noted(f"{self.label}: joint{self.joint}_bed, a soft spring between stops, within {off:.1f} urad")

"""Once-per-turn error of a joint's gear or encoder, with some second harmonic."""

from dataclasses import dataclass

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class GearEccentricity(Effect):
    name = "gear_eccentricity"
    on_list = "standard"
    acts_at = "turning joints"
    signature = "once-per-turn error (gear, encoder disc, coupling; balancer on joint 2)"
    physics = (
        "A wheel or code disc whose centre is off the axis by e reads e/r sin(q - phase) wrong (Mooring, Roth and "
        "Driels 1991, ch. 2); linear in the sine and cosine parts."
    )
    confused_with = "joint_scale over less than a turn; gravity_compensator on joint 2; axis_wobble"
    size = {"sin1": (40e-6, "rad"), "cos1": (40e-6, "rad"), "sin2": (12e-6, "rad"), "cos2": (12e-6, "rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        first = self.value(context, "sin1") * ca.sin(q) + self.value(context, "cos1") * ca.cos(q)
        return first + self.value(context, "sin2") * ca.sin(2 * q) + self.value(context, "cos2") * ca.cos(2 * q)

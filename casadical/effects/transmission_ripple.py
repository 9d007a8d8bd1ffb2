"""Periodic transmission error: gear mesh, wave generator or cycloid, many cycles a joint turn."""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect, setting

CYCLES = tuple(float(c) for c in np.arange(2, 32.01, 0.5))


@dataclass(frozen=True)
class TransmissionRipple(Effect):
    """cycles : per turn of the joint; known from the gear ratio (N, 2N), else found on a grid."""

    cycles: float = setting(2.0, CYCLES, steps=True)

    name = "transmission_ripple"
    on_list = "standard"
    acts_at = "turning joints"
    signature = "periodic error at a fixed number of cycles a turn (mesh, wave generator)"
    physics = (
        "Meshing and wave-generator errors repeat N and 2N times a turn (Tuttle and Seering 1996, harmonic drives)."
    )
    confused_with = "gear_eccentricity at two cycles; any smooth periodic error of the same joint"
    size = {"sin": (25e-6, "rad"), "cos": (25e-6, "rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        turn = self.cycles * q
        return self.value(context, "sin") * ca.sin(turn) + self.value(context, "cos") * ca.cos(turn)

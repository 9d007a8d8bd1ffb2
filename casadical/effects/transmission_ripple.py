"""Periodic transmission error: gear mesh, wave generator or cycloid, many cycles a joint turn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class TransmissionRipple(Effect):
    """cycles : per turn of the joint; known from the gear ratio (N, 2N), else found on a grid."""

    cycles: float = 2.0

    name: ClassVar[str] = "transmission_ripple"
    physics: ClassVar[str] = (
        "Meshing and wave-generator errors repeat N and 2N times a turn (Tuttle and Seering 1996, harmonic drives)."
    )
    confused_with: ClassVar[str] = "gear_eccentricity at two cycles; any smooth periodic error of the same joint"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {"sin": (25e-6, "rad"), "cos": (25e-6, "rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        turn = self.cycles * q
        return self.value(context, "sin") * ca.sin(turn) + self.value(context, "cos") * ca.cos(turn)

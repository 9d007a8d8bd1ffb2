"""Errors of a gear of known ratio: one and two cycles a turn of its fast side."""

from dataclasses import dataclass

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect, setting

# Usual ratios of strain-wave and cycloid gears; a gear of another ratio is a candidate of its own, GearMesh(3, 171.5).
RATIOS = (50.0, 80.0, 100.0, 120.0, 160.0)


@dataclass(frozen=True)
class GearMesh(Effect):
    """ratio : turns of the motor, wave generator or pinion a turn of the joint; from the data sheet, to 1 in 1000"""

    ratio: float = setting(100.0, RATIOS, given=True)

    name = "gear_mesh"
    on_list = "extended"
    acts_at = "turning joints"
    signature = "periodic error once and twice a turn of the motor or wave generator"
    physics = (
        "Run-out of the motor's shaft repeats N times a turn of the joint, the two lobes of a wave generator 2N times "
        "(Tuttle and Seering 1996). Joint readings must not be rounded to more than a hundredth of 1/N turn."
    )
    confused_with = "joint repeatability, if the ratio is not exact"
    size = dict.fromkeys(("sin1", "cos1", "sin2", "cos2"), (20e-6, "rad"))

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        turn = self.ratio * q
        first = self.value(context, "sin1") * ca.sin(turn) + self.value(context, "cos1") * ca.cos(turn)
        return first + self.value(context, "sin2") * ca.sin(2 * turn) + self.value(context, "cos2") * ca.cos(2 * turn)

"""The reflector moves once in its nest."""

from dataclasses import dataclass

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect, setting
from casadical.effects.grids import TIMES


@dataclass(frozen=True)
class TargetShift(Effect):
    """at : when, as a share of the campaign."""

    at: float = setting(0.5, TIMES, steps=True)

    name = "target_shift"
    on_list = "standard"
    of_measurement = True
    signature = "a jump of the reflector in its nest"
    needs = ("progress",)
    physics = "A reflector that is reseated or knocked sits elsewhere by tens of micrometres (ISO 10360-10)."
    confused_with = "joint_zero_step of the last joints at the same time"
    size = dict.fromkeys("xyz", (6e-05, "m"))

    def tool(self, context: Context) -> Symbolic:
        T = ca.SX.eye(4)
        T[:3, 3] = ca.vertcat(*(self.value(context, c) for c in "xyz")) * (context.conditions["progress"] > self.at)
        return T

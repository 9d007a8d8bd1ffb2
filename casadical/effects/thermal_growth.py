"""Links lengthen with temperature, which follows the sensor with a lag."""

from dataclasses import dataclass

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect, setting
from casadical.effects.grids import LAGS


@dataclass(frozen=True)
class ThermalGrowth(Effect):
    """lag : time constant with which the links follow the sensor [s]."""

    lag: float = setting(600.0, LAGS)

    name = "thermal_growth"
    on_list = "standard"
    signature = "links that lengthen with temperature"
    needs = ("temperature_degC",)
    physics = "Every link length grows by alpha dT: steel 11.5e-6, aluminium 23e-6 per K (ISO 230-3)."
    confused_with = "thermal_zero_drift; frame_drift while the temperature only rises"
    size = {"alpha": (15e-6, "1/K")}

    @property
    def conditions(self) -> tuple[str, ...]:
        return (f"warmth_{self.lag:.0f}s",)

    def link(self, number: int, context: Context) -> Symbolic:
        return grown_link(number, context, self.value(context, "alpha") * context.conditions[self.conditions[0]])


def grown_link(number: int, context: Context, growth: Symbolic) -> Symbolic:
    """Transform (4, 4) behind a link (1-based) that is longer by a share of its length."""
    before = context.frames[number - 2] if number > 1 else ca.SX.eye(4)
    here = context.frames[number - 1]
    # The link's own length, seen in its frame: what lies between its origin and the one before.
    along = here[:3, :3].T @ (here[:3, 3] - before[:3, 3])
    moved = ca.SX.eye(4)
    moved[:3, 3] = growth * along
    return moved

"""A link bends with temperature, so that what it carries tilts."""

from dataclasses import dataclass

import casadi as ca

from casadical.core.transforms import Symbolic, small_frame
from casadical.effects.base import Context, Effect, setting
from casadical.effects.grids import LAGS


@dataclass(frozen=True)
class ThermalBend(Effect):
    """lag : time constant with which the link follows the sensor [s]."""

    lag: float = setting(600.0, LAGS)

    name = "thermal_bend"
    on_list = "extended"
    acts_at = "joints"
    signature = "a link that tilts with the temperature, across its joint's axis"
    needs = ("temperature_degC",)
    physics = "A link that is warmer on one side, by a motor or the sun, bends by alpha l dT / h (ISO 230-3)."
    confused_with = "thermal_zero_drift of the next joint; frame_drift while the temperature only rises"
    size = {"rx": (6e-6, "rad/K"), "ry": (6e-6, "rad/K")}

    @property
    def conditions(self) -> tuple[str, ...]:
        return (f"warmth_{self.lag:.0f}s",)

    def link(self, number: int, context: Context) -> Symbolic:
        if number != self.joint:
            return ca.SX.eye(4)
        warmth = context.conditions[self.conditions[0]]
        rx, ry = (self.value(context, name) * warmth for name in self.size)
        return small_frame(0, 0, 0, rx, ry, 0)

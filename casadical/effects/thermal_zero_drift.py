"""A joint's zero drifts with temperature."""

from dataclasses import dataclass

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect, setting
from casadical.effects.grids import LAGS


@dataclass(frozen=True)
class ThermalZeroDrift(Effect):
    """lag : time constant with which the joint follows the sensor [s]."""

    lag: float = setting(600.0, LAGS)

    name = "thermal_zero_drift"
    on_list = "standard"
    signature = "a joint's zero that follows the temperature"
    needs = ("temperature_degC",)
    physics = "Encoder mounts and gear housings turn with temperature by some urad per K (Gong, Yuan and Ni 2000)."
    confused_with = "thermal_growth; joint_zero_step and frame_drift while the temperature only rises"
    size = {"drift": (6e-6, "rad/K")}

    @property
    def conditions(self) -> tuple[str, ...]:
        return (f"warmth_{self.lag:.0f}s",)

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        return self.value(context, "drift") * context.conditions[self.conditions[0]]

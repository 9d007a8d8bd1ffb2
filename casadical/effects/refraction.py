"""The instrument's beam is bent by air that is warmer above than below."""

from dataclasses import dataclass

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class Refraction(Effect):
    """The bend is the square of the way to the instrument; where that stands enters as the two slopes."""

    name = "refraction"
    on_list = "extended"
    of_measurement = True
    signature = "a beam bent by warm air"
    physics = (
        "The index of refraction falls by 1e-6 a kelvin, so a gradient g across the beam bends it by g s^2 / 2 over a "
        "way s (Edlen 1966): 12 micrometres over 5 m at 1 K/m."
    )
    confused_with = "base_compliance; link_flexure under an unchanging load"
    size = {"bend": (0.5e-6, "1/m"), "slope_x": (5e-6, "m/m"), "slope_y": (5e-6, "m/m")}

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        x, y = point[0], point[1]
        rise = self.value(context, "bend") * (x**2 + y**2)
        rise = rise + self.value(context, "slope_x") * x + self.value(context, "slope_y") * y
        return point + ca.vertcat(0, 0, rise)

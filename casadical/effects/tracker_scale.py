"""The instrument's scale is wrong by a small factor."""

from dataclasses import dataclass

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class TrackerScale(Effect):
    name = "tracker_scale"
    on_list = "extended"
    of_measurement = True
    signature = "all lengths wrong by one factor"
    physics = (
        "Distances are counted in wavelengths: 1 K or 3 hPa not accounted for make 1e-6 of every length (Edlen 1966)."
    )
    confused_with = "the lengths of all links, completely: only a known length (a scale bar) distinguishes them"
    size = {"k": (5e-6, "m/m")}

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        return point * (1 + self.value(context, "k"))

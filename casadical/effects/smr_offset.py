"""The optical centre of the reflector lies beside the centre of its sphere."""

from dataclasses import dataclass

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class SmrOffset(Effect):
    """station : where the instrument stands, in the measuring frame [m]; most have their own origin there"""

    station: tuple[float, float, float] = (0.0, 0.0, 0.0)

    name = "smr_offset"
    on_list = "extended"
    of_measurement = True
    signature = "an offset that stays fixed against the beam"
    physics = (
        "A reflector is turned in its nest to face the instrument: its offset, some micrometres, stays fixed against "
        "the beam (ISO 10360-10), along it and, if it is always held the same way up, above it."
    )
    confused_with = "tracker_scale; refraction"
    size = {"along": (10e-6, "m"), "across": (10e-6, "m"), "above": (10e-6, "m")}

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        beam = point - ca.DM(self.station)
        along = beam / ca.sqrt(ca.sumsqr(beam) + 1e-12)
        across = ca.vertcat(-along[1], along[0], 0) / ca.sqrt(along[0] ** 2 + along[1] ** 2 + 1e-12)
        turned = ca.horzcat(along, across, ca.cross(along, across))
        return point + turned @ ca.vertcat(*(self.value(context, n) for n in self.sizes()))

"""The far end of measured distances shifts at once during the campaign."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, setting
from casadical.effects.distance_faults import WIRES, DistanceFault
from casadical.effects.grids import FEW_TIMES


@dataclass(frozen=True)
class StationStep(DistanceFault):
    """at : when, as a share of the campaign"""

    at: float = setting(0.5, FEW_TIMES, steps=True)

    name = "station_step"
    on_list = "standard"
    needs = (*DistanceFault.needs, "progress")
    signature = "one instrument, or its far end, stands elsewhere from some pose on"
    physics = "A knocked tripod, an anchor that slips in its clamp: the far end of the distances moves."
    confused_with = "frame_step, if all instruments stand together"
    size: ClassVar[Mapping[str, tuple[float, str]]] = {
        f"{c}{k}": (2e-4, "m") for k in range(1, WIRES + 1) for c in "xyz"
    }

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        moved = ca.vertcat(*(self.of_wires(context, c) for c in "xyz"))
        return point - moved * (context.conditions["progress"] > self.at)

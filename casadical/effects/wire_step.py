"""What an instrument reads of one distance jumps once during the campaign."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, setting
from casadical.effects.distance_faults import WIRES, DistanceFault, along
from casadical.effects.grids import TIMES


@dataclass(frozen=True)
class WireStep(DistanceFault):
    """at : when, as a share of the campaign"""

    at: float = setting(0.5, TIMES, steps=True)

    name = "wire_step"
    on_list = "standard"
    needs = (*DistanceFault.needs, "progress")
    signature = "all distances of one instrument longer by the same from some pose on"
    physics = "A wire slips on its drum, or a counter loses counts: from then on all lengths are wrong alike."
    confused_with = "station_step, if the beam hardly turns; wire_drift"
    size: ClassVar[Mapping[str, tuple[float, str]]] = {f"step{k}": (1e-3, "m") for k in range(1, WIRES + 1)}

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        jumped = self.of_wires(context, "step") * (context.conditions["progress"] > self.at)
        return point + along(self.beam(point, context)) * jumped

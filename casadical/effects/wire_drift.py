"""What an instrument reads of one distance drifts with time."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context
from casadical.effects.distance_faults import WIRES, DistanceFault, along


@dataclass(frozen=True)
class WireDrift(DistanceFault):
    name = "wire_drift"
    on_list = "standard"
    needs = (*DistanceFault.needs, "progress")
    signature = "distances of one instrument that grow with time"
    physics = "A potentiometer or an amplifier warms up, a wire creeps: what is read of one length drifts steadily."
    confused_with = "frame_drift towards the instrument"
    size: ClassVar[Mapping[str, tuple[float, str]]] = {f"drift{k}": (2e-4, "m") for k in range(1, WIRES + 1)}

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        grown = (context.conditions["progress"] - 0.5) * self.of_wires(context, "drift")
        return point + along(self.beam(point, context)) * grown

"""The zero of an instrument that reads distances is wrong."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context
from casadical.effects.distance_faults import WIRES, DistanceFault, along


@dataclass(frozen=True)
class WireOffset(DistanceFault):
    name = "wire_offset"
    on_list = "standard"
    signature = "all distances of one instrument too long by the same"
    physics = "The zero of a wire is where its drum was set: wrong, all lengths are wrong alike."
    confused_with = "a tool that is longer towards the instrument, where the tool hardly turns"
    size: ClassVar[Mapping[str, tuple[float, str]]] = {f"zero{k}": (2e-4, "m") for k in range(1, WIRES + 1)}

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        return point + along(self.beam(point, context)) * self.of_wires(context, "zero")

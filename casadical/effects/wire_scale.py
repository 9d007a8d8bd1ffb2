"""The scale of an instrument that reads distances is wrong."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context
from casadical.effects.distance_faults import WIRES, DistanceFault


@dataclass(frozen=True)
class WireScale(DistanceFault):
    name = "wire_scale"
    on_list = "standard"
    signature = "all distances of one instrument wrong by one factor"
    physics = "The drum of a wire is larger than its scale says, or the wire stretches with its length."
    confused_with = "the lengths of all links, where nothing else gives the scale"
    size: ClassVar[Mapping[str, tuple[float, str]]] = {f"k{k}": (2e-4, "m/m") for k in range(1, WIRES + 1)}

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        return point + self.beam(point, context) * self.of_wires(context, "k")

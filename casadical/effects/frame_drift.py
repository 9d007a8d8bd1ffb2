"""The measuring frame creeps against the robot with time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class FrameDrift(Effect):
    """shape : power of time; 1 creeps steadily, less settles, more comes late."""

    shape: float = 1.0

    name: ClassVar[str] = "frame_drift"
    needs: ClassVar[tuple[str, ...]] = ("progress",)
    physics: ClassVar[str] = (
        "Tripods settle and floors warm: the instrument's frame moves some tens of micrometres an hour."
    )
    confused_with: ClassVar[str] = (
        "thermal_growth and thermal_zero_drift while the temperature only rises; a step in time"
    )

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return dict.fromkeys("xyz", (6e-05, "m")) | {f"r{c}": (25e-6, "rad") for c in "xyz"}

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        when = (context.conditions["progress"] + 1e-6) ** self.shape
        creep = ca.vertcat(*(self.value(context, c) for c in "xyz"))
        turn = ca.vertcat(*(self.value(context, f"r{c}") for c in "xyz"))
        return point + when * (creep + ca.cross(turn, point))

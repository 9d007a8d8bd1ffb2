"""A joint's zero drifts with temperature."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class ThermalZeroDrift(Effect):
    """lag : time constant with which the joint follows the sensor [s]."""

    lag: float = 600.0

    name: ClassVar[str] = "thermal_zero_drift"
    needs: ClassVar[tuple[str, ...]] = ("temperature_degC",)
    physics: ClassVar[str] = (
        "Encoder mounts and gear housings turn with temperature by some urad per K (Gong, Yuan and Ni 2000)."
    )
    confused_with: ClassVar[str] = "thermal_growth; joint_zero_step and frame_drift while the temperature only rises"

    @property
    def conditions(self) -> tuple[str, ...]:
        return (f"warmth_{self.lag:.0f}s",)

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {"drift": (6e-6, "rad/K")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:  # noqa: ARG002 - the same at every reading
        return self.value(context, "drift") * context.conditions[self.conditions[0]]

"""A joint's zero jumps once during the campaign."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class JointZeroStep(Effect):
    """at : when, as a share of the campaign."""

    at: float = 0.5

    name: ClassVar[str] = "joint_zero_step"
    needs: ClassVar[tuple[str, ...]] = ("progress",)
    physics: ClassVar[str] = "A slipped belt or collision, or a re-mastered axis, shifts the zero of one joint."
    confused_with: ClassVar[str] = "target_shift at the same time; thermal_zero_drift while the arm warms up"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {"step": (80e-6, "rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:  # noqa: ARG002 - the same at every reading
        return self.value(context, "step") * (context.conditions["progress"] > self.at)

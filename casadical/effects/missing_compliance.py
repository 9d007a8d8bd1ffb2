"""A joint that the model takes as rigid gives way under its torque."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class MissingCompliance(Effect):
    name: ClassVar[str] = "missing_compliance"
    physics: ClassVar[str] = (
        "Every drive train is a spring: its deflection is its torque over its stiffness (paper, 4)."
    )
    confused_with: ClassVar[str] = "payload_error; wholly absorbed where the model has this joint's compliance already"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {"deflection": (200e-6, "rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:  # noqa: ARG002 - a function of the torque
        assert self.joint is not None
        return self.value(context, "deflection") * context.load(self.joint)

"""A joint's torque is a polynomial of its deflection: linear and cubic (the paper's outlook)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class CubicStiffness(Effect):
    name: ClassVar[str] = "cubic_stiffness"
    physics: ClassVar[str] = (
        "tau = k1 d + k3 d^3, solved for d to first order: d = c tau - b (tau / great torque)^3 (paper, 3)."
    )
    confused_with: ClassVar[str] = "nonlinear_stiffness, of which it is one form"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {"bend": (60e-6, "rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:  # noqa: ARG002 - a function of the torque
        assert self.joint is not None
        return -self.value(context, "bend") * context.load(self.joint) ** 3

"""A joint is softer at small torque than at large."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class NonlinearStiffness(Effect):
    """knee : torque at which the joint has stiffened, as a share of its great torques."""

    knee: float = 0.3

    name: ClassVar[str] = "nonlinear_stiffness"
    physics: ClassVar[str] = (
        "Gear teeth and strain-wave cups bed in: the deflection saturates, c tau + b tanh(tau / knee) "
        "(Kircanski and Goldenberg 1997)."
    )
    confused_with: ClassVar[str] = "backlash on the side of the gravity torque; cubic stiffness; payload_error"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {"bend": (60e-6, "rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:  # noqa: ARG002 - a function of the torque
        assert self.joint is not None
        return self.value(context, "bend") * ca.tanh(context.load(self.joint) / self.knee)

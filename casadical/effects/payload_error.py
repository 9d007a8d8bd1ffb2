"""The declared payload has another mass and mass centre."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class PayloadError(Effect):
    name: ClassVar[str] = "payload_error"
    needs: ClassVar[tuple[str, ...]] = ("payload_kg",)
    physics: ClassVar[str] = (
        "Gravity on the true payload differs from the declared one; it acts through the joints' springs."
    )
    confused_with: ClassVar[str] = "nonlinear_stiffness; compliance of the wrist where the payload never changes"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {"mass": (0.06, "kg/kg"), **dict.fromkeys("xyz", (0.03, "m"))}

    def energy(self, context: Context) -> Symbolic:
        payload = context.arm.payload
        if payload is None:
            return 0.0
        kg, T = context.conditions["payload_kg"], context.frames[-1]
        shift = ca.vertcat(*(self.value(context, c) for c in "xyz"))
        moment = self.value(context, "mass") * ca.DM(payload.com) + shift
        point = T[:3, :3] @ moment + self.value(context, "mass") * T[:3, 3]
        return -kg * ca.dot(context.gravity, point)

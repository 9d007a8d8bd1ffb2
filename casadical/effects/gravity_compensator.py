"""An unmodelled balancing spring on joint 2."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class GravityCompensator(Effect):
    """anchor : distance of the spring's fixed end from the joint, as a multiple of its lever on the arm

    phase : reading at which spring, joint and lever lie in line [rad]
    """

    anchor: float = 2.0
    phase: float = 0.0

    name: ClassVar[str] = "gravity_compensator"
    physics: ClassVar[str] = (
        "A spring between base and arm pulls joint 2 by k a b sin(g) (1 - l0/l(g)): without preload a sine, with "
        "preload the sine over the spring's length (Klimchik et al. 2013)."
    )
    confused_with: ClassVar[str] = "gear_eccentricity of joint 2, wholly, unless payload or spring pressure change"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        # Shares of the joint's great torque.
        return {"sin": (0.3, ""), "cos": (0.3, ""), "preload": (0.3, "")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        assert self.joint is not None
        turn = q + context.values[f"theta{self.joint}"] - self.phase
        length = ca.sqrt(1 + self.anchor**2 + 2 * self.anchor * ca.cos(turn)) / self.anchor
        share = self.value(context, "sin") * ca.sin(turn) + self.value(context, "cos") * ca.cos(turn)
        share = share + self.value(context, "preload") * ca.sin(turn) / length
        return context.values.get(f"c{self.joint}", 0.0) * context.torque_scale[self.joint - 1] * share

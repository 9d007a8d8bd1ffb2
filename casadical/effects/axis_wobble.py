"""A joint's axis tilts and shifts as it turns."""

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from casadical.core.transforms import Symbolic, small_frame
from casadical.effects.base import Context, Effect, setting


@dataclass(frozen=True)
class AxisWobble(Effect):
    """A wave of the bearing ring that turns with the link, or of the one that stands still.

    cycles : 1 or 2 a turn; still : whether the wave is seen from the link before the joint, where it has one cycle less
    and one more as seen from the link behind it
    """

    cycles: int = setting(1, (1, 2))
    still: bool = setting(False, (False, True))

    name = "axis_wobble"
    on_list = "standard"
    acts_at = "turning joints"
    signature = "an axis that tilts and shifts as it turns (bearing, eccentric flange)"
    physics = "Bearing run-out: the axis of rotation tilts and translates periodically (ISO 230-7)."
    confused_with = "base_compliance for joint 1; gear_eccentricity of neighbours"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        parts = [f"{c}_{f}" for c in ("rx", "ry", "x", "y") for f in ("sin", "cos")]
        return {p: (25e-6, "rad") if p[0] == "r" else (20e-6, "m") for p in parts}

    def link(self, number: int, context: Context) -> Symbolic:
        if number != self.joint:
            return ca.SX.eye(4)
        q = context.q[number - 1]
        rx, ry, x, y = (
            self.value(context, f"{c}_sin") * ca.sin(self.cycles * q)
            + self.value(context, f"{c}_cos") * ca.cos(self.cycles * q)
            for c in ("rx", "ry", "x", "y")
        )
        if self.still:
            (rx, ry), (x, y) = _turned_back(rx, ry, q), _turned_back(x, y, q)
        return small_frame(x, y, 0, rx, ry, 0)


def _turned_back(x: Symbolic, y: Symbolic, q: Symbolic) -> tuple[Symbolic, Symbolic]:
    """A vector across the axis as seen from a link that has turned by q."""
    return ca.cos(q) * x + ca.sin(q) * y, ca.cos(q) * y - ca.sin(q) * x

"""A link bends and twists under the weight beyond it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from casadical.core.transforms import Symbolic, small_frame, translate
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class LinkFlexure(Effect):
    """member : the link (1-based) that bends."""

    member: int = 2

    name: ClassVar[str] = "link_flexure"
    physics: ClassVar[str] = (
        "A beam under a moment turns its end by M l / (E I) about each axis; the part about the next joint's axis is "
        "that joint's compliance (Klimchik, Pashkevich and Chablat 2013)."
    )
    confused_with: ClassVar[str] = "cross_coupling of torques; base_compliance for the first link"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {f"{c}{self.member}": (60e-6, "rad") for c in ("rx", "ry", "rz")}

    def link(self, number: int, context: Context) -> Symbolic:
        if number != self.member:
            return ca.SX.eye(4)
        turn = context.frames[number - 1][:3, :3].T
        root, end = (turn @ context.moment(k) / context.great_moment for k in (number, min(number + 1, context.arm.n)))
        k = ca.vertcat(*(self.value(context, f"{c}{self.member}") for c in ("rx", "ry", "rz")))
        # End slope and deflection of a beam whose moment runs linearly from root to end.
        slope, sag = k * (root + end) / 2, k * (2 * root + end) / 6
        far = ca.SX.zeros(3)
        if number < context.arm.n:
            far = turn @ (context.frames[number][:3, 3] - context.frames[number - 1][:3, 3])
        shift = far + ca.cross(sag, far)
        return (
            translate(*ca.vertsplit(shift))
            @ small_frame(0, 0, 0, *ca.vertsplit(slope))
            @ translate(*ca.vertsplit(-far))
        )

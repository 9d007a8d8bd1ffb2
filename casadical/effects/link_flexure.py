"""A link bends and twists under the weight beyond it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadical.core.arm import Arm
from casadical.core.transforms import Symbolic, small_frame, translate
from casadical.effects.base import Context, Effect, setting
from casadical.effects.counterparts import Counterparts

# A link shorter than this share of the longest bends a thirtieth of it.
BEAM = 0.3


@dataclass(frozen=True)
class LinkFlexure(Effect):
    """member : the link (1-based) that bends."""

    member: int = setting(2, joint=True)

    name = "link_flexure"
    on_list = "standard"
    signature = "a link that bends under the weight beyond it"
    physics = (
        "A beam under a moment turns its end by M l / (E I) about each axis; the part about the next joint's axis is "
        "that joint's compliance (Klimchik, Pashkevich and Chablat 2013)."
    )
    confused_with = "cross_coupling of torques; base_compliance for the first link"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """The links long enough to bend: a beam's sag goes with the cube of its length; short links are castings."""
        lengths = np.array([np.hypot(j.a, j.d) for j in arm.joints[1:]])
        return (cls(None, k) for k, length in enumerate(lengths, 1) if length >= BEAM * lengths.max())

    @classmethod
    def variants(cls, arm: Arm) -> Iterable[tuple[Effect, ...]]:
        """Each beam alone, and all of them together."""
        links = tuple(cls.candidates(arm))
        return (*((e,) for e in links), links)

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

    def counterpart(self, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
        return simulator.with_springs(self.label, v, self.member)

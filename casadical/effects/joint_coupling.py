"""A joint turns by a fraction of another joint's reading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class JointCoupling(Effect):
    """source : the joint (1-based) whose reading moves this one."""

    source: int = 1

    name: ClassVar[str] = "joint_coupling"
    physics: ClassVar[str] = (
        "Wrist motors drive through hollow shafts: an error of the coupling ratio moves the next joint."
    )
    confused_with: ClassVar[str] = "joint_scale of the source joint where both axes are nearly parallel"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {f"k{self.source}": (80e-6, "rad/rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:  # noqa: ARG002 - moved by the other joint
        return self.value(context, f"k{self.source}") * context.q[self.source - 1]

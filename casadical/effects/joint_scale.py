"""A joint's gear ratio is wrong by a small factor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class JointScale(Effect):
    name: ClassVar[str] = "joint_scale"
    physics: ClassVar[str] = "A wrong ratio turns the joint by k q too much (Hollerbach and Wampler 1996)."
    confused_with: ClassVar[str] = "gear_eccentricity over less than a turn"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {"k": (60e-6, "rad/rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        return self.value(context, "k") * q

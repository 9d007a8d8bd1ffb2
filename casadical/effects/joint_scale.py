"""A joint's gear ratio is wrong by a small factor."""

from collections.abc import Mapping
from dataclasses import dataclass

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect
from casadical.effects.counterparts import Counterparts


@dataclass(frozen=True)
class JointScale(Effect):
    name = "joint_scale"
    on_list = "standard"
    signature = "error that grows with the reading (ratio; eccentricity over part of a turn)"
    physics = "A wrong ratio turns the joint by k q too much (Hollerbach and Wampler 1996)."
    confused_with = "gear_eccentricity over less than a turn"
    size = {"k": (60e-6, "rad/rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        return self.value(context, "k") * q

    def counterpart(self, found: Counterparts, v: Mapping[str, float]) -> Counterparts:
        return found.with_drive(self.joint, ratio=1 + v["k"]).noted(f"{self.label}: gear of the drive")

"""Compliance of a joint that the model takes as rigid."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from casadical.core.arm import Arm
from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect
from casadical.effects.counterparts import Counterparts


@dataclass(frozen=True)
class MissingCompliance(Effect):
    name = "missing_compliance"
    simulated_first = True
    on_list = "extended"
    signature = "deflection of a joint that the model takes as rigid"
    physics = "Every drive train is a spring: its deflection is its torque over its stiffness (paper, 4)."
    confused_with = "payload_error; completely absorbed if the model has this joint's compliance already"
    size = {"deflection": (200e-6, "rad")}

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(j) for j in arm.numbers if not arm.joints[j - 1].compliance)

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        return self.value(context, "deflection") * context.load(self.joint)

    def counterpart(self, found: Counterparts, v: Mapping[str, float]) -> Counterparts:
        if v["deflection"] <= 0:
            return found.without_sign(self.label)
        soft = found.drive(self.joint).compliance + v["deflection"] / found.great(self.joint)
        return found.with_drive(self.joint, compliance=soft).noted(f"{self.label}: spring of joint {self.joint}")

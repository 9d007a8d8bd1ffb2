"""A joint turns by a fraction of another joint's reading."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from casadical.core.arm import Arm
from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect, setting


@dataclass(frozen=True)
class JointCoupling(Effect):
    """source : the joint (1-based) whose reading moves this one."""

    source: int = setting(1, joint=True)

    name = "joint_coupling"
    on_list = "standard"
    signature = "error that follows another joint's reading (wrist gears, hoses)"
    physics = "Wrist motors drive through hollow shafts: an error of the coupling ratio moves the next joint."
    confused_with = "joint_scale of the source joint where both axes are nearly parallel"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(j, i) for j in arm.numbers for i in arm.near(j))

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {f"k{self.source}": (80e-6, "rad/rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        return self.value(context, f"k{self.source}") * context.q[self.source - 1]

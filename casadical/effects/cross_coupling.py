"""A joint is deflected by the torque of another one."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from casadical.core.arm import Arm
from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect, setting


@dataclass(frozen=True)
class CrossCoupling(Effect):
    """source : the joint (1-based) whose torque moves this one."""

    source: int = setting(1, joint=True)

    name = "cross_coupling"
    on_list = "extended"
    signature = "a joint that gives way to another one's torque (parallelogram, link bending)"
    physics = (
        "The stiffness matrix has terms off its diagonal: with a parallelogram, bending of the upper arm turns joint "
        "3 by joint 2's torque, or the other way round (Klimchik et al. 2013)."
    )
    confused_with = "link_flexure; tell by payloads at two offsets"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(j, i) for j in arm.numbers for i in arm.near(j))

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {f"k{self.source}": (60e-6, "rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        return self.value(context, f"k{self.source}") * context.load(self.source)

"""Play in a gear that the gravity torque alone takes up: what backlash is where the approach was not logged."""

from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca

from casadical.core.arm import Arm
from casadical.core.transforms import Symbolic
from casadical.effects.backlash import Backlash
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class BacklashByLoad(Backlash):
    """Without friction, so that it does not matter from where the pose was approached; see `Backlash`."""

    friction: float = 0.0

    name = "backlash_by_load"
    answers_as = "backlash"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(j, 0.0, width) for j in arm.numbers for width in (0.003, 0.01, 0.03, 0.1, 0.3))

    @property
    def conditions(self) -> tuple[str, ...]:
        return ()

    @property
    def only_without(self) -> tuple[str, ...]:
        return (f"approach{self.joint}",)

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        return self.value(context, "half") * ca.tanh(context.load(self.joint) / self.width)

"""Play in a gear."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import casadi as ca

from casadical.core.arm import Arm
from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect
from casadical.effects.counterparts import Counterparts

FRICTIONS = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32)


@dataclass(frozen=True)
class Backlash(Effect):
    """Play in a gear, taken up by the gravity torque, or by the approach where there is little torque.

    The flank changes where gravity overcomes friction.

    friction : torque below which the approach decides; width : of the change; shares of the joint's great torques
    """

    friction: float = 0.05
    width: float = 0.03

    name = "backlash"
    on_list = "standard"
    signature = "two positions, by the sign of gravity's torque"
    physics = (
        "The tooth rests on the flank to which gravity pushes it; where friction holds it against gravity, on the "
        "flank that drove it there (Ruderman, Hoffmann and Bertram 2009)."
    )
    confused_with = "friction_windup where the torque is small; nonlinear_stiffness where it is large"
    together = True
    size = {"half": (50e-6, "rad")}

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(j, f, f * w) for j in arm.numbers for f in FRICTIONS for w in (0.3, 0.6, 1.2))

    @property
    def conditions(self) -> tuple[str, ...]:
        return (f"approach{self.joint}",)

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        # The link lies behind its last motion.
        push = context.load(self.joint) - self.friction * context.conditions[f"approach{self.joint}"]
        return self.value(context, "half") * ca.tanh(push / self.width)

    def counterpart(self, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
        if v["half"] <= 0:
            return simulator.without_sign(self.label)
        held = self.friction * simulator.great(self.joint)
        simulator = simulator.with_drive(self.joint, play=v["half"], play_friction=held)
        return simulator.noted(f"{self.label}: joint{self.joint}_play with limits of +-{1e6 * v['half']:.1f} urad")


@dataclass(frozen=True)
class BacklashByLoad(Backlash):
    """Play in a gear that the gravity torque alone takes up: what backlash is where the approach was not logged.

    Without friction, so that it does not matter from where the pose was approached; see `Backlash`.
    """

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

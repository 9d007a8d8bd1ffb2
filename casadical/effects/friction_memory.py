"""Friction that builds up along a joint's way, and remembers the ways before."""

from dataclasses import dataclass

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect, setting


@dataclass(frozen=True)
class FrictionMemory(Effect):
    """way : over which friction turns over after a change of direction [mrad, or mm of a prismatic joint]."""

    way: int = setting(300, (100, 300, 1000))

    name = "friction_memory"
    on_list = "extended"
    signature = "a lag behind the last motions that grows with their length"
    physics = (
        "Presliding friction follows the way, not the direction alone: its state goes to one exponentially along each "
        "motion, from where the last one left it (Dahl 1968)."
    )
    confused_with = "friction_windup, where all motions are long; settling_lag"
    size = {"half": (40e-6, "rad")}

    @property
    def conditions(self) -> tuple[str, ...]:
        return (f"memory{self.joint}_{self.way}mrad",)

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        return -self.value(context, "half") * context.conditions[self.conditions[0]]

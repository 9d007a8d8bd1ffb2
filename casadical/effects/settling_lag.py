"""A joint is measured before it has come to rest."""

from collections.abc import Mapping
from dataclasses import dataclass

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class SettlingLag(Effect):
    name = "settling_lag"
    on_list = "extended"
    signature = "a lag behind the last motion in proportion to its length"
    physics = "A drive that settles exponentially is short by a share of its last way if it is measured too soon."
    confused_with = "friction_windup; friction_memory"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {"share": (40e-6, "rad/rad")}

    @property
    def conditions(self) -> tuple[str, ...]:
        return (f"move{self.joint}",)

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        return -self.value(context, "share") * context.conditions[self.conditions[0]]

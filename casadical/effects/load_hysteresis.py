"""A joint's spring holds back part of its deflection against the last motion, the more the higher the load."""

from dataclasses import dataclass

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect, setting


@dataclass(frozen=True)
class LoadHysteresis(Effect):
    """power : of the load in the loop's half width; 1 dry friction in the teeth, 2 inner friction of the material"""

    power: int = setting(1, (1, 2))

    name = "load_hysteresis"
    on_list = "extended"
    signature = "a lag behind the last motion that grows with the load"
    physics = (
        "Loading and unloading a gear follow two branches; their distance grows with the torque (dry friction), or "
        "with its square (inner friction, as in Rayleigh's law). Nothing of it is left at an idle joint."
    )
    confused_with = "friction_windup, its load-dependent part; both approaches without load distinguish them"
    size = {"half": (40e-6, "rad")}

    @property
    def conditions(self) -> tuple[str, ...]:
        return (f"approach{self.joint}",)

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        load = ca.sqrt(context.load(self.joint) ** 2 + 1e-6)
        return -self.value(context, "half") * context.conditions[f"approach{self.joint}"] * load**self.power

"""The pedestal tilts under the overturning moment."""

from collections.abc import Mapping
from dataclasses import dataclass

from casadical.core.transforms import Symbolic, small_frame
from casadical.effects.base import Context, Effect
from casadical.effects.counterparts import Counterparts


@dataclass(frozen=True)
class BaseCompliance(Effect):
    name = "base_compliance"
    on_list = "standard"
    signature = "a foot that tilts under the overturning moment"
    physics = "Foundation and pedestal are a rotary spring about the two horizontal axes: tilt = moment / stiffness."
    confused_with = "axis_wobble of joint 1; link_flexure of the first link"
    size = {"rx": (60e-6, "rad"), "ry": (60e-6, "rad")}

    def base(self, context: Context) -> Symbolic:
        moment = context.moment(1) / context.great_moment
        return small_frame(0, 0, 0, self.value(context, "rx") * moment[0], self.value(context, "ry") * moment[1], 0)

    def counterpart(self, found: Counterparts, v: Mapping[str, float]) -> Counterparts:
        return found.with_springs(self.label, v, 0)

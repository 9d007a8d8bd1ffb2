"""The pedestal tilts under the overturning moment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from casadical.core.transforms import Symbolic, small_frame
from casadical.effects.base import Context, Effect


@dataclass(frozen=True)
class BaseCompliance(Effect):
    name: ClassVar[str] = "base_compliance"
    physics: ClassVar[str] = (
        "Foundation and pedestal are a rotary spring about the two horizontal axes: tilt = moment / stiffness."
    )
    confused_with: ClassVar[str] = "axis_wobble of joint 1; link_flexure of the first link"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {"rx": (60e-6, "rad"), "ry": (60e-6, "rad")}

    def base(self, context: Context) -> Symbolic:
        moment = context.moment(1) / context.great_moment
        return small_frame(0, 0, 0, self.value(context, "rx") * moment[0], self.value(context, "ry") * moment[1], 0)

"""What a flange carries for measured poses, a camera or a board, shifts and turns at once during the campaign."""

from dataclasses import dataclass

from casadical.core.transforms import Symbolic, small_frame
from casadical.effects.base import Context, setting
from casadical.effects.camera_faults import CameraFault, columns
from casadical.effects.grids import FEW_TIMES


@dataclass(frozen=True)
class HandEyeStep(CameraFault):
    """at : when, as a share of the campaign"""

    at: float = setting(0.5, FEW_TIMES, steps=True)

    name = "hand_eye_step"
    on_list = "standard"
    needs = (*columns("fixed", "depth"), "progress")
    signature = "a jump of what is mounted on the flange, camera or board, turned too"
    physics = "A camera's bracket that was knocked, a board that slipped on its magnets: hand to eye is another frame."
    confused_with = "target_shift, where it hardly turned; joint_zero_step of the last joint"
    size = dict.fromkeys("xyz", (2e-4, "m")) | {f"r{c}": (5e-4, "rad") for c in "xyz"}

    def tool(self, context: Context) -> Symbolic:
        after = context.conditions["progress"] > self.at
        return small_frame(*(self.value(context, name) * after for name in self.size))

"""What stands beside the robot for measured poses, a camera or a board, shifts and turns at once."""

from dataclasses import dataclass

from casadical.core.transforms import Symbolic, small_frame
from casadical.effects.base import Context, setting
from casadical.effects.camera_faults import CameraFault, columns
from casadical.effects.grids import FEW_TIMES


@dataclass(frozen=True)
class StandStep(CameraFault):
    """at : when, as a share of the campaign"""

    at: float = setting(0.5, FEW_TIMES, steps=True)

    name = "stand_step"
    on_list = "standard"
    needs = (*columns("fixed", "depth"), "progress")
    signature = "a jump of what stands, camera or board, against the robot, turned too"
    physics = "A knocked tripod, a board that was pushed on its table: all poses from then on are in another frame."
    confused_with = "frame_step of the robot's foot, completely; joint_zero_step of joint 1"
    size = dict.fromkeys("xyz", (2e-4, "m")) | {f"r{c}": (2e-4, "rad") for c in "xyz"}

    def base(self, context: Context) -> Symbolic:
        after = context.conditions["progress"] > self.at
        return small_frame(*(self.value(context, name) * after for name in self.size))

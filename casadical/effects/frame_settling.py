"""The measuring frame moves against the robot after the start, ever more slowly, until it rests."""

from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca

from casadical.core.arm import Arm
from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect
from casadical.effects.frame_drift import FrameDrift


@dataclass(frozen=True)
class FrameSettling(FrameDrift):
    """settles : time constant as a share of the campaign"""

    settles: float = 0.1

    name = "frame_settling"
    answers_as = "frame_drift"
    signature = "a measuring frame that moves at the start and comes to rest"
    physics = (
        "An instrument, a tripod or an arm that warms up comes to its temperature exponentially (Newton's law of "
        "cooling); it moves until then."
    )

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(None, settles=s) for s in (0.02, 0.05, 0.12, 0.3))

    def course(self, context: Context) -> Symbolic:
        return 1 - ca.exp(-context.conditions["progress"] / self.settles)

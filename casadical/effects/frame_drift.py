"""The measuring frame creeps against the robot with time."""

from dataclasses import dataclass

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect, setting


@dataclass(frozen=True)
class FrameDrift(Effect):
    """shape : power of time; 1 creeps steadily, less settles, more comes late."""

    shape: float = setting(1.0, (0.5, 1.0, 2.0), steps=True)

    name = "frame_drift"
    on_list = "standard"
    of_measurement = True
    signature = "a measuring frame that creeps with time"
    needs = ("progress",)
    physics = "Tripods settle and floors warm: the instrument's frame moves some tens of micrometres an hour."
    confused_with = "thermal_growth and thermal_zero_drift while the temperature only rises; a step in time"
    size = dict.fromkeys("xyz", (6e-05, "m")) | {f"r{c}": (25e-6, "rad") for c in "xyz"}

    def course(self, context: Context) -> Symbolic:
        """Share of the whole drift that has happened, 0 to 1."""
        return (context.conditions["progress"] + 1e-6) ** self.shape

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        when = self.course(context)
        creep = ca.vertcat(*(self.value(context, c) for c in "xyz"))
        turn = ca.vertcat(*(self.value(context, f"r{c}") for c in "xyz"))
        return point + when * (creep + ca.cross(turn, point))

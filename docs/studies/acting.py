"""Effects that are no kind of the engine's, put into its campaigns by what they do at rest.

The engine brings the robot to rest. What follows the load, or moves a part of the arm, acts by the rest of the robot
without it: how its own displacement changes the loads is left out, which is of second order.
"""

from dataclasses import dataclass

import numpy as np

from casadical.blind_check.mujoco_physics import cause
from casadical.blind_check.mujoco_physics.cause import Cause, Kind, rated_torque, settle
from casadical.blind_check.mujoco_physics.plant import Array, Plant, move
from casadical.blind_check.mujoco_physics.stops import Stops


@dataclass(frozen=True)
class State(cause.State):
    """n poses at rest; rated : shape (joints,), the largest torque of the weights on each joint [N m]."""

    rated: Array


@dataclass(frozen=True)
class Disturbance:
    """One thing that geometry and linear joint compliance do not contain; a part that is not written does nothing."""

    def misread(self, stops: Stops) -> Array | float:  # noqa: ARG002
        """Return what the true joint angles are beyond the readings, without load, shape (n, joints) [rad]."""
        return 0.0

    def torque(self, state: State) -> Array | float:  # noqa: ARG002
        """Return torques on the actuated joints beside those of the weights, shape (n, joints) [N m]."""
        return 0.0

    def twist(self, state: State) -> Array | float:  # noqa: ARG002
        """Return twists of the joints beside torque over stiffness, shape (n, joints) [rad]."""
        return 0.0

    def outboard(self, link: int, state: State) -> Array | None:  # noqa: ARG002
        """Return the motion (n, 4, 4) of all beyond a link (0 pedestal), seen from it at zero readings; None: none."""
        return None

    def reflector(self, stops: Stops) -> Array | float:  # noqa: ARG002
        """Return how far the reflector sits off its place in the last frame, shape (n, 3) [m]."""
        return 0.0

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:  # noqa: ARG002
        """Return what the instrument makes of positions, shape (n, 3) [m]."""
        return xyz


@dataclass(frozen=True)
class Acting(Cause):
    """A disturbance of one robot as a cause in the engine."""

    effect: Disturbance
    plant: Plant

    def _rest(self, stops: Stops) -> State:
        return State(**vars(settle(self.plant, stops)), rated=rated_torque(self.plant))

    def motors(self, plant: Plant, stops: Stops) -> Array:
        state = self._rest(stops)
        turned = self.effect.misread(stops) + self.effect.twist(state) + self.effect.torque(state) / plant.stiffness
        return np.broadcast_to(turned, stops.q.shape)

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:
        state, plant = self._rest(stops), self.plant
        for link in range(plant.n + 1):
            motion = self.effect.outboard(link, state)
            if motion is not None:
                place = state.bodies[link - 1] if link else plant.base
                xyz = move(place @ motion @ np.linalg.inv(place), xyz)
        last = state.bodies[-1][:, :3, :3] @ plant.home[-1, :3, :3]
        off = np.broadcast_to(self.effect.reflector(stops), xyz.shape)
        return self.effect.measured(xyz + (last @ off[:, :, None])[:, :, 0], stops, rng)


def acting(effect: Disturbance, plant: Plant) -> Acting:
    """Return a disturbance as a cause of a campaign of the robot ``plant``."""
    return Acting(Kind("motors", type(effect)), {}, effect, plant)

"""The base of all disturbances: the places in the machine where one may act. Each does nothing unless it is given."""

from dataclasses import dataclass

import numpy as np

from casadical.blind_check.mujoco_physics.plant import Array, Plant
from casadical.blind_check.mujoco_physics.stops import Stops
from numpy_physics.state import State


@dataclass(frozen=True)
class Disturbance:
    """One thing about a robot that geometry and linear joint compliance do not contain.

    A disturbance is pure: what it does follows from its own numbers and the arguments, never from a hidden state.
    """

    def altered(self, plant: Plant) -> Plant:
        """The robot as it is really built."""
        return plant

    def misread(self, stops: Stops) -> Array | float:
        """What the true joint angles are beyond the readings, without load, shape (n, 6) [rad]."""
        return 0.0

    def torque(self, state: State) -> Array | float:
        """Torques on the actuated joints beside those of the weights, shape (n, 6) [N m]."""
        return 0.0

    def twist(self, state: State) -> Array | float:
        """Twists of the joints beside torque over stiffness, shape (n, 6) [rad]."""
        return 0.0

    def outboard(self, link: int, state: State) -> Array | None:
        """Motion (n, 4, 4) of all beyond a link (0 pedestal, 6 flange), seen from it at zero readings; None: none."""
        return None

    def reflector(self, stops: Stops) -> Array | float:
        """How far the reflector sits off its place in frame 6, shape (n, 3) [m]."""
        return 0.0

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:
        """What the instrument makes of positions, shape (n, 3) [m]."""
        return xyz

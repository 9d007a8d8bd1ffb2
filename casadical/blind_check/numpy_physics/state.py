"""The state of the machine: poses of the bodies, and moments of their weights about the true axes.

A four-bar passes its moments on through the force in its coupler.
"""

from dataclasses import dataclass

import numpy as np

from casadical.blind_check.synthetic.fourbar import close_loop
from casadical.blind_check.synthetic.plant import Plant
from casadical.blind_check.synthetic.rigid import Array, move, point
from casadical.blind_check.synthetic.stops import Stops

GRAVITY = 9.81


@dataclass(frozen=True)
class State:
    """n poses at rest, or on the way to it.

    plant, stops : the robot and the circumstances
    angles : array (n, 6), true angles of the actuated joints [rad]
    bodies : array (7, n, 4, 4), motions of links 1-6 and of what the flange carries, from zero readings to the
        measuring frame
    load : array (n, 6), torque on each actuated joint [N m]
    rated : array (6,), the largest torque of the weights on each joint [N m]
    """

    plant: Plant
    stops: Stops
    angles: Array
    bodies: Array
    load: Array
    rated: Array

    def axis(self, joint: int) -> tuple[Array, Array]:
        """Direction (n, 3) of the axis of ``joint`` (1-based) and a point (n, 3) [m] on it, in the measuring frame."""
        G = self.bodies[joint - 1]
        return point(G, self.plant.axes[joint - 1]), move(G, self.plant.centres[joint - 1])

    def weights(self) -> tuple[Array, Array]:
        """Masses (7, n) [kg] of the links and of the payload, and their centres (7, n, 3) [m] as measured."""
        plant, payload = self.plant, self.stops.payload_kg * self.plant.payload_factor
        mass = np.vstack([np.repeat(plant.mass[:, None], len(self.stops), 1), payload])
        homes = [plant.at_home(i + 1, plant.com[i]) for i in range(6)] + [plant.at_home(6, plant.payload_com)]
        return mass, move(self.bodies, np.array(homes)[:, None])

    def wrench_beyond(self, link: int, about: Array) -> tuple[Array, Array]:
        """Force (n, 3) [N] and moment (n, 3) [N m] about the points (n, 3) of all weights beyond ``link``."""
        mass, centre = self.weights()
        force = np.zeros((7, len(self.stops), 3))
        force[..., 2] = -GRAVITY * mass
        moment = np.cross(centre - about, force)
        return force[link:].sum(0), moment[link:].sum(0)


def moments(state: State) -> Array:
    """Torques of the weights on the actuated joints, shape (n, 6) [N m], positive along the joint's axis."""
    tau = np.empty((len(state.stops), 6))
    for joint in range(1, 7):
        axis, centre = state.axis(joint)
        tau[:, joint - 1] = np.sum(axis * state.wrench_beyond(joint - 1, centre)[1], -1)
    if state.plant.four_bar is not None:
        tau[:, 2] *= close_loop(state.plant, state.angles[:, 2] - state.angles[:, 1]).lever
        tau[:, 1] -= tau[:, 2]
    return tau

"""Where the bodies come to rest: motions about the true axes, moments of the weights, and their equilibrium.

The bodies are followed as motions from their places at zero readings (products of turns about the axes as they lie
then), not as products of link transforms. Joint torques are moments of weights about the axes where they really are;
the loop passes them on through the force in its coupler. Equilibrium is a fixed point: the torque at the pose that it
makes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadical.blind_check.numpy_physics.disturbance import Disturbance
from casadical.blind_check.numpy_physics.fourbar import close_loop, unfolded
from casadical.blind_check.numpy_physics.plant import Plant
from casadical.blind_check.numpy_physics.rigid import Array, move, point, turn
from casadical.blind_check.numpy_physics.stops import Stops, draw_poses
from casadical.core.errors import ConvergenceError

GRAVITY = 9.81


@dataclass(frozen=True)
class Rest:
    """n poses at (or on their way to) rest.

    Attributes
    ----------
    plant, stops : the robot and the circumstances
    angles : array (n, 6), true angles of the actuated joints [rad]
    bodies : array (7, n, 4, 4), motions of links 1-6 and of what the flange carries, from zero readings to the
        measuring frame
    load : array (n, 6), torque on each actuated joint [N m]
    rated : array (6,), the largest torque each joint knows [N m]
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


def moments(rest: Rest) -> Array:
    """Torques of the weights on the actuated joints, shape (n, 6) [N m], positive along the joint's axis."""
    tau = np.empty((len(rest.stops), 6))
    for joint in range(1, 7):
        axis, centre = rest.axis(joint)
        tau[:, joint - 1] = np.sum(axis * rest.wrench_beyond(joint - 1, centre)[1], -1)
    if rest.plant.four_bar is not None:
        tau[:, 2] *= close_loop(rest.plant, rest.angles[:, 2] - rest.angles[:, 1]).lever
        tau[:, 1] -= tau[:, 2]
    return tau


def placed(plant: Plant, stops: Stops, angles: Array) -> Rest:
    """The bodies at the true angles (n, 6) [rad] of the actuated joints, nothing bent; the loads are not known yet."""
    blank = Rest(plant, stops, angles, np.zeros((7, len(stops), 4, 4)), np.zeros_like(angles), np.ones(6))
    return replace(blank, bodies=_bodies(blank, angles, ()))


def settle(plant: Plant, stops: Stops, disturbances: Sequence[Disturbance] = (), jitter: Array | float = 0.0) -> Rest:
    """The poses at static equilibrium, to 1e-12 in angles [rad] and motions.

    ``jitter`` (n, 6) [rad] is added to the readings. Raises ConvergenceError where joints are too soft to come to rest.
    """
    for d in disturbances:
        plant = d.altered(plant)
    unloaded = stops.q + jitter + sum(d.misread(stops) for d in disturbances)
    rest = replace(placed(plant, stops, unloaded), rated=rated_torque(plant))
    for _ in range(200):
        load = moments(rest) + sum(d.torque(rest) for d in disturbances)
        rest = replace(rest, load=load)
        angles = unloaded + load / plant.stiffness + sum(d.twist(rest) for d in disturbances)
        bodies = _bodies(rest, angles, disturbances)
        change = max(np.abs(angles - rest.angles).max(), np.abs(bodies - rest.bodies).max())
        rest = replace(rest, angles=angles, bodies=bodies)
        if change < 1e-12:
            return rest
    raise ConvergenceError(f"no rest after 200 steps: the last one moved by {change:.1e}; are the joints too soft?")


def rated_torque(plant: Plant) -> Array:
    """The largest torque of the weights on each joint in 300 fixed poses, (6,) [N m]; at least 5 % of the greatest."""
    q = draw_poses(plant, 300, np.random.default_rng(0), plant.ranges, unfolded(plant))
    still = Stops(q, np.arange(300.0), np.zeros(300), np.full(300, plant.payload_kg), np.ones_like(q))
    largest: Array = np.abs(moments(placed(plant, still, q))).max(0)
    floored: Array = np.maximum(largest, 0.05 * largest.max())
    return floored


def _bodies(rest: Rest, angles: Array, disturbances: Sequence[Disturbance]) -> Array:
    plant, n = rest.plant, len(rest.stops)
    drive = angles.copy()
    if plant.four_bar is not None:
        drive[:, 2] = close_loop(plant, angles[:, 2] - angles[:, 1]).passive
    G, bodies = np.broadcast_to(plant.base, (n, 4, 4)), np.empty((7, n, 4, 4))
    for link in range(7):
        for d in disturbances:
            D = d.outboard(link, rest)
            G = G if D is None else G @ D
        if link < 6:
            G = G @ turn(plant.axes[link], plant.centres[link], drive[:, link])
        bodies[link] = G
    return bodies


def tool_point(rest: Rest, disturbances: Sequence[Disturbance] = ()) -> Array:
    """Where the reflector is, (n, 3) [m] in the measuring frame."""
    local = rest.plant.reflector + sum(d.reflector(rest.stops) for d in disturbances) + np.zeros((len(rest.stops), 3))
    return move(rest.bodies[6], rest.plant.at_home(6, local))

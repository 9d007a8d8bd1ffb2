"""Weights of a robot: where its bodies are, their torques on the joints, and the rest that follows without effects.

The engine finds every measured equilibrium. These sums say beforehand how large a load is: the rated torque of a joint,
by which hidden effects are sized, and the loads that a rubber coupling remembers. The bodies are followed as motions
from their places at zero readings (products of turns about the axes as they lie then).
"""

from dataclasses import dataclass, replace

import numpy as np

from casadical.blind_check.mujoco_physics.fourbar import close_loop, crank_angle, unfolded
from casadical.blind_check.mujoco_physics.plant import Plant
from casadical.blind_check.mujoco_physics.rigid import Array, move, point, slide, turn
from casadical.blind_check.mujoco_physics.stops import Stops, draw_poses
from casadical.core.basics import ConvergenceError


@dataclass(frozen=True)
class State:
    """n poses.

    plant, stops : the robot and the circumstances
    angles : array (n, joints), true positions of the actuated joints [rad or m]
    bodies : array (joints + 1, n, 4, 4), motions of the links and of what the flange carries, from zero readings to the
        measuring frame
    load : array (n, joints), torque or force on each actuated joint [N m or N]
    """

    plant: Plant
    stops: Stops
    angles: Array
    bodies: Array
    load: Array

    def axis(self, joint: int) -> tuple[Array, Array]:
        """Direction (n, 3) of the axis of ``joint`` (1-based) and a point (n, 3) [m] on it, in the measuring frame."""
        G = self.bodies[joint - 1]
        return point(G, self.plant.axes[joint - 1]), move(G, self.plant.centres[joint - 1])

    def weights(self) -> tuple[Array, Array]:
        """Masses (joints + 1, n) [kg] of the links and the payload, and their centres (joints + 1, n, 3) [m]."""
        plant, payload = self.plant, self.stops.payload_kg * self.plant.payload_factor
        mass = np.vstack([np.repeat(plant.mass[:, None], len(self.stops), 1), payload])
        homes = [plant.at_home(i + 1, plant.com[i]) for i in range(plant.n)]
        homes.append(plant.at_home(plant.n, plant.payload_com))
        return mass, move(self.bodies, np.array(homes)[:, None])

    def wrench_beyond(self, link: int, about: Array) -> tuple[Array, Array]:
        """Force (n, 3) [N] and moment (n, 3) [N m] about the points (n, 3) of all weights beyond ``link``."""
        mass, centre = self.weights()
        force = mass[..., None] * self.plant.gravity
        moment = np.cross(centre - about, force)
        return force[link:].sum(0), moment[link:].sum(0)


def moments(state: State) -> Array:
    """Torques of the weights on the actuated joints, shape (n, joints) [N m or N], positive along the axis."""
    plant, tau = state.plant, np.empty_like(state.angles)
    for joint in range(1, plant.n + 1):
        axis, centre = state.axis(joint)
        force, moment = state.wrench_beyond(joint - 1, centre)
        tau[:, joint - 1] = np.sum(axis * (force if joint in plant.slides else moment), -1)
    if plant.four_bar is not None:
        k = plant.four_bar.driven - 1
        tau[:, k] *= close_loop(plant, crank_angle(plant, state.angles)).lever
        tau[:, k - 1] -= tau[:, k]
    return tau


def link_angles(plant: Plant, angles: Array) -> Array:
    """Coordinates of the links' own axes, (n, joints), at those of the motors: a four-bar turns one."""
    turned = angles.copy()
    if plant.four_bar is not None:
        turned[:, plant.four_bar.driven - 1] = close_loop(plant, crank_angle(plant, angles)).passive
    return turned


def placed(plant: Plant, stops: Stops, angles: Array) -> State:
    """The bodies at the true coordinates (n, joints) of the motors, nothing bent; the loads are not known yet."""
    turned, n = link_angles(plant, angles), len(stops)
    G, bodies = np.broadcast_to(plant.base, (n, 4, 4)), np.empty((plant.n + 1, n, 4, 4))
    for link in range(plant.n):
        G = bodies[link] = G @ moved_by(plant, link, turned[:, link])
    bodies[-1] = G
    return State(plant, stops, angles, bodies, np.zeros_like(angles))


def moved_by(plant: Plant, link: int, by: Array) -> Array:
    """Motions (n, 4, 4) of a link (0-based) by its own joint's coordinate ``by`` (n,) [rad or m]."""
    if link + 1 in plant.slides:
        return slide(by[:, None] * plant.axes[link])
    return turn(plant.axes[link], plant.centres[link], by)


def settle(plant: Plant, stops: Stops) -> State:
    """The poses at rest on the joint springs, to 1e-12. Raises ConvergenceError where joints are too soft for it."""
    state = placed(plant, stops, stops.q)
    for _ in range(200):
        load = moments(state)
        after = placed(plant, stops, stops.q + load / plant.stiffness)
        change = max(np.abs(after.angles - state.angles).max(), np.abs(after.bodies - state.bodies).max())
        state = replace(after, load=load)
        if change < 1e-12:
            return state
    raise ConvergenceError(f"no rest after 200 steps: the last one moved by {change:.1e}; are the joints too soft?")


def reflector(state: State) -> Array:
    """Where the reflector is, (n, 3) [m] in the measuring frame."""
    return move(state.bodies[-1], state.plant.at_home(state.plant.n, state.plant.reflector))


def largest_torque(plant: Plant) -> Array:
    """The largest torque or force of the weights on each joint in 300 fixed poses, (joints,) [N m or N]."""
    q = draw_poses(plant, 300, np.random.default_rng(0), plant.ranges, unfolded(plant))
    still = Stops(q, np.arange(300.0), np.zeros(300), np.full(300, plant.payload_kg), np.ones_like(q))
    largest: Array = np.abs(moments(placed(plant, still, q))).max(0)
    return largest


def rated_torque(plant: Plant) -> Array:
    """By which effects are sized: the largest torque of each joint, but at least 5 % of the greatest, (joints,).

    Where no joint carries weight, as of an arm that moves in a level plane: of all weights at full stretch.
    """
    largest, full = largest_torque(plant), stretched_moments(plant, 0)[1]
    greatest = largest.max() if largest.max() > 1e-3 * full else full
    floored: Array = np.maximum(largest, 0.05 * greatest)
    return floored


def stretched_moments(plant: Plant, link: int) -> tuple[float, float]:
    """Moments [N m] of all weights beyond ``link`` about its end and about its root, if they hung at full stretch."""
    ends = plant.stations
    steps = np.linalg.norm(np.diff(ends, axis=0), axis=-1)
    about_end = about_root = 0.0
    last = plant.n - 1
    for body in range(link, plant.n + 1):
        mass, com = (plant.mass[body], plant.com[body]) if body <= last else (plant.payload_kg, plant.payload_com)
        reach = float(steps[link + 1 : min(body, last) + 1].sum() + np.linalg.norm(com))
        about_end += plant.weight * mass * reach
        about_root += plant.weight * mass * (reach + steps[link])
    return about_end, about_root

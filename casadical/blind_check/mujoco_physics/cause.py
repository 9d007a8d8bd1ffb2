"""Hidden causes: where in the engine each acts, and the loads by which it is sized.

The engine finds every measured equilibrium. The sums here estimate beforehand how large a load is:
the rated torque of a joint, by which hidden effects are sized, and the loads that a rubber coupling
remembers. The bodies are followed as motions from their places at zero readings (products of
rotations about the axes as they lie then).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from inspect import signature
from typing import Any, Literal, cast

import numpy as np

from casadical.blind_check.mujoco_physics.equilibrium import Setting
from casadical.blind_check.mujoco_physics.mechanism import Mechanism
from casadical.blind_check.mujoco_physics.plant import (
    Array,
    Plant,
    close_loop,
    crank_angle,
    move,
    rotated,
    slide,
    turn,
    unfolded,
)
from casadical.blind_check.mujoco_physics.stops import Stops, draw_poses, in_column
from casadical.core.basics import ConvergenceError

# Type of a vector of three numbers.
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class State:
    """The bodies and loads of a robot at n poses.

    plant : robot as built; stops : the n poses with their circumstances
    angles : true coordinates of the actuated joints, shape (n, joints) [rad or m]
    bodies : transforms of the links and of what the flange carries, from their place in the base
        frame at zero readings to that in the measuring frame, shape (joints + 1, n, 4, 4) [m]
    load : torque or force of the weights on each actuated joint, shape (n, joints) [N m or N]
    """

    plant: Plant
    stops: Stops
    angles: Array
    bodies: Array
    load: Array

    def axis(self, joint: int) -> tuple[Array, Array]:
        """Return direction and a point [m] of a joint's axis in the measuring frame, (n, 3) each.

        joint : number of the joint, from 1
        """
        G = self.bodies[joint - 1]
        return rotated(G, self.plant.axes[joint - 1]), move(G, self.plant.centres[joint - 1])

    def weights(self) -> tuple[Array, Array]:
        """Return the masses of links and payload, (joints + 1, n) [kg], and their mass centres.

        The centres at the n poses are in the measuring frame, shape (joints + 1, n, 3) [m].
        """
        plant, payload = self.plant, self.stops.payload_kg * self.plant.payload_factor
        mass = np.vstack([np.repeat(plant.mass[:, None], len(self.stops), 1), payload])
        homes = [plant.at_home(i + 1, plant.com[i]) for i in range(plant.n)]
        homes.append(plant.at_home(plant.n, plant.payload_com))
        return mass, move(self.bodies, np.array(homes)[:, None])

    def wrench_beyond(self, link: int, about: Array) -> tuple[Array, Array]:
        """Return force, (n, 3) [N], and moment, (n, 3) [N m], of all weights beyond a link.

        Both are in the measuring frame.

        link : number of the last link whose weight does not count, 0: that of none
        about : points of reference of the moment in the measuring frame, shape (n, 3) [m]
        """
        mass, centre = self.weights()
        force = mass[..., None] * self.plant.gravity
        moment = np.cross(centre - about, force)
        return force[link:].sum(0), moment[link:].sum(0)


def moments(state: State) -> Array:
    """Return the torques of the weights on the actuated joints, shape (n, joints) [N m or N].

    They are positive along the axes.
    """
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
    """Return the coordinates of the links about their own axes, shape (n, joints) [rad or m].

    They differ from those of the motors for a joint that a four-bar drives.

    angles : coordinates of the motors, shape (n, joints) [rad or m]
    """
    turned = angles.copy()
    if plant.four_bar is not None:
        turned[:, plant.four_bar.driven - 1] = close_loop(plant, crank_angle(plant, angles)).passive
    return turned


def placed(plant: Plant, stops: Stops, angles: Array) -> State:
    """Return the state of a rigid robot at given joint coordinates, with zero loads.

    angles : true coordinates of the actuated joints, shape (n, joints) [rad or m]
    """
    turned, n = link_angles(plant, angles), len(stops)
    G, bodies = np.broadcast_to(plant.base, (n, 4, 4)), np.empty((plant.n + 1, n, 4, 4))
    for link in range(plant.n):
        G = bodies[link] = G @ moved_by(plant, link, turned[:, link])
    bodies[-1] = G
    return State(plant, stops, angles, bodies, np.zeros_like(angles))


def moved_by(plant: Plant, link: int, by: Array) -> Array:
    """Return the transforms that move a link by its own joint, shape (n, 4, 4) [m].

    They are in the base frame, with all other joints at zero.

    link : index of the link, from 0; by : coordinates of the joint, shape (n,) [rad or m]
    """
    if link + 1 in plant.slides:
        return slide(by[:, None] * plant.axes[link])
    return turn(plant.axes[link], plant.centres[link], by)


def settle(plant: Plant, stops: Stops) -> State:
    """Return the state in equilibrium of weights and linear joint springs, to 1e-12 rad or m.

    Raises ConvergenceError where joints are too soft.
    """
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
    """Return the positions of the reflector in the measuring frame, shape (n, 3) [m]."""
    return move(state.bodies[-1], state.plant.at_home(state.plant.n, state.plant.reflector))


def largest_torque(plant: Plant) -> Array:
    """Return each joint's largest torque by weights in 300 fixed poses, shape (joints,) [N m or N].

    It is an absolute value, of the robot with rigid joints.
    """
    q = draw_poses(plant, 300, np.random.default_rng(0), plant.ranges, unfolded(plant))
    still = Stops(q, np.arange(300.0), np.zeros(300), np.full(300, plant.payload_kg), np.ones_like(q))
    return np.asarray(np.abs(moments(placed(plant, still, q))).max(0))


def rated_torque(plant: Plant) -> Array:
    """Return the torque by which effects of each joint are sized, shape (joints,) [N m or N].

    It is the joint's `largest_torque`, but at least 5 % of the largest of all joints. If that is
    below 0.1 % of the moment of all weights of the arm stretched out horizontally, as where it
    moves in a level plane, the moment takes its place.
    """
    largest, full = largest_torque(plant), stretched_moments(plant, 0)[1]
    greatest = largest.max() if largest.max() > 1e-3 * full else full
    return np.asarray(np.maximum(largest, 0.05 * greatest))


def stretched_moments(plant: Plant, link: int) -> tuple[float, float]:
    """Return the moments [N m] of all weights beyond a link about its end and about its root.

    The arm is assumed to be stretched out horizontally.

    link : number of the link, from 1; 0: the pedestal
    """
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


# Place in the engine at which a cause acts; see `Kind.place`.
Place = Literal["built", "motors", "settings", "measured"]


@dataclass(frozen=True)
class Kind:
    """A kind of hidden cause: an effect that geometry and linear joint springs do not contain.

    place : place in the engine at which it acts: "built" for the mechanism, "motors" for the
        coordinates at which they stop, "settings" for deviations from the built mechanism at the
        poses, "measured" for the measured positions
    act : function that applies it, with its sizes as keyword arguments; for motors it returns one
        joint's true angle less its reading at each pose, shape (n,) [rad]
    """

    place: Place
    act: Callable[..., Any]

    @property
    def name(self) -> str:
        """Return the name of the effect."""
        return self.act.__name__

    @property
    def sizes(self) -> set[str]:
        """Return the names of its sizes, the keyword arguments of `act`."""
        return {p.name for p in signature(self.act).parameters.values() if p.kind is p.KEYWORD_ONLY}


def acts(place: Place) -> Callable[[Callable[..., Any]], Kind]:
    """Return a decorator that makes a function a kind of cause that acts at this place."""
    return partial(Kind, place)


@dataclass(frozen=True)
class Cause:
    """A hidden cause: a kind with its sizes by name; it acts only at the place of its kind."""

    kind: Kind
    sizes: Mapping[str, Any]

    def _in(self, place: Place, otherwise: Any, *given: Any) -> Any:
        """Return the result of the cause's function, or `otherwise` if it acts at another place."""
        return self.kind.act(*given, **self.sizes) if self.kind.place == place else otherwise

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        """Return the mechanism with the cause; unchanged if it acts at another place."""
        return cast(Mechanism, self._in("built", mechanism, mechanism, plant))

    def motors(self, plant: Plant, stops: Stops) -> Array | float:
        """Return the motors' deviations from readings, (n, joints) [rad]; 0 at other places."""
        error = self._in("motors", None, plant, stops)
        return 0.0 if error is None else in_column(self.sizes["joint"], error, plant.n)

    def settings(self, plant: Plant, stops: Stops) -> Sequence[Setting]:
        """Return deviations from the built mechanism, values of shape (n, 3) at n poses, or ()."""
        return cast(Sequence[Setting], self._in("settings", (), plant, stops))

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:
        """Return positions that the instrument measures instead of xyz, both (n, 3) [m]."""
        return cast(Array, self._in("measured", xyz, xyz, stops, rng))


def warmth_inside(stops: Stops, lag_minutes: float) -> Array:
    """Return the temperature rise inside a casting at each stop, shape (n,) [K].

    Heat passes through its wall (a third of the lag) into its core (the rest).

    lag_minutes : lag behind the surface [min]
    """
    steps = np.diff(stops.time_s, prepend=0.0) / 60.0
    wall = core = 0.0
    inside, before = np.empty(len(stops)), 0.0
    for k, (minutes, surface) in enumerate(zip(steps, stops.warmth_K, strict=True)):
        pieces = max(1, int(np.ceil(8 * minutes / max(lag_minutes, 1e-9))))
        for piece in range(1, pieces + 1):
            outside = before + (surface - before) * piece / pieces
            wall += (outside - wall) * -np.expm1(-3 * minutes / pieces / lag_minutes)
            core += (wall - core) * -np.expm1(-1.5 * minutes / pieces / lag_minutes)
        inside[k], before = core, surface
    return inside


def length_of(plant: Plant, link: int) -> Array:
    """Return the vector from a link's joint to the next one, in the link's frame, shape (3,) [m].

    For the last link it leads to the reflector.

    link : number of the link, from 1
    """
    frame = plant.home[link - 1]
    return np.asarray(frame[:3, :3].T @ (plant.stations[link + 1] - frame[:3, 3]))


def beam_axes(length: Array) -> tuple[Array, Array, Array]:
    """Return unit vectors, shape (3,) each, along a beam and in two directions across it.

    length : vector along the beam, shape (3,) [m]
    """
    e = length / np.linalg.norm(length)
    across = np.cross(e, np.eye(3)[np.argmin(np.abs(e))])
    across /= np.linalg.norm(across)
    return e, across, np.cross(e, across)


def triple(v: Array) -> tuple[float, float, float]:
    """Return a vector, shape (3,), as a tuple of three floats."""
    x, y, z = (float(c) for c in v)
    return x, y, z

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
from casadical.blind_check.mujoco_physics.fourbar import close_loop, crank_angle, unfolded
from casadical.blind_check.mujoco_physics.mechanism import Mechanism
from casadical.blind_check.mujoco_physics.plant import Array, Plant, move, rotated, slide, turn
from casadical.blind_check.mujoco_physics.stops import Stops, draw_poses, in_column
from casadical.core.basics import ConvergenceError

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class State:
    """The bodies and loads of a robot at n poses.

    plant, stops : the robot and the circumstances
    angles : true positions of the actuated joints, shape (n, joints) [rad or m]
    bodies : motions of the links and of what the flange carries, from zero readings to the
        measuring frame, shape (joints + 1, n, 4, 4)
    load : torque or force on each actuated joint, shape (n, joints) [N m or N]
    """

    plant: Plant
    stops: Stops
    angles: Array
    bodies: Array
    load: Array

    def axis(self, joint: int) -> tuple[Array, Array]:
        """Return direction and a point [m] of a joint's axis in the measuring frame, (n, 3) each.

        joint : 1-based
        """
        G = self.bodies[joint - 1]
        return rotated(G, self.plant.axes[joint - 1]), move(G, self.plant.centres[joint - 1])

    def weights(self) -> tuple[Array, Array]:
        """Return the masses of links and payload, (joints + 1, n) [kg], and their centres.

        The centres are in the measuring frame, shape (joints + 1, n, 3) [m]."""
        plant, payload = self.plant, self.stops.payload_kg * self.plant.payload_factor
        mass = np.vstack([np.repeat(plant.mass[:, None], len(self.stops), 1), payload])
        homes = [plant.at_home(i + 1, plant.com[i]) for i in range(plant.n)]
        homes.append(plant.at_home(plant.n, plant.payload_com))
        return mass, move(self.bodies, np.array(homes)[:, None])

    def wrench_beyond(self, link: int, about: Array) -> tuple[Array, Array]:
        """Return force (n, 3) [N] and moment (n, 3) [N m] of all weights beyond ``link``.

        about : points of reference of the moment, shape (n, 3) [m]
        """
        mass, centre = self.weights()
        force = mass[..., None] * self.plant.gravity
        moment = np.cross(centre - about, force)
        return force[link:].sum(0), moment[link:].sum(0)


def moments(state: State) -> Array:
    """Return the torques of the weights on the actuated joints, shape (n, joints) [N m or N].

    They are positive along the axis.
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
    """Return the coordinates of the links' own axes, (n, joints), at those of the motors.

    They differ for a joint that a four-bar drives.
    """
    turned = angles.copy()
    if plant.four_bar is not None:
        turned[:, plant.four_bar.driven - 1] = close_loop(plant, crank_angle(plant, angles)).passive
    return turned


def placed(plant: Plant, stops: Stops, angles: Array) -> State:
    """Return the bodies at true motor coordinates, (n, joints), nothing bent, loads zero."""
    turned, n = link_angles(plant, angles), len(stops)
    G, bodies = np.broadcast_to(plant.base, (n, 4, 4)), np.empty((plant.n + 1, n, 4, 4))
    for link in range(plant.n):
        G = bodies[link] = G @ moved_by(plant, link, turned[:, link])
    bodies[-1] = G
    return State(plant, stops, angles, bodies, np.zeros_like(angles))


def moved_by(plant: Plant, link: int, by: Array) -> Array:
    """Return the motions of a link by its own joint's coordinate, shape (n, 4, 4).

    link : 0-based; by : shape (n,) [rad or m]
    """
    if link + 1 in plant.slides:
        return slide(by[:, None] * plant.axes[link])
    return turn(plant.axes[link], plant.centres[link], by)


def settle(plant: Plant, stops: Stops) -> State:
    """Return the poses in equilibrium on the joint springs, to 1e-12.

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
    """Return each joint's largest torque by weight in 300 fixed poses, (joints,) [N m or N]."""
    q = draw_poses(plant, 300, np.random.default_rng(0), plant.ranges, unfolded(plant))
    still = Stops(q, np.arange(300.0), np.zeros(300), np.full(300, plant.payload_kg), np.ones_like(q))
    return np.asarray(np.abs(moments(placed(plant, still, q))).max(0))


def rated_torque(plant: Plant) -> Array:
    """Return each joint's largest torque, at least 5 % of the greatest, (joints,) [N m or N].

    Effects are sized by it. If no joint carries weight, as in an arm that moves in a level plane,
    the greatest one is that of all weights at full stretch.
    """
    largest, full = largest_torque(plant), stretched_moments(plant, 0)[1]
    greatest = largest.max() if largest.max() > 1e-3 * full else full
    return np.asarray(np.maximum(largest, 0.05 * greatest))


def stretched_moments(plant: Plant, link: int) -> tuple[float, float]:
    """Return the moments [N m] of all weights beyond ``link`` about its end and about its root.

    The arm is taken to be stretched out horizontally.
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


# Where in the engine a cause acts; see `Kind.place`.
Place = Literal["built", "motors", "settings", "measured"]


@dataclass(frozen=True)
class Kind:
    """A kind of hidden cause: an effect that geometry and linear joint springs do not contain.

    place : where in the engine it acts: how the mechanism is built, where the motors stop, what
        differs from the built mechanism at the poses, or what the instrument makes of the positions
    act : function that applies it, with its sizes as keyword arguments; for motors it returns the
        joint's error, shape (n,) [rad]
    """

    place: Place
    act: Callable[..., Any]

    @property
    def name(self) -> str:
        """The name of the effect."""
        return self.act.__name__

    @property
    def sizes(self) -> set[str]:
        """The names of its sizes."""
        return {p.name for p in signature(self.act).parameters.values() if p.kind is p.KEYWORD_ONLY}


def acts(place: Place) -> Callable[[Callable[..., Any]], Kind]:
    """Return a decorator that makes a function a kind of cause."""
    return partial(Kind, place)


@dataclass(frozen=True)
class Cause:
    """A hidden cause: a kind with its sizes; it acts only in the place of its kind."""

    kind: Kind
    sizes: Mapping[str, Any]

    def _in(self, place: Place, otherwise: Any, *given: Any) -> Any:
        """Return what the cause does in a place, or `otherwise` if its kind acts elsewhere."""
        return self.kind.act(*given, **self.sizes) if self.kind.place == place else otherwise

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        """Return the mechanism with the cause."""
        return cast(Mechanism, self._in("built", mechanism, mechanism, plant))

    def motors(self, plant: Plant, stops: Stops) -> Array | float:
        """Return the motors' deviations from the readings, (n, joints) [rad]."""
        error = self._in("motors", None, plant, stops)
        return 0.0 if error is None else in_column(self.sizes["joint"], error, plant.n)

    def settings(self, plant: Plant, stops: Stops) -> Sequence[Setting]:
        """Return deviations from the built mechanism, with values (n, 3) for the n poses."""
        return cast(Sequence[Setting], self._in("settings", (), plant, stops))

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:
        """Return what the instrument makes of the positions ``xyz`` (n, 3) [m]."""
        return cast(Array, self._in("measured", xyz, xyz, stops, rng))


def warmth_inside(stops: Stops, lag_minutes: float) -> Array:
    """Return the temperature rise inside a casting, shape (n,) [K].

    Heat passes through its wall (a third of the lag) into its core (the rest).
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
    """Return the vector from the joint of ``link`` to the next, in the link's axes, (3,) [m]."""
    frame = plant.home[link - 1]
    return np.asarray(frame[:3, :3].T @ (plant.stations[link + 1] - frame[:3, 3]))


def beam_axes(length: Array) -> tuple[Array, Array, Array]:
    """Return unit vectors (3,) along a beam and in two directions across it."""
    e = length / np.linalg.norm(length)
    across = np.cross(e, np.eye(3)[np.argmin(np.abs(e))])
    across /= np.linalg.norm(across)
    return e, across, np.cross(e, across)


def triple(v: Array) -> tuple[float, float, float]:
    """Return a vector as three floats."""
    x, y, z = (float(c) for c in v)
    return x, y, z

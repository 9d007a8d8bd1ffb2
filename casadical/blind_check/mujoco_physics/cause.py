"""Hidden causes: where in the engine one acts, and how large the loads are by which they are sized.

The engine finds every measured equilibrium. These sums say beforehand how large a load is: the rated torque of a joint,
by which hidden effects are sized, and the loads that a rubber coupling remembers. The bodies are followed as motions
from their places at zero readings (products of turns about the axes as they lie then).
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
from casadical.blind_check.mujoco_physics.plant import Array, Plant, move, point, slide, turn
from casadical.blind_check.mujoco_physics.stops import Stops, draw_poses, only
from casadical.core.basics import ConvergenceError

Vector = tuple[float, float, float]


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
    return np.asarray(np.abs(moments(placed(plant, still, q))).max(0))


def rated_torque(plant: Plant) -> Array:
    """By which effects are sized: the largest torque of each joint, but at least 5 % of the greatest, (joints,).

    Where no joint carries weight, as of an arm that moves in a level plane: of all weights at full stretch.
    """
    largest, full = largest_torque(plant), stretched_moments(plant, 0)[1]
    greatest = largest.max() if largest.max() > 1e-3 * full else full
    return np.asarray(np.maximum(largest, 0.05 * greatest))


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


Place = Literal["built", "motors", "settings", "measured"]


@dataclass(frozen=True)
class Kind:
    """A kind of hidden cause: one thing that geometry and linear joint springs do not contain.

    place : where in the engine it acts: how the mechanism is built, where the motors stop, what is not as built at the
        poses, or what the instrument makes of the positions
    act : what it does there, with its sizes as keyword arguments; of motors the joint's error, shape (n,) [rad]
    """

    place: Place
    act: Callable[..., Any]

    @property
    def name(self) -> str:
        return self.act.__name__

    @property
    def sizes(self) -> set[str]:
        return {p.name for p in signature(self.act).parameters.values() if p.kind is p.KEYWORD_ONLY}


def acts(place: Place) -> Callable[[Callable[..., Any]], Kind]:
    """The kind of cause that a function is."""
    return partial(Kind, place)


@dataclass(frozen=True)
class Cause:
    """A hidden cause: a kind with its sizes; in other places than that of its kind it does nothing."""

    kind: Kind
    sizes: Mapping[str, Any]

    def _in(self, place: Place, otherwise: Any, *given: Any) -> Any:
        return self.kind.act(*given, **self.sizes) if self.kind.place == place else otherwise

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        """The mechanism with it."""
        return cast(Mechanism, self._in("built", mechanism, mechanism, plant))

    def motors(self, plant: Plant, stops: Stops) -> Array | float:
        """Where the motors stop beyond the readings, (n, joints) [rad]."""
        error = self._in("motors", None, plant, stops)
        return 0.0 if error is None else only(self.sizes["joint"], error, plant.n)

    def settings(self, plant: Plant, stops: Stops) -> Sequence[Setting]:
        """What is not as built, with values (n, 3) for the n poses."""
        return cast(Sequence[Setting], self._in("settings", (), plant, stops))

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:
        """What the instrument makes of the positions ``xyz`` (n, 3) [m]."""
        return cast(Array, self._in("measured", xyz, xyz, stops, rng))


def warmth_inside(stops: Stops, lag_minutes: float) -> Array:
    """Warmth (n,) [K] inside a casting: heat passes through its wall (a third of the lag) into its core (the rest)."""
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
    """From the joint of ``link`` to the next, (3,) [m] in its own axes."""
    frame = plant.home[link - 1]
    return np.asarray(frame[:3, :3].T @ (plant.stations[link + 1] - frame[:3, 3]))


def beam_axes(length: Array) -> tuple[Array, Array, Array]:
    """Unit vectors (3,) along a beam and across it."""
    e = length / np.linalg.norm(length)
    across = np.cross(e, np.eye(3)[np.argmin(np.abs(e))])
    across /= np.linalg.norm(across)
    return e, across, np.cross(e, across)


def triple(v: Array) -> tuple[float, float, float]:
    x, y, z = (float(c) for c in v)
    return x, y, z

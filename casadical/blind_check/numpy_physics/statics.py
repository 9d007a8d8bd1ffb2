"""Static equilibrium by fixed-point iteration of torques and joint deflections.

The bodies are followed as motions from their places at zero readings (products of turns about the axes as they lie
then), not as products of link transforms.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casadical.blind_check.numpy_physics.disturbance import Disturbance
from casadical.blind_check.numpy_physics.state import GRAVITY, State, moments
from casadical.blind_check.synthetic.fourbar import close_loop, unfolded
from casadical.blind_check.synthetic.plant import Plant
from casadical.blind_check.synthetic.rigid import Array, move, turn
from casadical.blind_check.synthetic.stops import Stops, draw_poses
from casadical.core.errors import ConvergenceError


def placed(plant: Plant, stops: Stops, angles: Array) -> State:
    """The bodies at the true angles (n, 6) [rad] of the actuated joints, nothing bent; the loads are not known yet."""
    blank = State(plant, stops, angles, np.zeros((7, len(stops), 4, 4)), np.zeros_like(angles), np.ones(6))
    return replace(blank, bodies=_bodies(blank, angles, ()))


def settle(plant: Plant, stops: Stops, disturbances: Sequence[Disturbance] = (), jitter: Array | float = 0.0) -> State:
    """The poses at static equilibrium, to 1e-12 in angles [rad] and motions.

    ``jitter`` (n, 6) [rad] is added to the readings. Raises ConvergenceError where joints are too soft to come to rest.
    """
    for d in disturbances:
        plant = d.altered(plant)
    unloaded = stops.q + jitter + sum(d.misread(stops) for d in disturbances)
    state = replace(placed(plant, stops, unloaded), rated=rated_torque(plant))
    for _ in range(200):
        load = moments(state) + sum(d.torque(state) for d in disturbances)
        state = replace(state, load=load)
        angles = unloaded + load / plant.stiffness + sum(d.twist(state) for d in disturbances)
        bodies = _bodies(state, angles, disturbances)
        change = max(np.abs(angles - state.angles).max(), np.abs(bodies - state.bodies).max())
        state = replace(state, angles=angles, bodies=bodies)
        if change < 1e-12:
            return state
    raise ConvergenceError(f"no rest after 200 steps: the last one moved by {change:.1e}; are the joints too soft?")


def rated_torque(plant: Plant) -> Array:
    """The largest torque of the weights on each joint in 300 fixed poses, (6,) [N m]; at least 5 % of the greatest."""
    q = draw_poses(plant, 300, np.random.default_rng(0), plant.ranges, unfolded(plant))
    still = Stops(q, np.arange(300.0), np.zeros(300), np.full(300, plant.payload_kg), np.ones_like(q))
    largest: Array = np.abs(moments(placed(plant, still, q))).max(0)
    floored: Array = np.maximum(largest, 0.05 * largest.max())
    return floored


def stretched_moments(plant: Plant, link: int) -> tuple[float, float]:
    """Moments [N m] of all weights beyond ``link`` about its end and about its root, if they hung at full stretch."""
    ends = plant.stations
    steps = np.linalg.norm(np.diff(ends, axis=0), axis=-1)
    about_end = about_root = 0.0
    for body in range(link, 7):
        mass, com = (plant.mass[body], plant.com[body]) if body < 6 else (plant.payload_kg, plant.payload_com)
        reach = float(steps[link + 1 : min(body, 5) + 1].sum() + np.linalg.norm(com))
        about_end += GRAVITY * mass * reach
        about_root += GRAVITY * mass * (reach + steps[link])
    return about_end, about_root


def _bodies(state: State, angles: Array, disturbances: Sequence[Disturbance]) -> Array:
    plant, n = state.plant, len(state.stops)
    drive = angles.copy()
    if plant.four_bar is not None:
        drive[:, 2] = close_loop(plant, angles[:, 2] - angles[:, 1]).passive
    G, bodies = np.broadcast_to(plant.base, (n, 4, 4)), np.empty((7, n, 4, 4))
    for link in range(7):
        for d in disturbances:
            D = d.outboard(link, state)
            G = G if D is None else G @ D
        if link < 6:
            G = G @ turn(plant.axes[link], plant.centres[link], drive[:, link])
        bodies[link] = G
    return bodies


def tool_point(state: State, disturbances: Sequence[Disturbance] = ()) -> Array:
    """Where the reflector is, (n, 3) [m] in the measuring frame."""
    local = (
        state.plant.reflector + sum(d.reflector(state.stops) for d in disturbances) + np.zeros((len(state.stops), 3))
    )
    return move(state.bodies[6], state.plant.at_home(6, local))


def positions(plant: Plant, disturbances: Sequence[Disturbance], stops: Stops, jitter: Array | float = 0.0) -> Array:
    """Where the reflector comes to rest, (n, 3) [m]; ``jitter`` (n, 6) [rad] adds to the readings."""
    return tool_point(settle(plant, stops, disturbances, jitter), disturbances)

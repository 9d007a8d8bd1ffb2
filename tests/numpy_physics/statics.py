"""Static equilibrium with disturbances by fixed-point iteration of torques and joint deflections, in numpy alone."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casadical.blind_check.mujoco_physics.cause import link_angles, moments, moved_by, rated_torque
from casadical.blind_check.mujoco_physics.plant import Array, Plant, move
from casadical.blind_check.mujoco_physics.stops import Stops
from casadical.core.basics import ConvergenceError
from numpy_physics.disturbance import Disturbance
from numpy_physics.state import State


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


def _bodies(state: State, angles: Array, disturbances: Sequence[Disturbance]) -> Array:
    plant, n = state.plant, len(state.stops)
    drive = link_angles(plant, angles)
    G, bodies = np.broadcast_to(plant.base, (n, 4, 4)), np.empty((7, n, 4, 4))
    for link in range(7):
        for d in disturbances:
            D = d.outboard(link, state)
            G = G if D is None else G @ D
        if link < 6:
            G = G @ moved_by(plant, link, drive[:, link])
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

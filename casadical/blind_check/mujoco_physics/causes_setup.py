"""Hidden causes in the measurement: a creeping frame, a moved reflector, outliers, offsets."""

import numpy as np

from casadical.blind_check.mujoco_physics.cause import Vector, acts, reflector, settle
from casadical.blind_check.mujoco_physics.equilibrium import Setting
from casadical.blind_check.mujoco_physics.plant import Array, Plant
from casadical.blind_check.mujoco_physics.stops import Stops


@acts("settings")
def frame_drift(
    plant: Plant, stops: Stops, *, shift_m: Vector, turn_rad: Vector, settling_minutes: float
) -> list[Setting]:
    """Return the settings, at each stop, of a tracker whose stand creeps and turns, fast at first.

    shift_m : displacement in one hour in the measuring frame, shape (3,) [m]
    turn_rad : rotation vector in one hour in the measuring frame, shape (3,) [rad]
    settling_minutes : time constant of both [min]
    """
    crept = np.expm1(-stops.time_s / 60 / settling_minutes) / np.expm1(-60 / settling_minutes)
    shift, turn = np.outer(crept, shift_m), np.outer(crept, turn_rad)
    return [Setting("shift", "tracker", shift), Setting("turn", "tracker", turn)]


@acts("settings")
def target_shift(plant: Plant, stops: Stops, *, shift_m: Vector, at_s: float) -> list[Setting]:
    """Return the settings, at each stop, of a reflector that moves in its nest at one time.

    shift_m : displacement in the last link's frame, shape (3,) [m]
    at_s : time of the displacement [s]
    """
    return [Setting("mark", "reflector", np.outer(stops.time_s >= at_s, shift_m))]


@acts("measured")
def outliers(xyz: Array, stops: Stops, rng: np.random.Generator, *, share: float, size: float) -> Array:
    """Return measured positions some of which are displaced at random, shape (n, 3) [m].

    The distances are Pareto distributed from half of `size` on, in random directions.

    xyz : positions, shape (n, 3) [m]
    share : probability that a point is displaced; size : median distance, about [m]
    """
    direction = rng.standard_normal(xyz.shape)
    length = size * (0.5 + rng.pareto(2.0, len(xyz)))
    length /= np.linalg.norm(direction, axis=-1)
    hit = rng.random(len(xyz)) < share
    return xyz + np.where(hit, length, 0.0)[:, None] * direction


@acts("settings")
def range_offset(plant: Plant, stops: Stops, *, size: float, stand_m: Vector) -> list[Setting]:
    """Return the settings of a tracker that measures every distance too long; not listed.

    size : range offset [m]; below zero: distances are too short
    stand_m : position of the tracker in the measuring frame, shape (3,) [m]
    """
    sight = reflector(settle(plant, stops)) - np.array(stand_m)
    away = sight / np.linalg.norm(sight, axis=1, keepdims=True)
    return [Setting("shift", "tracker", -size * away)]

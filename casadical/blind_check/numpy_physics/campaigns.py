"""A synthetic measurement campaign: a table of poses as an instrument would have recorded it."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
import pandas as pd

from casadical.blind_check.numpy_physics.disturbance import Disturbance
from casadical.blind_check.numpy_physics.fourbar import unfolded
from casadical.blind_check.numpy_physics.machine import settle, tool_point
from casadical.blind_check.numpy_physics.plant import Plant
from casadical.blind_check.numpy_physics.rigid import Array
from casadical.blind_check.numpy_physics.stops import Stops, Warmup, draw_poses, draw_stops
from casadical.core.errors import InputError


def campaign(
    plant: Plant,
    n: int,
    seed: int,
    *,
    noise_mm: float = 0.02,
    repeatability_urad: float = 8.0,
    disturbances: Sequence[Disturbance] = (),
    payload_states: Sequence[float] | None = None,
    warmup: Warmup | None = None,
    approach: Literal["chance", "motion"] = "chance",
    q_deg: Array | None = None,
    ranges_deg: Array | None = None,
    crank_distance_m: tuple[float, float] | None = None,
    truth: bool = False,
) -> pd.DataFrame:
    """Measure ``n`` poses of the true robot ``plant``; the same seed gives the same table.

    Poses, circumstances and noise do not depend on the disturbances: the same campaign without them is their absence.

    Parameters
    ----------
    plant : the robot as it is (see ``perturb``)
    n, seed : number of poses, and what everything drawn follows from
    noise_mm : standard deviation of each measured coordinate
    repeatability_urad : standard deviation of each joint about its reading
    disturbances : what else the robot or the instrument has
    payload_states : declared payloads [kg], taken in turn in blocks; by default none and the plant's
    warmup : the arm's temperature; by default 7 K in some 35 minutes
    approach : each joint's last motion by chance, or (``"motion"``) as it follows from the order of the poses
    q_deg : readings (n, 6) to take instead of drawing them from ``ranges_deg`` (6, 2), by default the plant's
    crank_distance_m : limits of the loop's crank distance; by default a quarter of the rocker away from the folds
    truth : add x_true_mm, y_true_mm, z_true_mm: no noise, joints exactly repeated, and the instrument right

    Returns
    -------
    DataFrame with pose, time_s, temperature_degC, payload_kg, approach1..6, q1_deg..q6_deg, x_mm, y_mm, z_mm

    Raises InputError when an argument is not usable or no pose keeps the loop's limits.
    """
    _check(n, noise_mm, repeatability_urad, ranges_deg, payload_states)
    poses, *times, thermometer, joints, noise, instrument = np.random.SeedSequence(seed).spawn(7)
    warmup = warmup or Warmup()
    ranges = plant.ranges if ranges_deg is None else np.deg2rad(np.asarray(ranges_deg, float))
    if q_deg is None:
        limits = crank_distance_m or unfolded(plant)
        q_deg = np.rad2deg(draw_poses(plant, n, np.random.default_rng(poses), ranges, limits))
    if np.shape(q_deg) != (n, 6):
        raise InputError(f"q_deg has shape {np.shape(q_deg)}; for n = {n} it must be ({n}, 6)")
    q_deg = np.round(q_deg, 6)
    states = (0.0, plant.payload_kg) if payload_states is None else payload_states
    stops = draw_stops(np.deg2rad(q_deg), times, states, warmup, approach)

    jitter = np.random.default_rng(joints).normal(0, repeatability_urad * 1e-6, (n, 6))
    xyz = tool_point(settle(plant, stops, disturbances, jitter), disturbances)
    rng = np.random.default_rng(instrument)
    for d in disturbances:
        xyz = d.measured(xyz, stops, rng)
    xyz_mm = 1e3 * xyz + np.random.default_rng(noise).normal(0, noise_mm, (n, 3))
    shown = warmup.start_degC + stops.warmth_K + np.random.default_rng(thermometer).normal(0, warmup.sensor_K, n)
    table = _table(stops, q_deg, xyz_mm, shown)
    if truth:
        true_mm = np.round(1e3 * tool_point(settle(plant, stops, disturbances), disturbances), 4)
        table[["x_true_mm", "y_true_mm", "z_true_mm"]] = true_mm
    return table


def _check(
    n: int,
    noise_mm: float,
    repeatability_urad: float,
    ranges_deg: Array | None,
    payload_states: Sequence[float] | None,
) -> None:
    if n < 1:
        raise InputError(f"n is {n}; a campaign needs at least one pose")
    if min(noise_mm, repeatability_urad) < 0:
        raise InputError(f"noise_mm is {noise_mm} and repeatability_urad {repeatability_urad}; neither may be negative")
    if ranges_deg is not None and np.shape(ranges_deg) != (6, 2):
        raise InputError(f"ranges_deg has shape {np.shape(ranges_deg)}; it must be (6, 2): lowest and highest readings")
    if payload_states is not None and len(payload_states) == 0:
        raise InputError("payload_states is empty; give at least one declared payload [kg], 0 for none")


def _table(stops: Stops, q_deg: Array, xyz_mm: Array, temperature: Array) -> pd.DataFrame:
    """The columns of a campaign, rounded like those of a real one."""
    joints = range(1, 7)
    table = pd.DataFrame({"pose": np.arange(1, len(stops) + 1), "time_s": np.round(stops.time_s, 1)})
    table["temperature_degC"] = np.round(temperature, 2)
    table["payload_kg"] = stops.payload_kg
    table[[f"approach{j}" for j in joints]] = stops.approach.astype(int)
    table[[f"q{j}_deg" for j in joints]] = q_deg
    table[["x_mm", "y_mm", "z_mm"]] = np.round(xyz_mm, 4)
    return table

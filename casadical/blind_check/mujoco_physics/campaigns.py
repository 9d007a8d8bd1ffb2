"""Simulated campaigns of a robot with hidden effects in MuJoCo, as tables.

A physics gives the positions of the reflector; random draws, rounding and columns are independent
of it.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np
import pandas as pd

from casadical.blind_check.mujoco_physics.cause import Cause
from casadical.blind_check.mujoco_physics.equilibrium import Engine, Setting, Stop
from casadical.blind_check.mujoco_physics.hidden import Hidden, causes
from casadical.blind_check.mujoco_physics.mechanism import mechanism, start
from casadical.blind_check.mujoco_physics.plant import Array, Plant, unfolded
from casadical.blind_check.mujoco_physics.stops import Stops, Warmup, draw_poses, draw_stops
from casadical.core.basics import InputError

# Columns of measured positions in the measuring frame [mm].
MEASURED_COLUMNS = ["x_mm", "y_mm", "z_mm"]


def approaches(joints: int) -> list[str]:
    """Return the names of the columns of approach directions: approach1 and so on."""
    return [f"approach{j}" for j in range(1, joints + 1)]


def readings_of(plant: Plant) -> list[str]:
    """Return the names of the columns of readings: q1_deg, or q1_mm of a prismatic joint."""
    return [f"q{j}_mm" if j in plant.slides else f"q{j}_deg" for j in range(1, plant.n + 1)]


def _per_joint(plant: Plant, turns: Array, slides: Array) -> Array:
    """Return values of revolute joints from `turns` and of prismatic ones from `slides`.

    All have the shape (..., joints).
    """
    return np.where([j in plant.slides for j in range(1, plant.n + 1)], slides, turns)


def in_si(plant: Plant, shown: Array) -> Array:
    """Return readings in [rad or m]; shown : readings in [deg or mm]; shape (..., joints) both."""
    return _per_joint(plant, np.deg2rad(shown), 1e-3 * shown)


def simulate(
    plant: Plant,
    positions: Callable[[Stops, Array | float], Array],
    instruments: Sequence[Cause],
    n: int,
    seed: int,
    *,
    noise_mm: float = 0.02,
    repeatability_urad: float = 5.0,
    payload_states: Sequence[float] | None = None,
    warmup: Warmup | None = None,
    approach: Literal["chance", "motion"] = "chance",
    q_deg: Array | None = None,
    given: pd.DataFrame | None = None,
    ranges_deg: Array | None = None,
    crank_distance_m: tuple[float, float] | None = None,
    truth: bool = False,
) -> pd.DataFrame:
    """Return the table of n simulated measured poses, rounded like a real one.

    Its columns are pose, time_s, temperature_degC, payload_kg, approach1 .., readings and measured
    positions in the measuring frame. The same seed gives the same table. Poses, circumstances and
    noise do not depend on the effects, so that the same campaign can be simulated without them.

    plant : robot as built
    positions : function that returns the reflector's positions, shape (n, 3) [m], at n stops with
        errors of the joints, shape (n, joints) [rad or m]
    instruments : causes, of which those of the instrument act on the measured positions
    n : number of poses
    seed : seed of all random draws
    noise_mm : standard deviation of each measured coordinate [mm]
    repeatability_urad : standard deviation of each joint about its reading [urad, or um of a
        prismatic joint]
    payload_states : declared masses of the payload [kg], in alternating blocks; None: 0 and the
        plant's
    warmup : warm-up of the arm; None: 7 K with a time constant of 35 minutes
    approach : direction of each joint's last motion: "chance" for random ones, or "motion" for
        those by the order of the poses
    q_deg : readings that are taken instead of random ones, shape (n, joints) [deg or mm]
    given : columns time_s, temperature_degC, payload_kg, approach1 .. that are taken instead of
        random ones
    ranges_deg : ranges of random readings, shape (joints, 2) [deg or mm]; None: the plant's
    crank_distance_m : limits of the four-bar's crank distance [m]; None: a quarter of the rocker
        away from the singular poses
    truth : whether the columns x_true_mm, y_true_mm, z_true_mm are added: without noise, joint
        repeatability and outliers, but with effects that move the tracker
    Raises InputError where an argument is not usable, or no pose keeps the loop's limits.
    """
    warmup, states = warmup or Warmup(), payload_states
    if n < 1:
        raise InputError(f"n is {n}; a campaign needs at least 1 pose")
    if min(noise_mm, repeatability_urad) < 0:
        raise InputError(f"noise_mm is {noise_mm} and repeatability_urad {repeatability_urad}; neither may be negative")
    if ranges_deg is not None and np.shape(ranges_deg) != (plant.n, 2):
        raise InputError(
            f"ranges_deg has shape {np.shape(ranges_deg)}; it must be ({plant.n}, 2): lowest and highest readings"
        )
    if states is not None and len(states) == 0:
        raise InputError("payload_states is empty; give at least one declared payload [kg], 0 for none")
    seeds = np.random.SeedSequence(seed).spawn(7)
    poses, _, _, thermometer, joints, noise, instrument = map(np.random.default_rng, seeds)
    if q_deg is None:
        ranges = plant.ranges if ranges_deg is None else in_si(plant, np.asarray(ranges_deg, float).T).T
        limits = crank_distance_m or unfolded(plant)
        q = draw_poses(plant, n, poses, ranges, limits)
        q_deg = _per_joint(plant, np.rad2deg(q), 1e3 * q)
    if np.shape(q_deg) != (n, plant.n):
        raise InputError(f"q_deg has shape {np.shape(q_deg)}; for n = {n} it must be ({n}, {plant.n})")
    q_deg = np.round(q_deg, 6)
    states = (0.0, plant.payload_kg) if states is None else states
    drawn = draw_stops(in_si(plant, q_deg), seeds[1:3], states, warmup, approach)
    given = pd.DataFrame() if given is None else given
    stops = with_given(drawn, given, warmup)
    xyz = positions(stops, joints.normal(0, repeatability_urad * 1e-6, stops.q.shape))
    for effect in instruments:
        xyz = effect.measured(xyz, stops, instrument)
    shown = np.round(warmup.start_degC + stops.warmth_K + thermometer.normal(0, warmup.sensor_K, n), 2)
    table = pd.DataFrame({"pose": np.arange(1, n + 1), "time_s": np.round(stops.time_s, 1)})
    table["temperature_degC"] = given["temperature_degC"].to_numpy(float) if "temperature_degC" in given else shown
    table["payload_kg"] = stops.payload_kg
    table[approaches(plant.n)] = stops.approach.astype(int)
    table[readings_of(plant)] = q_deg
    table[MEASURED_COLUMNS] = np.round(1e3 * xyz + noise.normal(0, noise_mm, (n, 3)), 4)
    if truth:
        table[[f"{c}_true_mm" for c in "xyz"]] = np.round(1e3 * positions(stops, 0.0), 6)
    return table


def with_given(stops: Stops, given: pd.DataFrame, warmup: Warmup) -> Stops:
    """Return the stops with those circumstances that a table has in place of their own.

    A temperature that the table lacks follows from the times by the warm-up; an approach below zero
    becomes -1, else 1.

    given : table with some of the columns time_s, temperature_degC, payload_kg, approach1, ..
    """

    def column(name: str, drawn: Array) -> Array:
        """Return a column of the table, or what was drawn where it has none, shape (n,)."""
        return given[name].to_numpy(float) if name in given else drawn

    time = column("time_s", stops.time_s)
    warmth = warmup.course(time)
    if "temperature_degC" in given:
        warmth = given["temperature_degC"].to_numpy(float) - warmup.start_degC
    sides = [column(name, stops.approach[:, k]) for k, name in enumerate(approaches(stops.q.shape[1]))]
    came = np.where(np.column_stack(sides) < 0, -1.0, 1.0)
    return Stops(stops.q, time, warmth, column("payload_kg", stops.payload_kg), came)


def campaign(plant: Plant, hidden: Sequence[Hidden | Cause], n: int, seed: int, **options: Any) -> pd.DataFrame:
    """Return the table of a simulated campaign of n poses, a row each; see `simulate`.

    plant : robot as built; hidden : hidden effects that act on it
    seed : seed of all random draws; options : as of `simulate`
    Raises InputError for unusable arguments, and without MuJoCo.
    """
    return simulate(plant, partial(positions, plant, hidden), causes(hidden, plant.n), n, seed, **options)


def measure(
    plant: Plant, hidden: Sequence[Hidden | Cause], readings: pd.DataFrame, *, seed: int, **options: Any
) -> pd.DataFrame:
    """Return the table of a simulated campaign at given poses, with positions of the reflector.

    Quantities that `readings` lacks are constant (20 degC, the declared payload, approach 1), the
    time grows by 30 s.

    plant : robot as built; hidden : hidden effects that act on it
    readings : table with the columns q1_deg, .. (q1_mm of a prismatic joint) and, as far as they
        are given, time_s, temperature_degC, payload_kg, approach1, ..
    seed : seed of all random draws; options : as of `simulate`
    Raises InputError where a column of readings is missing, or all rows are.
    """
    n, columns = len(readings), readings_of(plant)
    missing = [name for name in columns if name not in readings]
    if missing or n == 0:
        raise InputError(
            f"readings: {n} rows, columns missing: {', '.join(missing) or 'none'}; give {columns[0]} to {columns[-1]}"
        )
    usual: dict[str, Any] = dict.fromkeys(approaches(plant.n), 1) | {"time_s": 30.0 * np.arange(1, n + 1)}
    usual |= {"temperature_degC": Warmup().start_degC, "payload_kg": plant.payload_kg}
    options["q_deg"] = readings[columns].to_numpy(float)
    options["given"] = readings.assign(**{name: value for name, value in usual.items() if name not in readings})
    return campaign(plant, hidden, n, seed, **options)


def positions(plant: Plant, hidden: Sequence[Hidden | Cause], stops: Stops, jitter: Array | float = 0.0) -> Array:
    """Return the reflector's positions as the tracker sees them without noise, shape (n, 3) [m].

    They are by equilibria in MuJoCo, in the tracker's frame: the measuring one unless effects move
    the tracker.

    plant : robot as built; hidden : hidden effects; stops : n poses with their circumstances
    jitter : errors that are added to the readings, shape (n, joints) [rad or m]
    Raises ConvergenceError where the engine finds no equilibrium.
    """
    acting = causes(hidden, plant.n)
    built = mechanism(plant)
    for cause in acting:
        built = cause.built(built, plant)
    engine = Engine(built, tuple(plant.gravity))
    motors = stops.q + jitter + sum(c.motors(plant, stops) for c in acting)
    changes = [s for c in acting for s in c.settings(plant, stops)]
    seen = np.empty((len(stops), 3))
    for k in range(len(stops)):
        now = [Setting(s.kind, s.name, s.value[k]) for s in changes]
        stop = Stop(motors[k], stops.approach[k], start(plant, motors[k]), float(stops.payload_kg[k]), now)
        seen[k] = engine.rest(stop)
    return seen

"""Measurement campaigns of a robot in the engine: a table of poses as an instrument would have recorded it."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import pandas as pd

from casadical.blind_check.mujoco_physics.equilibrium import Engine, Setting, Stop
from casadical.blind_check.mujoco_physics.hidden import Hidden, causes
from casadical.blind_check.mujoco_physics.mechanism import Array
from casadical.blind_check.mujoco_physics.robot import mechanism, start
from casadical.blind_check.numpy_physics.fourbar import unfolded
from casadical.blind_check.numpy_physics.plant import Plant
from casadical.blind_check.numpy_physics.stops import Stops, Warmup, draw_poses, draw_stops
from casadical.core.errors import InputError

JOINTS = range(1, 7)
NEEDED = ("time_s", "temperature_degC", "payload_kg", *(f"approach{j}" for j in JOINTS), *(f"q{j}_deg" for j in JOINTS))


def campaign(
    machine: Plant,
    hidden: Sequence[Hidden],
    n: int,
    seed: int,
    *,
    noise_mm: float = 0.02,
    repeatability_urad: float = 5.0,
    payload_states: Sequence[float] | None = None,
    warmup: Warmup | None = None,
    approach: Literal["chance", "motion"] = "chance",
    q_deg: Array | None = None,
    truth: bool = False,
) -> pd.DataFrame:
    """Measure ``n`` poses of the robot ``machine``; the same seed gives the same table.

    Poses, circumstances and noise do not depend on what is hidden: ``hidden=()`` gives the same campaign without it.

    Parameters
    ----------
    machine : the robot as built (``perturb`` of a nominal one)
    hidden : what else the robot or the instrument has
    n, seed : number of poses, and what everything drawn follows from
    noise_mm : standard deviation of each measured coordinate
    repeatability_urad : standard deviation of each joint about its reading
    payload_states : declared payloads [kg], taken in turn in blocks; by default none and the robot's
    warmup : the arm's temperature; by default 7 K in some 35 minutes
    approach : each joint's last motion by chance, or (``"motion"``) as it follows from the order of the poses
    q_deg : readings (n, 6) to take instead of drawing them from the joint ranges
    truth : add x_true_mm, y_true_mm, z_true_mm: no noise, joints exactly repeated

    Returns
    -------
    DataFrame with pose, time_s, temperature_degC, payload_kg, approach1..6, q1_deg..q6_deg, x_mm, y_mm, z_mm

    Raises InputError when an argument is not usable or MuJoCo is missing.
    """
    if n < 1 or min(noise_mm, repeatability_urad) < 0:
        raise InputError(
            f"n is {n}, noise_mm {noise_mm}, repeatability_urad {repeatability_urad}; "
            "n must be at least 1, the others not negative"
        )
    poses, *times, thermometer, joints, noise, instrument = np.random.SeedSequence(seed).spawn(7)
    warmup = warmup or Warmup()
    if q_deg is None:
        q_deg = np.rad2deg(draw_poses(machine, n, np.random.default_rng(poses), machine.ranges, unfolded(machine)))
    if np.shape(q_deg) != (n, 6):
        raise InputError(f"q_deg has shape {np.shape(q_deg)}; for n = {n} it must be ({n}, 6)")
    q_deg = np.round(q_deg, 6)
    states = (0.0, machine.payload_kg) if payload_states is None else payload_states
    stops = draw_stops(np.deg2rad(q_deg), times, states, warmup, approach)
    rngs = [np.random.default_rng(s) for s in (joints, noise, instrument)]
    table = _record(machine, hidden, stops, noise_mm, repeatability_urad, rngs, truth)
    shown = warmup.start_degC + stops.warmth_K + np.random.default_rng(thermometer).normal(0, warmup.sensor_K, n)
    return _table(stops, q_deg, np.round(shown, 2), table)


def measure(
    machine: Plant,
    hidden: Sequence[Hidden],
    readings: pd.DataFrame,
    *,
    noise_mm: float = 0.02,
    repeatability_urad: float = 5.0,
    seed: int,
    truth: bool = False,
) -> pd.DataFrame:
    """Measure given poses: the table ``readings`` with the positions of the reflector.

    Parameters
    ----------
    machine, hidden, noise_mm, repeatability_urad, seed, truth : as in ``campaign``
    readings : one row a pose, with q1_deg..q6_deg; where they are missing, time_s is 30 s a pose, temperature_degC 20
        throughout, payload_kg the robot's, approach1..6 1

    Raises InputError when a reading is missing.
    """
    n = len(readings)
    usual: dict[str, Any] = {"time_s": 30.0 * np.arange(1, n + 1), "temperature_degC": 20.0}
    usual |= {"payload_kg": machine.payload_kg, **{f"approach{j}": 1 for j in JOINTS}}
    full = readings.assign(**{name: value for name, value in usual.items() if name not in readings})
    missing = [name for name in NEEDED if name not in full]
    if missing or n == 0:
        raise InputError(f"readings: {n} rows, columns missing: {', '.join(missing) or 'none'}; give q1_deg to q6_deg")
    q_deg = full[[f"q{j}_deg" for j in JOINTS]].to_numpy(float)
    stops = Stops(
        np.deg2rad(q_deg),
        full["time_s"].to_numpy(float),
        full["temperature_degC"].to_numpy(float) - Warmup().start_degC,
        full["payload_kg"].to_numpy(float),
        np.where(full[[f"approach{j}" for j in JOINTS]].to_numpy(float) < 0, -1.0, 1.0),
    )
    rngs = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3)]
    table = _record(machine, hidden, stops, noise_mm, repeatability_urad, rngs, truth)
    return _table(stops, q_deg, full["temperature_degC"].to_numpy(float), table)


def positions(machine: Plant, hidden: Sequence[Hidden], stops: Stops, jitter: Array | float = 0.0) -> Array:
    """Where the tracker sees the reflector without noise, (n, 3) [m]; ``jitter`` (n, 6) [rad] adds to the readings.

    Raises ConvergenceError where the engine finds no rest.
    """
    acting = causes(hidden)
    built, factor = mechanism(machine), 1.0
    for cause in acting:
        built = cause.built(built, machine)
        factor *= cause.payload_factor
    engine = Engine(built, travels=any(c.travels for c in acting), factor=factor)
    motors = stops.q + jitter + sum(c.motors(machine, stops) for c in acting)
    changes = [s for c in acting for s in c.settings(machine, stops)]
    seen = np.empty((len(stops), 3))
    for k in range(len(stops)):
        now = [Setting(s.kind, s.name, s.value[k]) for s in changes]
        seen[k] = engine.rest(
            Stop(motors[k], stops.approach[k], start(machine, motors[k]), float(stops.payload_kg[k]), now)
        )
    return seen


def _record(
    machine: Plant,
    hidden: Sequence[Hidden],
    stops: Stops,
    noise_mm: float,
    repeatability_urad: float,
    rngs: Sequence[np.random.Generator],
    truth: bool,
) -> pd.DataFrame:
    joints, noise, instrument = rngs
    n = len(stops)
    xyz = positions(machine, hidden, stops, joints.normal(0, repeatability_urad * 1e-6, (n, 6)))
    for cause in causes(hidden):
        xyz = cause.measured(xyz, stops, instrument)
    columns = dict(zip("xyz", (1e3 * xyz + noise.normal(0, noise_mm, (n, 3))).T, strict=True))
    table = pd.DataFrame({f"{c}_mm": np.round(v, 4) for c, v in columns.items()})
    if truth:
        for c, v in zip("xyz", positions(machine, hidden, stops).T, strict=True):
            table[f"{c}_true_mm"] = np.round(1e3 * v, 6)
    return table


def _table(stops: Stops, q_deg: Array, temperature: Array, measured: pd.DataFrame) -> pd.DataFrame:
    """The columns of a campaign."""
    table = pd.DataFrame({"pose": np.arange(1, len(stops) + 1), "time_s": np.round(stops.time_s, 1)})
    table["temperature_degC"] = temperature
    table["payload_kg"] = stops.payload_kg
    table[[f"approach{j}" for j in JOINTS]] = stops.approach.astype(int)
    table[[f"q{j}_deg" for j in JOINTS]] = q_deg
    return pd.concat([table, measured], axis=1)

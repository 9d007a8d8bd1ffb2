"""Simulated campaigns of a robot with hidden effects in MuJoCo."""

from collections.abc import Sequence
from functools import partial
from typing import Any, Unpack

import numpy as np
import pandas as pd

from casadical.blind_check.mujoco_physics.cause import Cause
from casadical.blind_check.mujoco_physics.equilibrium import Engine, Setting, Stop
from casadical.blind_check.mujoco_physics.hidden import Hidden, causes
from casadical.blind_check.mujoco_physics.plant import Array, Plant
from casadical.blind_check.mujoco_physics.robot import mechanism, start
from casadical.blind_check.mujoco_physics.stops import Stops, Warmup
from casadical.blind_check.mujoco_physics.table import Options, approaches, simulate
from casadical.blind_check.mujoco_physics.table import readings as columns_of_readings
from casadical.core.basics import InputError


def campaign(
    plant: Plant, hidden: Sequence[Hidden | Cause], n: int, seed: int, **options: Unpack[Options]
) -> pd.DataFrame:
    """Return the table of a simulated campaign of n poses, a row each; see `simulate`.

    plant : robot as built; hidden : hidden effects that act on it
    seed : seed of all random draws; options : as of `table.Options`
    Raises InputError for unusable arguments, and without MuJoCo.
    """
    return simulate(plant, partial(positions, plant, hidden), causes(hidden, plant.n), n, seed, **options)


def measure(
    plant: Plant, hidden: Sequence[Hidden | Cause], readings: pd.DataFrame, *, seed: int, **options: Unpack[Options]
) -> pd.DataFrame:
    """Return the table of a simulated campaign at given poses, with positions of the reflector.

    Quantities that `readings` lacks are constant (20 degC, the declared payload, approach 1), the
    time grows by 30 s.

    plant : robot as built; hidden : hidden effects that act on it
    readings : table with the columns q1_deg, .. (q1_mm of a prismatic joint) and, as far as they
        are given, time_s, temperature_degC, payload_kg, approach1, ..
    seed : seed of all random draws; options : as of `table.Options`
    Raises InputError where a column of readings is missing, or all rows are.
    """
    n, columns = len(readings), columns_of_readings(plant)
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

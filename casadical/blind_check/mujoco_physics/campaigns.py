"""Campaigns of a robot in the engine, with what is hidden in it."""

from collections.abc import Sequence
from functools import partial
from typing import Unpack

import numpy as np
import pandas as pd

from casadical.blind_check.mujoco_physics.equilibrium import Engine, Setting, Stop
from casadical.blind_check.mujoco_physics.hidden import Hidden, causes
from casadical.blind_check.mujoco_physics.robot import mechanism, start
from casadical.blind_check.synthetic.campaigns import Machine, Options, simulate, simulate_readings
from casadical.blind_check.synthetic.plant import Plant
from casadical.blind_check.synthetic.rigid import Array
from casadical.blind_check.synthetic.stops import Stops

REPEATABILITY_URAD = 5.0


def campaign(
    plant: Plant,
    hidden: Sequence[Hidden],
    n: int,
    seed: int,
    *,
    repeatability_urad: float = REPEATABILITY_URAD,
    **options: Unpack[Options],
) -> pd.DataFrame:
    """Measure ``n`` poses of the robot as built ``plant``; the same seed gives the same table.

    hidden : what else the robot or the instrument has; all else as in ``synthetic.campaigns.simulate``

    Raises InputError when an argument is not usable or MuJoCo is missing.
    """
    return simulate(_machine(plant, hidden), n, seed, repeatability_urad=repeatability_urad, **options)


def measure(
    plant: Plant,
    hidden: Sequence[Hidden],
    readings: pd.DataFrame,
    *,
    seed: int,
    noise_mm: float = 0.02,
    repeatability_urad: float = REPEATABILITY_URAD,
    truth: bool = False,
) -> pd.DataFrame:
    """Measure given poses: the table ``readings`` with the positions of the reflector.

    readings : one row a pose, with q1_deg..q6_deg; where they are missing, time_s is 30 s a pose, temperature_degC 20
        throughout, payload_kg the robot's, approach1..6 1; all else as in ``campaign``

    Raises InputError when a reading is missing.
    """
    machine = _machine(plant, hidden)
    return simulate_readings(
        machine, readings, seed, noise_mm=noise_mm, repeatability_urad=repeatability_urad, truth=truth
    )


def positions(plant: Plant, hidden: Sequence[Hidden], stops: Stops, jitter: Array | float = 0.0) -> Array:
    """Where the tracker sees the reflector without noise, (n, 3) [m]; ``jitter`` (n, 6) [rad] adds to the readings.

    Raises ConvergenceError where the engine finds no rest.
    """
    acting = causes(hidden)
    built, factor = mechanism(plant), 1.0
    for cause in acting:
        built = cause.built(built, plant)
        factor *= cause.payload_factor
    engine = Engine(built, travels=any(c.travels for c in acting), factor=factor)
    motors = stops.q + jitter + sum(c.motors(plant, stops) for c in acting)
    changes = [s for c in acting for s in c.settings(plant, stops)]
    seen = np.empty((len(stops), 3))
    for k in range(len(stops)):
        now = [Setting(s.kind, s.name, s.value[k]) for s in changes]
        seen[k] = engine.rest(
            Stop(motors[k], stops.approach[k], start(plant, motors[k]), float(stops.payload_kg[k]), now)
        )
    return seen


def _machine(plant: Plant, hidden: Sequence[Hidden]) -> Machine:
    return Machine(plant, partial(positions, plant, hidden), causes(hidden), true_decimals=6)

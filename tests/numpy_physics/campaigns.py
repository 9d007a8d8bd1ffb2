"""Campaigns of a robot with disturbances."""

from collections.abc import Sequence
from functools import partial
from typing import Unpack

import pandas as pd

from casadical.blind_check.mujoco_physics.plant import Plant
from casadical.blind_check.mujoco_physics.table import Machine, Options, simulate
from numpy_physics.disturbance import Disturbance
from numpy_physics.statics import positions


def campaign(
    plant: Plant,
    n: int,
    seed: int,
    *,
    disturbances: Sequence[Disturbance] = (),
    repeatability_urad: float = 8.0,
    **options: Unpack[Options],
) -> pd.DataFrame:
    """Measure ``n`` poses of the robot as built, as `mujoco_physics.campaign` does; the same seed, the same table."""
    machine = Machine(plant, partial(positions, plant, disturbances), disturbances, true_decimals=4)
    return simulate(machine, n, seed, repeatability_urad=repeatability_urad, **options)

"""Campaigns of a robot with disturbances."""

from collections.abc import Sequence
from functools import partial
from typing import Unpack

import pandas as pd

from casadical.blind_check.numpy_physics.disturbance import Disturbance
from casadical.blind_check.numpy_physics.statics import positions
from casadical.blind_check.synthetic.campaigns import Machine, Options, simulate
from casadical.blind_check.synthetic.plant import Plant


def campaign(
    plant: Plant,
    n: int,
    seed: int,
    *,
    disturbances: Sequence[Disturbance] = (),
    repeatability_urad: float = 8.0,
    **options: Unpack[Options],
) -> pd.DataFrame:
    """Measure ``n`` poses of the robot as built ``plant``; the same seed gives the same table.

    disturbances : what else the robot or the instrument has; all else as in ``synthetic.campaigns.simulate``

    Raises InputError when an argument is not usable or no pose keeps the loop's limits.
    """
    machine = Machine(plant, partial(positions, plant, disturbances), disturbances, true_decimals=4)
    return simulate(machine, n, seed, repeatability_urad=repeatability_urad, **options)

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

    Parameters
    ----------
    plant : Plant
        the robot as built
    n : int
        number of poses
    seed : int
        what everything drawn follows from
    disturbances : Sequence[Disturbance], default ()
        what else the robot or the instrument has
    repeatability_urad : float, default 8.0
        one sigma of each joint about its reading [urad]
    **options : Unpack[Options]
        as of `casadical.blind_check.synthetic.campaigns.simulate`

    Returns
    -------
    DataFrame
        columns of a campaign

    Raises
    ------
    InputError
        an argument is not usable, or no pose keeps the loop's limits

    Examples
    --------
    >>> from casadical.blind_check.numpy_physics import HH800, Plant, campaign
    >>> campaign(Plant.from_dict(HH800), 5, seed=1).columns[-3:].tolist()
    ['x_mm', 'y_mm', 'z_mm']
    """
    machine = Machine(plant, partial(positions, plant, disturbances), disturbances, true_decimals=4)
    return simulate(machine, n, seed, repeatability_urad=repeatability_urad, **options)

"""A simulator in numpy alone: the second opinion on the engine, and the maker of the campaigns of studies and tests.

It shares no formula with the calibration model. `campaign` measures a robot as built with any of the `disturbances`;
`hh800_twin` is the paper's experiment. Robots, poses and tables are those of `casadical.blind_check.mujoco_physics`.
"""

from numpy_physics import disturbances
from numpy_physics.campaigns import campaign
from numpy_physics.disturbance import Disturbance
from numpy_physics.draw import draw_disturbance
from numpy_physics.twin import HH800, UNMODELLED, WARMUP, hh800_true, hh800_twin

__all__ = [
    "HH800",
    "UNMODELLED",
    "WARMUP",
    "Disturbance",
    "campaign",
    "disturbances",
    "draw_disturbance",
    "hh800_true",
    "hh800_twin",
]

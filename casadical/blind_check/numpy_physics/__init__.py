"""Synthetic campaigns from a simulator in numpy that shares no formula with the calibration model.

``Plant.from_dict`` reads a nominal robot, ``perturb`` adds building errors, ``campaign`` measures it with any of the
``disturbances``; ``hh800_twin`` is the paper's experiment.
"""

from casadical.blind_check.numpy_physics import disturbances
from casadical.blind_check.numpy_physics.campaigns import campaign
from casadical.blind_check.numpy_physics.disturbance import Disturbance
from casadical.blind_check.numpy_physics.draw import draw_disturbance
from casadical.blind_check.numpy_physics.twin import HH800, UNMODELLED, WARMUP, hh800_true, hh800_twin
from casadical.blind_check.synthetic.perturb import perturb
from casadical.blind_check.synthetic.plant import FourBar, Plant
from casadical.blind_check.synthetic.stops import Warmup

__all__ = [
    "HH800",
    "UNMODELLED",
    "WARMUP",
    "Disturbance",
    "FourBar",
    "Plant",
    "Warmup",
    "campaign",
    "disturbances",
    "draw_disturbance",
    "hh800_true",
    "hh800_twin",
    "perturb",
]

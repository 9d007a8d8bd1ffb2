"""Independent physics of robots as built, with hidden effects, in the engine MuJoCo.

``Plant.from_dict`` reads a nominal robot, ``perturb`` adds building errors, ``campaign`` measures
it with ``Hidden`` effects, ``measure`` does so at given poses, ``draw_effect`` draws one at random.
The engine finds the equilibrium. Of casadical only errors and display are imported: rotations,
loops and tables are implemented here again, so that a diagnosis that is checked against these
campaigns is not checked against its own formulas. MuJoCo is loaded when an ``Engine`` is made:
``pip install 'casadical[withheld]'``.
"""

from casadical.blind_check.mujoco_physics.campaigns import campaign, measure, positions
from casadical.blind_check.mujoco_physics.equilibrium import Engine, Setting, Stop, mjcf
from casadical.blind_check.mujoco_physics.hidden import LISTED, UNLISTED, Hidden, draw_effect
from casadical.blind_check.mujoco_physics.mechanism import Body, Cord, Joint, Mechanism, Shaft, mechanism
from casadical.blind_check.mujoco_physics.plant import FourBar, Plant, perturb
from casadical.blind_check.mujoco_physics.stops import Warmup

__all__ = [
    "LISTED",
    "UNLISTED",
    "Body",
    "Cord",
    "Engine",
    "FourBar",
    "Hidden",
    "Joint",
    "Mechanism",
    "Plant",
    "Setting",
    "Shaft",
    "Stop",
    "Warmup",
    "campaign",
    "draw_effect",
    "measure",
    "mechanism",
    "mjcf",
    "perturb",
    "positions",
]

"""A reality that is not ours: robots in the physics engine MuJoCo, as built, with effects hidden in them.

``campaign`` measures a robot with what is ``Hidden`` in it, ``measure`` does so at given poses, ``draw_hidden`` hides
effects by chance. Rest is found by the engine; of casadical it takes nominal robots, their building errors and the
drawing of poses (``casadical.blind_check.numpy_physics``), and nothing of the model, the effects or the diagnosis.
MuJoCo itself is loaded when an ``Engine`` is made: ``pip install 'casadical[withheld]'``.
"""

from casadical.blind_check.mujoco_physics.campaigns import campaign, measure, positions
from casadical.blind_check.mujoco_physics.draw import draw_effect, draw_hidden
from casadical.blind_check.mujoco_physics.equilibrium import Engine, Setting, Stop
from casadical.blind_check.mujoco_physics.hidden import LISTED, UNLISTED, Hidden
from casadical.blind_check.mujoco_physics.mechanism import Body, Cord, Joint, Loop, Mechanism, Shaft
from casadical.blind_check.mujoco_physics.mjcf import mjcf
from casadical.blind_check.mujoco_physics.robot import mechanism

__all__ = [
    "LISTED",
    "UNLISTED",
    "Body",
    "Cord",
    "Engine",
    "Hidden",
    "Joint",
    "Loop",
    "Mechanism",
    "Setting",
    "Shaft",
    "Stop",
    "campaign",
    "draw_effect",
    "draw_hidden",
    "measure",
    "mechanism",
    "mjcf",
    "positions",
]

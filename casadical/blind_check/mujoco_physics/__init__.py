"""Independent physics: robots as built in the engine MuJoCo, with hidden effects.

``campaign`` measures a robot with ``Hidden`` effects, ``measure`` does so at given poses, ``draw_hidden`` draws effects
at random. The engine finds the equilibrium. Nominal robots, their building errors and the drawing of poses are those of
``casadical.blind_check.synthetic``; nothing is taken from the model, the effects or the diagnosis. MuJoCo is loaded
when an ``Engine`` is made: ``pip install 'casadical[withheld]'``.
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

"""A calibrated robot, and what a diagnosis found of it, as a model for a simulator (MJCF, URDF), and its replay there.

MuJoCo itself is needed only to replay: `pip install 'casadical[mujoco]'`.
"""

from .mjcf import MjcfExport, mjcf
from .replay import Replay, replay, replay_campaign, replay_diagnosis
from .rest import positions

__all__ = ["MjcfExport", "Replay", "mjcf", "positions", "replay", "replay_campaign", "replay_diagnosis"]

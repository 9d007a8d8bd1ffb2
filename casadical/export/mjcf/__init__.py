"""A calibrated robot with its diagnosed effects as a MuJoCo model (MJCF), and measured poses replayed in it.

MuJoCo itself is needed only to replay: `pip install 'casadical[mujoco]'`.
"""

from casadical.export.mjcf.equilibrium import positions
from casadical.export.mjcf.mjcf import MjcfExport, mjcf
from casadical.export.mjcf.replay import Replay, replay, replay_campaign, replay_diagnosis

__all__ = ["MjcfExport", "Replay", "mjcf", "positions", "replay", "replay_campaign", "replay_diagnosis"]

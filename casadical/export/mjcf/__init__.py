"""A calibrated robot with its diagnosed effects as a MuJoCo model (MJCF), and measured poses replayed in it.

MuJoCo itself is needed only to replay: `pip install 'casadical[mujoco]'`.
"""

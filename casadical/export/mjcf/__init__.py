"""A calibrated robot with its effects as a MuJoCo model, and poses replayed in it.

MuJoCo itself is needed only to replay: `pip install 'casadical[mujoco]'`.
"""

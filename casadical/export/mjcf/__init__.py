"""MuJoCo models of a calibrated robot with its effects, and measured poses replayed in them.

MuJoCo itself is needed only to replay: `pip install 'casadical[mujoco]'`.
"""

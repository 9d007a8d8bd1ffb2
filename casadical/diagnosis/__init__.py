"""Diagnosis of calibrated robots: why the model still differs from the robot, and which effect."""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

"""Why the calibrated model still differs from the robot: where, which effect, and how far the gap shrinks with it."""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

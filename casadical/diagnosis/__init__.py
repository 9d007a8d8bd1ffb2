"""Why is there still a gap between the model and the robot: where it lies, which effect, how far it shrinks."""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

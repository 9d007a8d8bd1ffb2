"""Small neural network that corrects the errors that remain after calibration."""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

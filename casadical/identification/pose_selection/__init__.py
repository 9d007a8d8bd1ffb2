"""Selection of poses to measure, their number, and the accuracy to expect."""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

"""The robot: its parts, its symbolic model, its parameters, and the files it is read from and written to."""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

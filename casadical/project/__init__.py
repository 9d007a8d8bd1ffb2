"""A problem folder: read, checked, created, calibrated."""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

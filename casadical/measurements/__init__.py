"""Measured poses: tables become one immutable, checked object in SI units."""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

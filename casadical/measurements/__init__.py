"""Measured poses and joint logs: tables become immutable, checked objects in SI units."""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

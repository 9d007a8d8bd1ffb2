"""Measured poses: tables in, one immutable checked object in SI out."""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

"""Identification: bounded least squares on the symbolic model, and what its result is worth."""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

"""Identification: bounded least squares on the symbolic model, and the accuracy of the result."""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

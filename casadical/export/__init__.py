"""Exports of a calibrated robot: C99 code, corrected programs, models for simulators and drivers.

The C is deterministic, checks its inputs and needs no libm.
"""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

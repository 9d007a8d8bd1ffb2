"""CasADi functions as guarded, deterministic C99 without libm, and models for simulators."""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

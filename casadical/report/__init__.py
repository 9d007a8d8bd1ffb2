"""Figures and HTML reports of a calibration or a diagnosis; a report is one file that needs no other."""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

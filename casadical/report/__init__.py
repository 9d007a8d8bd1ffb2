"""What a calibration or a diagnosis found, to look at: figures for Python, and one HTML file that needs no other."""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

"""Many campaigns and many robots: what changed since last time, and what robots of one type share."""

from casadical.core.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

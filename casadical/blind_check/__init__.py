"""Blind check of the diagnosis: campaigns with hidden effects, its answers to them, and the score.

``make`` draws robots and effects in a physics that shares no formula with the diagnosis, and writes
what an instrument would have recorded to one folder and the key to another; ``predict`` reads only
the campaigns; ``score`` opens the key.
"""

from casadical.core.lazy import attach

# Imports are lazy, because predicting must not load the physics that makes the campaigns.
__getattr__, __dir__, __all__ = attach(__name__, __file__)

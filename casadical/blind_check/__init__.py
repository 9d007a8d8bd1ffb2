"""The blind check: campaigns with hidden effects, answers of the diagnosis to them, and the score.

``make`` draws robots and effects in a physics that shares no formula with the diagnosis, and writes what an instrument
would have recorded to one folder and the key to another; ``predict`` reads the campaigns only; ``score`` opens the key.
"""

from casadical.core.lazy import attach

# Predicting must not load what makes the campaigns.
__getattr__, __dir__, __all__ = attach(__name__, __file__)

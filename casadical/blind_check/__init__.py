"""The blind check: campaigns whose hidden effect is kept apart, answers given without it, and the score.

``make`` draws robots and effects in an engine that shares no formula with the diagnosis, writes what an instrument
would have recorded, and the key to a separate place; ``predict`` sees the campaigns alone; ``score`` opens the key.
"""

from casadical.core.lazy import attach

# Predicting must not load what makes the campaigns.
__getattr__, __dir__, __all__ = attach(__name__, __file__)

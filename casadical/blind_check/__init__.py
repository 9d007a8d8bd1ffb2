"""The blind check: campaigns whose hidden effect is kept apart, answers given without it, and the score.

``make`` draws robots and effects in an engine that shares no formula with the diagnosis, writes what an instrument
would have recorded, and the key to a separate place; ``predict`` sees the campaigns alone; ``score`` opens the key.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from casadical.blind_check.making import make as make
    from casadical.blind_check.predicting import predict as predict
    from casadical.blind_check.scoring import score as score

__all__ = ["make", "predict", "score"]

_PLACES = {"make": "making", "predict": "predicting", "score": "scoring"}


def __getattr__(name: str) -> Any:
    # Predicting must not load what makes the campaigns.
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)

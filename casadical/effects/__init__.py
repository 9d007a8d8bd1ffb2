"""Effects that a base model omits: symbolic terms, each with its insertion points in the model."""

from casadical.effects.base import Context, Effect
from casadical.effects.registry import *  # noqa: F403 - every effect, by its line there
from casadical.effects.settings import setting

__all__ = ["Context", "Effect", "setting"]

"""Effects that a base model leaves out: one symbolic term each, entering the model at one method."""

from casadical.effects.base import Context, Effect
from casadical.effects.registry import *  # noqa: F403 - every effect, by its line there
from casadical.effects.settings import setting

__all__ = ["Context", "Effect", "setting"]

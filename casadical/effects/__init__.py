"""Effects that a base model leaves out: one symbolic term each, at a named seam of the model."""

from .base import Context, Effect

__all__ = ["Context", "Effect"]

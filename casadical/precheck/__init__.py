"""What is wrong with a problem and its data, and what to expect of them, before anything is solved."""

from .precheck import Precheck, precheck

__all__ = ["Precheck", "precheck"]

"""What is wrong with a problem and its data, and what to expect of them, before anything is solved."""

from casadical.project.check.check import Precheck, precheck

__all__ = ["Precheck", "precheck"]

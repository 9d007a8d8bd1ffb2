"""Faults of a problem and its data, and the expected accuracy, before a solve."""

from casadical.project.check.check import precheck
from casadical.project.check.result import Precheck

__all__ = ["Precheck", "precheck"]

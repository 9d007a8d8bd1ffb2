"""Checks before a solve: faults of a problem and its data, and the accuracy to expect."""

from casadical.project.check.check import precheck
from casadical.project.check.result import Precheck

__all__ = ["Precheck", "precheck"]

"""Faults of a problem and its data, and the expected accuracy, before a solve."""

from casadical.project.check.check import Precheck, precheck

__all__ = ["Precheck", "precheck"]

"""Checks before a solve: faults of a problem and its data, and the accuracy to expect."""

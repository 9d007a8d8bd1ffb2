"""Synthetic measurement campaigns from a physical simulator that shares no formula with the calibration model."""

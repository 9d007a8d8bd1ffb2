"""A problem folder: read, checked, created, calibrated."""

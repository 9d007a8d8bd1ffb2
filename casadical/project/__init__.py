"""A problem folder: read, checked, made anew, calibrated."""

"""Acceptance tests of a calibrated robot: verification with later poses, ISO 9283, certificates."""

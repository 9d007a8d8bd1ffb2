"""Identification: bounded least squares on the symbolic model, and what its result is worth."""

"""The robot: parts, symbolic model, parameters, and its files."""

"""The robot: its parts, its symbolic model, its parameters, and the files it is read from and written to."""

"""Joint logs: what a controller wrote while the arm moved, from the files of several systems, as one checked object."""

"""Joint logs: what a controller recorded while the arm moved, from files of several systems."""

"""New problem folders that run: from a URDF, from a DH table, or as a commented example."""

from casadical.measurements.proposals import Question
from casadical.project.new.new import new_problem

__all__ = ["Question", "new_problem"]

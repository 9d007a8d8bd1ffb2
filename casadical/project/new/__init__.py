"""A new problem folder that runs: from a URDF, from a DH table, or as an example to be read and changed."""

from casadical.project.new.new import new_problem

__all__ = ["new_problem"]

"""The size of an effect's signal: the part of its shifts that no change of the base model can reproduce."""

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.linearisation import signatures
from casadical.identification.identification import base_calibrated
from casadical.identification.prepared import prepare
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

# A singular value below this share of the largest counts as zero.
RANK = 1e-9


def base_jacobian(robot: Robot, clean: Measurements) -> Array:
    """Columns of the base model, shape (n, 3, P), calibrated on a campaign without effects."""
    fit = base_calibrated(prepare(robot, clean))
    m, _ = derive(clean, robot.conditions)
    return signatures(robot, (), m, robot.values_of(fit.robot))[1]


def unabsorbed_rms(J: Array, shift: Array) -> float:
    """Root mean square [m] of a shift, shape (n, 3) [m], orthogonal to the base model's columns, shape (n, 3, P)."""
    Q = column_space(J.reshape(shift.size, -1))
    left = shift.ravel() - Q @ (Q.T @ shift.ravel())
    return float(np.sqrt(np.mean(left**2)))


def column_space(A: Array) -> Array:
    """Orthonormal columns, shape (rows, rank), that span those of a matrix, shape (rows, columns), of any scale.

    The base model has columns that depend on others; without a cut by rank these would add arbitrary directions.
    """
    U, s, _ = np.linalg.svd(A / np.maximum(np.linalg.norm(A, axis=0), 1e-300), full_matrices=False)
    return np.asarray(U[:, s > RANK * s[0]])

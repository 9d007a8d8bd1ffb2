"""How much of what an effect moves is left to see: the part that no change of the base model can imitate."""

from __future__ import annotations

import numpy as np

from casadical.core.transforms import Array
from casadical.diagnosis.linearisation import signatures
from casadical.identification.identification import identify
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot


def base_jacobian(robot: Robot, clean: Measurements) -> Array:
    """Columns of the base model, shape (n, 3, P), calibrated on a campaign that hides nothing."""
    found = identify(robot, clean, ("kinematic", "compliance"), loss="huber", priors=True, screen=False)
    m, _ = derive(clean, robot.conditions)
    return signatures(robot, (), m, robot.values_of(found.robot))[1]


def visible(J: Array, shift: Array) -> float:
    """Root mean square [m] of a shift, shape (n, 3) [m], orthogonal to the base model's columns, shape (n, 3, P)."""
    A = J.reshape(shift.size, -1)
    Q, _ = np.linalg.qr(A / np.maximum(np.linalg.norm(A, axis=0), 1e-12))
    left = shift.ravel() - Q @ (Q.T @ shift.ravel())
    return float(np.sqrt(np.mean(left**2)))

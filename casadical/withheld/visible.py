"""How much of what an effect moves is left to see: the part that no change of the base model can imitate."""

from __future__ import annotations

import numpy as np

from ..conditions import derive
from ..diagnosis.signatures import signatures
from ..identification import identify
from ..measurements import Measurements
from ..robot import Robot
from ..transforms import Array


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

"""Measured positions and orientations of the tool."""

from collections.abc import Set

import casadi as ca
import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.core.transforms import Symbolic, from_quaternion, from_xyz
from casadical.measurements.columns import Columns
from casadical.measurements.kinds.base import PoseExpression
from casadical.measurements.kinds.position import Position

# Columns of an orientation, as a pattern.
ORIENTATION = "r[xyz]_(deg|rad)|R[012]{2}|q[wxyz]"


class Pose(Position):
    """Position and orientation; the reported error is that of the position."""

    name = "pose"
    columns = (
        "those of `position` and one of `rx_deg, ry_deg, rz_deg` (rotations about x, then the new y, then the new z; "
        "or `_rad`), `R00` .. `R22`, or `qw, qx, qy, qz`"
    )
    fill = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
    pattern = f"{Position.pattern}|{ORIENTATION}"
    arrays = ("position", "orientation")
    angles = 3

    def matches(self, names: Set[str]) -> bool:
        return super().matches(names) and bool(names & {"rx_deg", "rx_rad", "R00", "qw"})

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        return {**super().read(columns, q), "orientation": orientations(columns)}

    def residual(self, pose: PoseExpression) -> Symbolic:
        return ca.vertcat(super().residual(pose), turned_off(pose.R, pose.take("orientation", 9)))


def turned_off(R: Symbolic, measured: Symbolic) -> Symbolic:
    """Rotation vector, shape (3,) [rad], from an orientation as measured, its nine numbers row by row, to R, (3, 3)."""
    # CasADi fills by columns, so this is the transpose of the measured orientation.
    E = ca.reshape(measured, 3, 3) @ R
    # sin(angle) times the axis: smooth, and the rotation vector itself to third order.
    return 0.5 * ca.vertcat(E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1])


def orientations(columns: Columns) -> Array:
    """Rotation matrices, shape (n, 3, 3). Raises InputError."""
    if "R00" in columns.table:
        R = np.stack([columns.column(f"R{i}{j}") for i in range(3) for j in range(3)], axis=1).reshape(-1, 3, 3)
    elif "qw" in columns.table:
        quaternion = np.stack([columns.column(c) for c in ("qw", "qx", "qy", "qz")], axis=1)
        length = np.linalg.norm(quaternion, axis=1)
        if np.abs(length - 1).max() > 1e-2:
            row = int(np.abs(length - 1).argmax())
            raise InputError(
                f"{columns.at(row)}, columns 'qw' to 'qz': length {length[row]:.4g}; "
                "allowed: unit quaternions (w first), within 1 %"
            )
        R = from_quaternion(quaternion)
    else:
        angles = columns.vector("r", ("_deg", "_rad"))
        # Rx(a) Ry(b) Rz(c) is the transpose of Rz(-c) Ry(-b) Rx(-a).
        R = np.stack([from_xyz(xyz) for xyz in angles])
    off = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) + (np.linalg.det(R) < 0)
    if off.max() > 1e-3:
        row = int(off.argmax())
        raise InputError(
            f"{columns.at(row)}, columns 'R00' to 'R22': no rotation (R R' differs from one by "
            f"{off[row]:.3g}, mirrored ones by more than one); allowed: orthonormal matrices, right-handed"
        )
    return R

"""Elementary homogeneous transforms; each takes and returns numbers, DM or SX alike (4 x 4, metres and radians)."""

import operator
from collections.abc import Sequence
from functools import reduce
from typing import Any

import casadi as ca
import numpy as np

from casadical.core.basics import Array

Symbolic = Any  # ca.SX, ca.MX, ca.DM or float: casadi's operators accept them all


def rot_x(angle: Symbolic) -> Symbolic:
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.blockcat([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])


def rot_y(angle: Symbolic) -> Symbolic:
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.blockcat([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])


def rot_z(angle: Symbolic) -> Symbolic:
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.blockcat([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def translate(x: Symbolic, y: Symbolic, z: Symbolic) -> Symbolic:
    return ca.blockcat([[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, z], [0, 0, 0, 1]])


def small_frame(x: Symbolic, y: Symbolic, z: Symbolic, rx: Symbolic, ry: Symbolic, rz: Symbolic) -> Symbolic:
    """Translation, then rotations about x, y, z in this order (intrinsic)."""
    return translate(x, y, z) @ rot_x(rx) @ rot_y(ry) @ rot_z(rz)


def product(factors: Sequence[Symbolic]) -> Symbolic:
    """Product of transforms, the first one outermost."""
    return reduce(operator.matmul, factors)


def carry(factors: Sequence[Symbolic], point: Symbolic) -> Symbolic:
    """A point, shape (3,), through transforms, the last one first: a tenth of the work of their product."""
    carried = ca.vertcat(point, 1)
    for T in reversed(factors):
        carried = T @ carried
    return carried[:3]


def apply(T: Symbolic, point: Symbolic) -> Symbolic:
    """A point, shape (3,), moved by the transform T."""
    return T[:3, :3] @ point + T[:3, 3]


def inverse(T: Symbolic) -> Symbolic:
    R = T[:3, :3].T
    return ca.blockcat([[R, -R @ T[:3, 3]], [ca.DM([[0, 0, 0]]), 1]])


def from_rpy(rpy: Array) -> Array:
    """Rotation, shape (3, 3), from fixed-axis roll, pitch, yaw [rad]: Rz(yaw) Ry(pitch) Rx(roll), as URDF has it."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def to_rpy(R: Array) -> Array:
    """Roll, pitch, yaw [rad] of a rotation, shape (3, 3); at pitch +-90 deg the yaw is taken as zero."""
    horizontal = np.hypot(R[0, 0], R[1, 0])
    yaw = np.arctan2(R[1, 0], R[0, 0]) if horizontal > 1e-15 else 0.0
    # The roll is read after the yaw is turned back: near pitch +-90 deg their errors then cancel.
    c, s = np.cos(yaw), np.sin(yaw)
    roll = np.arctan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return np.array([roll, np.arctan2(-R[2, 0], horizontal), yaw])


def from_xyz(xyz: Array) -> Array:
    """Rotation, shape (3, 3), about x, y, z in this order (intrinsic) [rad]: that of `small_frame`, in numbers."""
    return from_rpy(-np.asarray(xyz)).T


def to_xyz(R: Array) -> Array:
    """Angles [rad] of rotations about x, y, z in this order (intrinsic), as `small_frame` takes them."""
    return -to_rpy(R.T)


def quaternion(R: Array) -> Array:
    """Unit quaternion, shape (4,), scalar first and not negative, of a rotation, shape (3, 3)."""
    # The greatest eigenvector of a symmetric matrix (Bar-Itzhack 2000), which needs no case distinctions.
    K = np.zeros((4, 4))
    K[0, 1:] = K[1:, 0] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    K[1:, 1:] = R + R.T - np.trace(R) * np.eye(3)
    K[0, 0] = np.trace(R)
    q = np.linalg.eigh(K)[1][:, -1]
    return np.asarray(q if q[0] >= 0 else -q)


def from_quaternion(q: Array) -> Array:
    """Rotations, shape (..., 3, 3), of quaternions of any length but zero, scalar first, shape (..., 4)."""
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def frame(R: Array, p: Array) -> Array:
    """Transform, shape (4, 4), from a rotation (3, 3) and a translation (3,) [m]."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = p
    return T


def nearest_rotation(M: Array) -> Array:
    """The rotation closest to a 3 x 3 matrix in the Frobenius norm (Kabsch)."""
    U, _, Vt = np.linalg.svd(M)
    if np.linalg.det(U @ Vt) < 0:
        U[:, 2] *= -1
    return np.asarray(U @ Vt)

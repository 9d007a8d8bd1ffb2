"""Elementary homogeneous transforms, 4 x 4 [m, rad], of numbers, DM or SX alike."""

import operator
from collections.abc import Sequence
from functools import reduce
from typing import Any

import casadi as ca
import numpy as np

from casadical.core.basics import Array

Symbolic = Any  # ca.SX, ca.MX, ca.DM or float: casadi's operators accept them all


def rot_x(angle: Symbolic) -> Symbolic:
    """Return the transform of a rotation about x by an angle [rad], shape (4, 4)."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.blockcat([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])


def rot_y(angle: Symbolic) -> Symbolic:
    """Return the transform of a rotation about y by an angle [rad], shape (4, 4)."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.blockcat([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])


def rot_z(angle: Symbolic) -> Symbolic:
    """Return the transform of a rotation about z by an angle [rad], shape (4, 4)."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.blockcat([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def translate(x: Symbolic, y: Symbolic, z: Symbolic) -> Symbolic:
    """Return the transform of a translation [m], shape (4, 4)."""
    return ca.blockcat([[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, z], [0, 0, 0, 1]])


def small_frame(x: Symbolic, y: Symbolic, z: Symbolic, rx: Symbolic, ry: Symbolic, rz: Symbolic) -> Symbolic:
    """Return the transform, (4, 4), translate(x, y, z) rot_x(rx) rot_y(ry) rot_z(rz).

    These are a translation [m] and intrinsic rotations about x, y, z [rad], applied in this order.
    """
    return translate(x, y, z) @ rot_x(rx) @ rot_y(ry) @ rot_z(rz)


def product(factors: Sequence[Symbolic]) -> Symbolic:
    """Return the matrix product of transforms in the given order, shape (4, 4)."""
    return reduce(operator.matmul, factors)


def carry(factors: Sequence[Symbolic], point: Symbolic) -> Symbolic:
    """Return a point, shape (3,) [m], transformed by the product of transforms, (4, 4) each.

    The last transform is applied first. This takes a tenth of the operations of their product.
    """
    carried = ca.vertcat(point, 1)
    for T in reversed(factors):
        carried = T @ carried
    return carried[:3]


def apply(T: Symbolic, point: Symbolic) -> Symbolic:
    """Return a point, shape (3,) [m], transformed by T, shape (4, 4)."""
    return T[:3, :3] @ point + T[:3, 3]


def inverse(T: Symbolic) -> Symbolic:
    """Return the inverse of a rigid transform, shape (4, 4)."""
    R = T[:3, :3].T
    return ca.blockcat([[R, -R @ T[:3, 3]], [ca.DM([[0, 0, 0]]), 1]])


def from_rpy(rpy: Array) -> Array:
    """Return the rotation matrices, shape (..., 3, 3), of roll, pitch, yaw, shape (..., 3) [rad].

    The axes x, y, z are fixed and turned about in this order, as in URDF.
    """
    return np.asarray(from_xyz(-np.asarray(rpy)).swapaxes(-1, -2))


def to_rpy(R: Array) -> Array:
    """Return roll, pitch and yaw, shape (3,) [rad], of a rotation, shape (3, 3); see `from_rpy`.

    At pitch +-90 deg the yaw is zero. Within 1e-7 rad of these pitches scipy's angles lose up to
    1e-7 rad, and it warns; these angles do not.
    """
    horizontal = np.hypot(R[0, 0], R[1, 0])
    yaw = np.arctan2(R[1, 0], R[0, 0]) if horizontal > 1e-15 else 0.0
    # The roll is read after the yaw is turned back: near pitch +-90 deg their errors then cancel.
    c, s = np.cos(yaw), np.sin(yaw)
    roll = np.arctan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return np.array([roll, np.arctan2(-R[2, 0], horizontal), yaw])


def from_xyz(xyz: Array) -> Array:
    """Return the rotation matrices, shape (..., 3, 3), of intrinsic angles, shape (..., 3) [rad].

    The axes x, y, z move and are turned about in this order, as in `small_frame`. The product of the
    three turns is written out, for scipy's rotations take a tenth of a second to import.
    """
    (cx, cy, cz), (sx, sy, sz) = (np.moveaxis(f(np.asarray(xyz, dtype=float)), -1, 0) for f in (np.cos, np.sin))
    rows = (
        (cy * cz, -cy * sz, sy),
        (cx * sz + sx * sy * cz, cx * cz - sx * sy * sz, -sx * cy),
        (sx * sz - cx * sy * cz, sx * cz + cx * sy * sz, cx * cy),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def to_xyz(R: Array) -> Array:
    """Return the intrinsic angles about x, y, z, shape (3,) [rad], of a rotation, shape (3, 3).

    They are those of `small_frame`; at +-90 deg about y, that about z is zero.
    """
    return -to_rpy(R.T)


def quaternion(R: Array) -> Array:
    """Return the unit quaternion of a rotation, shape (4,), scalar first and not negative."""
    from scipy.spatial.transform import Rotation

    return np.roll(Rotation.from_matrix(R).as_quat(canonical=True), 1)


def from_quaternion(q: Array) -> Array:
    """Return rotations, (..., 3, 3), of quaternions, (..., 4), of any norm but 0, scalar first."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(np.roll(q, -1, axis=-1)).as_matrix())


def frame(R: Array, p: Array) -> Array:
    """Return the transform, shape (4, 4) [m], of a rotation R, (3, 3), and translation p, (3,)."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = p
    return T


def nearest_rotation(M: Array) -> Array:
    """Return the rotation, shape (3, 3), closest to a matrix M, (3, 3), in the Frobenius norm.

    Source: Kabsch (1976).
    """
    U, _, Vt = np.linalg.svd(M)
    if np.linalg.det(U @ Vt) < 0:
        U[:, 2] *= -1
    return np.asarray(U @ Vt)

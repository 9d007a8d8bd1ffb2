"""Modified DH rows from joint axes in space: common normals (Craig), or Hayati's form.

The latter is for nearly parallel neighbours. Each row is computed in the frame of the rows before
it, so that rounding errors do not accumulate along the chain. Where the common normal leaves a
choice, the simpler table wins: d = 0 before a nearly parallel axis, a >= 0 (but for an |a| below
1e-5 m), and x axes of frames 0 and n along those of the base and the tip.
"""

import operator
from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate

import numpy as np

from casadical.core.basics import Array
from casadical.core.parts import NEAR_PARALLEL_RAD, Joint
from casadical.core.transforms import frame, rot_x, rot_y, rot_z, translate

# Magnitude below which a DH parameter [m or rad] counts as zero: a rounding error.
ROUNDING_TOLERANCE = 1e-14


def rows_from_axes(
    points: Sequence[Array], directions: Sequence[Array], tip: Array
) -> tuple[Array, tuple[Joint, ...], tuple[Array, ...], Array]:
    """Return the modified DH form of a chain given by its joint axes at zero joint variables.

    The four values are frame 0 in the common frame, shape (4, 4) [m]; one row per axis, with its
    geometry only; the link frames at zero joint variables in the common frame, each (4, 4) [m]; and
    the tip in the last link's frame, shape (4, 4) [m]. Axes may be parallel, antiparallel,
    intersecting or coincident.

    points, directions : any point on each axis [m] and its unit vector, shape (3,) each, from base
        to tip in a common frame; tip : chain's end in that frame, shape (4, 4) [m]
    """
    # Frame 0 has z along the first axis, its origin at the axis' point nearest to the common
    # frame's origin, and x oriented like the common frame's.
    z = directions[0]
    x = _perpendicular_x(np.eye(3), z)
    T = base = frame(np.column_stack([x, np.cross(z, x), z]), points[0] - (points[0] @ z) * z)
    rows, frames = [], []
    row = Joint()
    for k in range(len(points)):
        entry = T @ row_matrix(row)
        if k + 1 < len(points):
            # Theta and d of the row point its x at the next axis, which begins the next row.
            to_entry = np.linalg.inv(entry)
            p = to_entry[:3, :3] @ points[k + 1] + to_entry[:3, 3]
            z = to_entry[:3, :3] @ directions[k + 1]
            parallel = np.hypot(z[0], z[1]) < np.sin(NEAR_PARALLEL_RAD)
            row, following = _hayati(row, p, z) if parallel else _craig(row, p, z)
        else:
            # The last frame has its origin at the height of the tip, and x oriented like the tip's.
            end = np.linalg.inv(entry) @ tip
            x = _perpendicular_x(end[:3, :3], np.array([0.0, 0.0, 1.0]))
            row = replace(row, theta=_without_rounding(np.arctan2(x[1], x[0])), d=_without_rounding(end[2, 3]))
        T = T @ row_matrix(row)
        rows.append(row)
        frames.append(T)
        row = following if k + 1 < len(points) else row
    return base, tuple(rows), tuple(frames), np.linalg.inv(T) @ tip


def frames_at_zero(rows: Sequence[Joint]) -> list[Array]:
    """Return frames 1 to n of the links at zero joint variables in frame 0, each (4, 4) [m]."""
    return list(accumulate(map(row_matrix, rows), operator.matmul))


def row_matrix(row: Joint) -> Array:
    """Return frame i in frame i-1 by its modified DH row i at variable 0, shape (4, 4) [m]."""
    return np.array(
        rot_x(row.alpha)
        @ translate(row.a, 0, 0)
        @ rot_y(row.beta or 0.0)
        @ translate(0, row.b or 0.0, 0)
        @ rot_z(row.theta)
        @ translate(0, 0, row.d)
    )


def _perpendicular_x(R: Array, z: Array) -> Array:
    """Return the unit vector along the x axis of R projected perpendicular to z, shape (3,).

    Where x is within 30 deg of z or -z, the y axis of R is projected instead.
    """
    x = R[:, 0] if abs(R[:, 0] @ z) < np.sqrt(0.75) else R[:, 1]
    x = x - (x @ z) * z
    return np.asarray(x / np.linalg.norm(x))


def _craig(row: Joint, p: Array, z: Array) -> tuple[Joint, Joint]:
    """Return row and next row by the common normal of the row's z axis and the next joint's axis.

    The row gets theta and d; the next row is new and has alpha and a.
    p, z : point [m] and unit direction of that axis in the row's frame, shape (3,) each
    """
    sine, cosine = np.hypot(z[0], z[1]), z[2]
    normal = np.array([-z[1], z[0], 0.0]) / sine
    a = p @ normal
    d = (p[2] - (p @ z) * cosine) / sine**2
    theta, alpha = np.arctan2(normal[1], normal[0]), np.arctan2(sine, cosine)
    # The direction of a common normal shorter than 1e-5 m is determined by rounding in the file.
    backwards = abs(theta) > np.pi / 2 + ROUNDING_TOLERANCE if abs(a) < 1e-5 else a < 0
    if backwards:
        theta, a, alpha = theta - np.copysign(np.pi, theta), -a, -alpha
    return replace(row, theta=_without_rounding(theta), d=_without_rounding(d)), Joint(
        alpha=_without_rounding(alpha), a=_without_rounding(a)
    )


def _hayati(row: Joint, p: Array, z: Array) -> tuple[Joint, Joint]:
    """Return row and next row for a next axis nearly parallel to the row's z axis (Hayati's form).

    The next frame's origin is where that axis meets the row's x-y plane. The row gets theta, zero
    for axes that meet there; the next row is new and has alpha, a and beta.
    p, z : point [m] and unit direction of that axis in the row's frame, shape (3,) each
    """
    meeting = p - (p[2] / z[2]) * z
    a = np.hypot(meeting[0], meeting[1])
    # Axes closer than 1e-12 m have no direction between them.
    theta = np.arctan2(meeting[1], meeting[0]) if a > 1e-12 else 0.0
    c, s = np.cos(theta), np.sin(theta)
    beta = np.arcsin(c * z[0] + s * z[1])
    alpha = np.arctan2(s * z[0] - c * z[1], z[2])
    return replace(row, theta=_without_rounding(theta)), Joint(
        alpha=_without_rounding(alpha), a=_without_rounding(a), beta=_without_rounding(beta)
    )


def _without_rounding(value: float) -> float:
    """Return the value, or zero where its magnitude is below `ROUNDING_TOLERANCE`."""
    return 0.0 if abs(value) < ROUNDING_TOLERANCE else float(value)

"""Joint axes in space to modified DH rows: common normals (Craig), Hayati's form where neighbours are nearly parallel.

Each row is read off in the frame of the rows before it, so that no rounding adds up along the chain. Where a common
normal leaves a choice, the simpler table wins: d = 0 in front of a nearly parallel axis, a >= 0, frames 0 and n turned
like the base and the tip.
"""

import operator
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from casadical.core.basics import Array
from casadical.core.parts import NEAR_PARALLEL_RAD, Joint
from casadical.core.transforms import frame, rot_x, rot_y, rot_z, translate

NOISE = 1e-14  # of products of sines


@dataclass(frozen=True, eq=False)
class Axis:
    """A joint's axis at zero reading: a point on it, shape (3,) [m], and its unit direction, shape (3,)."""

    point: Array
    direction: Array


@dataclass(frozen=True, eq=False)
class Chain:
    """A chain in modified DH form.

    base : frame 0 in the frame in which the axes were given, shape (4, 4) [m]
    rows : with their geometry only
    frames : of the links at zero readings, in the same frame as `base`, each (4, 4)
    tool : the tip in the last link's frame, shape (4, 4)
    """

    base: Array
    rows: tuple[Joint, ...]
    frames: tuple[Array, ...]
    tool: Array


def rows_from_axes(axes: Sequence[Axis], tip: Array) -> Chain:
    """Modified DH rows of a chain given by its axes at zero readings, in a common frame, and its tip, shape (4, 4).

    Axes may be parallel, antiparallel, intersecting or coincident.
    """
    # Frame 0: z along the first axis, origin where it passes the given frame's, x turned like that one's.
    z = axes[0].direction
    x = _sideways(np.eye(3), z)
    T = base = frame(np.column_stack([x, np.cross(z, x), z]), axes[0].point - (axes[0].point @ z) * z)
    rows, frames = [], []
    row = Joint()
    for k in range(len(axes)):
        entry = T @ row_matrix(row)
        if k + 1 < len(axes):
            row, following = _towards(row, np.linalg.inv(entry), axes[k + 1])
        else:
            # The last row: its origin beside the tip's, x turned like the tip's.
            end = np.linalg.inv(entry) @ tip
            x = _sideways(end[:3, :3], np.array([0.0, 0.0, 1.0]))
            row = replace(row, theta=_tidy(np.arctan2(x[1], x[0])), d=_tidy(end[2, 3]))
        T = T @ row_matrix(row)
        rows.append(row)
        frames.append(T)
        row = following if k + 1 < len(axes) else row
    return Chain(base, tuple(rows), tuple(frames), np.linalg.inv(T) @ tip)


def frames_at_zero(rows: Sequence[Joint]) -> list[Array]:
    """Frames of all links at zero readings, in the base frame, each (4, 4) [m]."""
    return list(accumulate(map(row_matrix, rows), operator.matmul))


def row_matrix(row: Joint) -> Array:
    """Frame i in frame i-1 at zero reading, shape (4, 4) [m]."""
    return np.array(
        rot_x(row.alpha)
        @ translate(row.a, 0, 0)
        @ rot_y(row.beta or 0.0)
        @ translate(0, row.b or 0.0, 0)
        @ rot_z(row.theta)
        @ translate(0, 0, row.d)
    )


def _sideways(R: Array, z: Array) -> Array:
    """The x axis of R, or its y axis where x is nearly along z, made perpendicular to z; shape (3,)."""
    x = R[:, 0] if abs(R[:, 0] @ z) < np.sqrt(0.75) else R[:, 1]
    x = x - (x @ z) * z
    return np.asarray(x / np.linalg.norm(x))


def _towards(row: Joint, to_entry: Array, axis: Axis) -> tuple[Joint, Joint]:
    """The row with theta and d that point x at the next axis, and the beginning of the next row.

    to_entry : shape (4, 4), from the common frame to that of the row without theta and d
    """
    p = to_entry[:3, :3] @ axis.point + to_entry[:3, 3]
    z = to_entry[:3, :3] @ axis.direction
    if np.hypot(z[0], z[1]) < np.sin(NEAR_PARALLEL_RAD):
        return _hayati(row, p, z)
    return _craig(row, p, z)


def _craig(row: Joint, p: Array, z: Array) -> tuple[Joint, Joint]:
    """By the common normal of the z axis and the line p + t z."""
    sine, cosine = np.hypot(z[0], z[1]), z[2]
    normal = np.array([-z[1], z[0], 0.0]) / sine
    a = p @ normal
    d = (p[2] - (p @ z) * cosine) / sine**2
    theta, alpha = np.arctan2(normal[1], normal[0]), np.arctan2(sine, cosine)
    # m: a shorter common normal is rounding in the file, its sign means nothing
    backwards = abs(theta) > np.pi / 2 + NOISE if abs(a) < 1e-5 else a < 0
    if backwards:
        theta, a, alpha = theta - np.copysign(np.pi, theta), -a, -alpha
    return replace(row, theta=_tidy(theta), d=_tidy(d)), Joint(alpha=_tidy(alpha), a=_tidy(a))


def _hayati(row: Joint, p: Array, z: Array) -> tuple[Joint, Joint]:
    """By the point where the line p + t z, nearly parallel to the z axis, meets the x-y plane."""
    foot = p - (p[2] / z[2]) * z
    a = np.hypot(foot[0], foot[1])
    # m: nearer axes have no direction between them
    theta = np.arctan2(foot[1], foot[0]) if a > 1e-12 else 0.0
    c, s = np.cos(theta), np.sin(theta)
    beta = np.arcsin(c * z[0] + s * z[1])
    alpha = np.arctan2(s * z[0] - c * z[1], z[2])
    return replace(row, theta=_tidy(theta)), Joint(alpha=_tidy(alpha), a=_tidy(a), beta=_tidy(beta))


def _tidy(value: float) -> float:
    return 0.0 if abs(value) < NOISE else float(value)

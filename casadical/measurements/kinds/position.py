"""Measured positions and orientations of the tool, absolute or relative to another pose."""

from itertools import pairwise
from typing import ClassVar

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.linear_gaussian.noise import whitening_of
from casadical.core.transforms import Symbolic, from_quaternion, from_rpy, from_xyz
from casadical.measurements.columns import ORIENTATION, Columns
from casadical.measurements.corners import INTRINSICS, Images
from casadical.measurements.kinds.base import Arrays, MeasurementKind, PoseExpression, PositionsAt
from casadical.measurements.kinds.distance import other_poses


class Position(MeasurementKind):
    """Position of the measured point in the measuring frame."""

    name = "position"
    columns = "`x_mm, y_mm, z_mm` (or `_m`)"
    fill: ClassVar[tuple[str, ...]] = ("x_mm", "y_mm", "z_mm")
    pattern = "[xyz]_mm?"
    signs: ClassVar[tuple[str, ...]] = ("x_mm?",)
    arrays: ClassVar[tuple[str, ...]] = ("position",)
    lengths = 3

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Return the array `position` in the measuring frame, shape (n, 3) [m]."""
        return {"position": columns.vector("")}

    def residual(self, pose: PoseExpression) -> Symbolic:
        """Return the model's position minus the measured one, shape (3,) [m]."""
        return pose.p - pose.take("position", 3)

    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        """Return the distance of the model's positions from the measured ones, shape (n,) [m]."""
        return np.asarray(np.linalg.norm(p - arrays["position"], axis=1))

    def unit_fault(self, arrays: Arrays, p: Array, positions_at: PositionsAt, reach: float) -> str:
        """Return a sentence if the measured positions must be in another unit, else an empty text.

        Their extent is compared with that of the model's positions p, shape (n, 3) [m].
        """
        measured, moved = (float(np.linalg.norm(np.ptp(x, axis=0))) for x in (arrays["position"], p))
        if measured > 20 * reach:
            return (
                f"positions spread over {measured:.4g} m, but the robot reaches {reach:.3g} m; "
                "are they millimetres? name the columns x_mm, y_mm, z_mm"
            )
        if measured < 0.02 * moved:
            return (
                f"positions spread over {1e3 * measured:.4g} mm only, the model over "
                f"{1e3 * moved:.4g} mm; are they metres? name the columns x_m, y_m, z_m"
            )
        return ""


class PositionCovariance(Position):
    """Position of the measured point, each with its own covariance.

    With the Cholesky factor C = L L', the residual is s L^-1 (model - measurement), where s is the
    typical standard deviation of a coordinate. So its noise has the same size in all directions and
    at all poses.
    """

    name = "position_covariance"
    columns = "those of `position` and `cov_xx_mm2, cov_xy_mm2, cov_xz_mm2, cov_yy_mm2, cov_yz_mm2, cov_zz_mm2`"
    fill = ("x_mm", "y_mm", "z_mm")
    pattern = "[xyz]_mm?|cov_(xx|xy|xz|yy|yz|zz)_mm2"
    signs = ("x_mm?", "cov_xx_mm2")
    arrays: ClassVar[tuple[str, ...]] = ("position", "whitening")

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Return arrays `position`, shape (n, 3) [m], and `whitening`, shape (n, 3, 3).

        Raises InputError: a covariance that is not positive definite.
        """
        entries = ("xx", "xy", "xz", "yy", "yz", "zz")
        xx, xy, xz, yy, yz, zz = (1e-6 * columns.column(f"cov_{entry}_mm2") for entry in entries)
        covariance = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
        smallest = np.linalg.eigvalsh(covariance)[:, 0]
        if (smallest <= 0).any():
            row = int(np.argmin(smallest))
            raise InputError(
                f"{columns.at(row)}, columns cov_xx_mm2 to cov_zz_mm2: no covariance (its smallest "
                f"variance is {1e6 * smallest[row]:.3g} mm2); allowed: symmetric, positive definite"
            )
        return {**super().read(columns, q), "whitening": whitening(covariance)}

    def residual(self, pose: PoseExpression) -> Symbolic:
        """Return the whitened model position minus the measured one, shape (3,) [m]."""
        residual = super().residual(pose)
        return ca.reshape(pose.take("whitening", 9), 3, 3).T @ residual


def whitening(covariance: Array) -> Array:
    """Return matrices W, shape (n, 3, 3), with which W times a position error is white noise.

    Its standard deviation is `typical_sigma` of a coordinate, at all poses.

    covariance : shape (n, 3, 3) [m^2]
    """
    return np.asarray(typical_sigma(covariance) * whitening_of(covariance)[0])


def typical_sigma(covariance: Array) -> float:
    """Return the root of the mean variance of a coordinate over all poses [m].

    covariance : shape (n, 3, 3) [m^2]
    """
    return float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean() / 3))


# Pattern of the first column of each representation of an orientation.
FIRST_ORIENTATION_COLUMN = "(rx|rotvec_x|roll)_(deg|rad)|R00|qw"


class Pose(Position):
    """Pose in the measuring frame; the reported error is that of the position."""

    name = "pose"
    columns = (
        "those of `position` and one of `qw, qx, qy, qz`, `R00` .. `R22`, `rotvec_x_rad, "
        "rotvec_y_rad, rotvec_z_rad` (axis times angle), `roll_deg, pitch_deg, yaw_deg` (about the "
        "fixed x, y, z), or `rx_deg, ry_deg, rz_deg` (about x, then the new y, then the new z); "
        "angles in `_deg` or `_rad`"
    )
    fill: ClassVar[tuple[str, ...]] = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
    pattern = f"{Position.pattern}|{ORIENTATION}"
    signs: ClassVar[tuple[str, ...]] = ("x_mm?", FIRST_ORIENTATION_COLUMN)
    arrays = ("position", "orientation")
    angles = 3

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Return arrays `position`, shape (n, 3) [m], and `orientation`, shape (n, 3, 3)."""
        return {**super().read(columns, q), "orientation": orientations(columns)}

    def of(self, arrays: Arrays) -> MeasurementKind:
        """Return the kind whose residual is whitened, where the arrays have `whitening`."""
        return _WHITENED_POSE if "whitening" in arrays else self

    def residual(self, pose: PoseExpression) -> Symbolic:
        """Return model minus measurement: position (3 numbers [m]), then rotation (3 [rad])."""
        return ca.vertcat(super().residual(pose), turned_off(pose.R, pose.take("orientation", 9)))


class Corners(Pose):
    """Corners of a board in images, which are poses whose residuals are the reprojection errors (see `corners`)."""

    name = "corners"
    columns = (
        "a row for each corner of a board in an image, with the joint readings of its station: `u_px, v_px`, and its "
        "place on the board, `board_x_mm, board_y_mm`; `intrinsics` in problem.toml, or the columns `fx_px, fy_px, "
        "cx_px, cy_px` and `lens_k1, lens_k2, lens_p1, lens_p2, lens_k3`"
    )
    fill = ()
    pattern = r"corners|[uv]_px|board_[xyz]_mm?|[fc][xy]_px|lens_[kp][123]"
    signs = ("corners",)
    gives = "pose"

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Return the board's poses in the camera as of kind pose, and the arrays of `Images`.

        Raises InputError: no intrinsics.
        """
        assert columns.corners is not None
        if lacking := [name for name in INTRINSICS[:4] if name not in columns.table]:
            raise InputError(
                f"{columns.source}: corners in images, and {', '.join(lacking)} missing; say in [[measurements]] of "
                "problem.toml, for example, intrinsics = { fx = 900.0, fy = 900.0, cx = 640.0, cy = 360.0 } (and "
                "distortion = [k1, k2, p1, p2, k3])"
            )
        zero = np.zeros(len(columns.row))
        given = [columns.column(name) if name in columns.table else zero for name in INTRINSICS]
        T, images = Images(columns.corners, np.column_stack(given), np.zeros(0)).posed()
        return {"position": T[:, :3, 3], "orientation": T[:, :3, :3], **images._asdict()}


class _WhitenedPose(Pose):
    """Pose of a camera whose noise is in its own axes (see `camera_noise`)."""

    def residual(self, pose: PoseExpression) -> Symbolic:
        """Return the residual of a pose along the camera's axes, each scaled to the usual noise.

        It is three lengths [m] and three angles [rad], whose noise is independent and has one sigma
        for all lengths and one for all angles (see `camera_noise.whitening`).
        """
        residual = super().residual(pose)
        return ca.reshape(pose.take("whitening", 36), 6, 6).T @ residual


# The one instance, by which compiled functions are cached.
_WHITENED_POSE = _WhitenedPose()


def turned_off(R: Symbolic, measured: Symbolic) -> Symbolic:
    """Return the rotation vector from a measured orientation to R, shape (3,) [rad].

    It is in the axes of the measured orientation, and exact to second order in the angle.

    R : modelled orientation, shape (3, 3); measured : nine numbers, row by row
    """
    # CasADi fills by columns, so this is the transpose of the measured orientation.
    E = ca.reshape(measured, 3, 3) @ R
    # sin(angle) times the axis: it is smooth and differs from the rotation vector in third order.
    return 0.5 * ca.vertcat(E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1])


def orientations(columns: Columns) -> Array:
    """Return the orientations of a table as rotation matrices, shape (n, 3, 3).

    They are read from whichever columns there are: matrix, quaternion or angles. Raises InputError:
    a quaternion that is not a unit one, or a matrix that is no rotation.
    """
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
        R = _from_angles(columns)
    off = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) + (np.linalg.det(R) < 0)
    if off.max() > 1e-3:
        row = int(off.argmax())
        raise InputError(
            f"{columns.at(row)}, columns 'R00' to 'R22': no rotation (R R' differs from one by "
            f"{off[row]:.3g}, mirrored ones by more than one); allowed: orthonormal matrices, "
            "right-handed"
        )
    return R


def _from_angles(columns: Columns) -> Array:
    """Return rotation matrices, shape (n, 3, 3), from columns of three angles (_deg, _rad).

    They are a rotation vector rotvec_*, or roll, pitch, yaw about the fixed x, y, z, or rx, ry, rz
    about x, the new y and the new z. Raises InputError where columns are missing.
    """
    from scipy.spatial.transform import Rotation

    units, names = ("_deg", "_rad"), {str(name).rpartition("_")[0] for name in columns.table}
    if "rotvec_x" in names:
        vector = columns.vector("rotvec_", units)
        return np.asarray(Rotation.from_rotvec(vector).as_matrix())
    if "roll" in names:
        angles = np.stack([columns.si(name, units) for name in ("roll", "pitch", "yaw")], axis=1)
        return from_rpy(angles)
    return from_xyz(columns.vector("r", units))


class RelativePose(MeasurementKind):
    """Pose of the tool in the tool's own frame at another pose, or at that of the row before.

    The reported error is that of the distance between the two.
    """

    name = "relative_pose"
    columns = (
        "`dx_mm, dy_mm, dz_mm` (or `_m`) and an orientation as of `pose`: of the tool in its frame "
        "at another pose, by `pose` and `other_pose`, or else that of the row before; all of the "
        "first row is zero"
    )
    pattern = f"d[xyz]_mm?|{ORIENTATION}"
    signs = ("dx_mm?",)
    arrays = ("shift", "turn", "other")
    fill = ("dx_mm", "dy_mm", "dz_mm", "qw", "qx", "qy", "qz")
    lengths = 3
    angles = 3

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Return `shift` (n, 3) [m], `turn` (n, 3, 3), `other` (n, joints), and `counted` (n,).

        Shift and rotation are of the tool in its own frame at the other pose, whose joint variables
        [rad or m] are `other`; `counted`, absent where a column names other poses, is 0 for rows
        that have none, else 1.
        Raises InputError: a first row with a shift or rotation, though no row is before it.
        """
        arrays = {"shift": columns.vector("d"), "turn": orientations(columns)}
        if "other_pose" in columns.table:
            return arrays | {"other": q[other_poses(columns)]}
        gone = np.array(columns.left_out)
        begins = np.array([((last < gone) & (gone < row)).any() for last, row in pairwise([0, *columns.row])])
        begun = max(np.abs(arrays["shift"][0]).max(), np.abs(arrays["turn"][0] - np.eye(3)).max())
        if begun > 0 and not begins[0]:
            raise InputError(
                f"{columns.at(0)}: has no row before that it could be relative to, but a shift or "
                "a turn; give zeros there, or name the other pose of each row in `pose` and "
                "`other_pose`"
            )
        before = np.maximum(np.arange(len(q)) - 1, 0)
        begins[0] = True
        return arrays | {"other": q[before], "counted": (~begins).astype(float)}

    def residual(self, pose: PoseExpression) -> Symbolic:
        """Return model minus measurement: shift (3 numbers [m]), then rotation (3 [rad])."""
        p, R = pose.pose_at(pose.take("other", pose.joints))
        shift = R.T @ (pose.p - p) - pose.take("shift", 3)
        return ca.vertcat(shift, turned_off(R.T @ pose.R, pose.take("turn", 9)))

    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        """Return the absolute errors of the distance between the two poses, shape (n,) [m]."""
        way = np.linalg.norm(p - positions_at(arrays["other"]), axis=1)
        return np.asarray(np.abs(way - np.linalg.norm(arrays["shift"], axis=1)))

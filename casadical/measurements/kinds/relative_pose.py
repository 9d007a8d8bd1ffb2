"""Measured motions: where the tool is, seen from where it was at another pose."""

from collections.abc import Set
from itertools import pairwise

import casadi as ca
import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.core.transforms import Symbolic
from casadical.measurements.columns import ORIENTATION, Columns
from casadical.measurements.kinds.base import Arrays, MeasurementKind, PoseExpression, PositionsAt
from casadical.measurements.kinds.pair_distance import other_poses
from casadical.measurements.kinds.pose import orientations, turned_off


class RelativePose(MeasurementKind):
    """Position and orientation of the tool in its own frame at another pose, or at that of the row before.

    The reported error is that of the way between the two.
    """

    name = "relative_pose"
    columns = (
        "`dx_mm, dy_mm, dz_mm` (or `_m`) and an orientation as of `pose`: of the tool in its frame at another pose, by "
        "`pose` and `other_pose`, or else that of the row before; all of the first row, which has none, is zero, and a "
        "row behind one that is left out does not count"
    )
    pattern = f"d[xyz]_mm?|{ORIENTATION}"
    arrays = ("shift", "turn", "other")
    fill = ("dx_mm", "dy_mm", "dz_mm", "qw", "qx", "qy", "qz")
    lengths = 3
    angles = 3

    def matches(self, names: Set[str]) -> bool:
        return bool(names & {"dx_mm", "dx_m"})

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Shifts [m], turns, readings at the other end. Raises InputError: a first row that begins elsewhere."""
        arrays = {"shift": columns.vector("d"), "turn": orientations(columns)}
        if "other_pose" in columns.table:
            return arrays | {"other": q[other_poses(columns)]}
        gone = np.array(columns.left_out)
        begins = np.array([((last < gone) & (gone < row)).any() for last, row in pairwise([0, *columns.row])])
        begun = max(np.abs(arrays["shift"][0]).max(), np.abs(arrays["turn"][0] - np.eye(3)).max())
        if begun > 0 and not begins[0]:
            raise InputError(
                f"{columns.at(0)}: has no row before that it could be relative to, but a shift or a turn; give zeros "
                "there, or name the other pose of each row in `pose` and `other_pose`"
            )
        before = np.maximum(np.arange(len(q)) - 1, 0)
        begins[0] = True
        return arrays | {"other": q[before], "counted": (~begins).astype(float)}

    def residual(self, pose: PoseExpression) -> Symbolic:
        p, R = pose.pose_at(pose.take("other", pose.joints))
        shift = R.T @ (pose.p - p) - pose.take("shift", 3)
        return ca.vertcat(shift, turned_off(R.T @ pose.R, pose.take("turn", 9)))

    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        way = np.linalg.norm(p - positions_at(arrays["other"]), axis=1)
        return np.asarray(np.abs(way - np.linalg.norm(arrays["shift"], axis=1)))

    def at_rest(self, arrays: Arrays) -> bool:
        return False

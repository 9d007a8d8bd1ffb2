"""Measured distances between the tool's positions at two poses."""

from collections.abc import Set

import casadi as ca
import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.core.transforms import Symbolic
from casadical.measurements.columns import Columns
from casadical.measurements.kinds.base import Arrays, MeasurementKind, PoseExpression, PositionsAt
from casadical.measurements.kinds.distance import distance_errors, distance_fault, positive_distances


class PairDistance(MeasurementKind):
    """Distance to where the measured point is at another pose of the table, under the same conditions."""

    name = "pair_distance"
    columns = "`distance_mm` (or `_m`) to where the tool is at another pose: `pose` and `other_pose`"
    fill = ("other_pose", "distance_mm")
    pattern = "distance_mm?"
    arrays = ("distance", "other")
    lengths = 1

    def matches(self, names: Set[str]) -> bool:
        return bool(names & {"distance_mm", "distance_m"}) and "other_pose" in names

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Distances [m], and readings at their other ends. Raises InputError: a pose that is not in the table."""
        return {"distance": positive_distances(columns), "other": q[other_poses(columns)]}

    def residual(self, pose: PoseExpression) -> Symbolic:
        return ca.norm_2(pose.p - pose.position_at(pose.take("other", pose.joints))) - pose.take("distance", 1)

    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        return distance_errors(arrays, p, positions_at(arrays["other"]))

    def at_rest(self, arrays: Arrays) -> bool:
        return False

    def unit_fault(self, arrays: Arrays, p: Array, positions_at: PositionsAt, reach: float) -> str:
        return distance_fault(arrays, p, positions_at(arrays["other"]), reach)


def other_poses(columns: Columns) -> Array:
    """Which row is the pose in `other_pose`, shape (n,). Raises InputError: it is in no row, in two, or the same."""
    pose, other = columns.column("pose"), columns.column("other_pose")
    where = {float(p): k for k, p in enumerate(pose)}
    if len(where) < len(pose):
        row = next(k for k, p in enumerate(pose) if where[float(p)] != k)
        raise InputError(
            f"{columns.at(row)}, column 'pose': {pose[row]:g} occurs again in row "
            f"{columns.row[where[float(pose[row])]]}; allowed: each pose's own number"
        )
    if (pose == other).any():
        row = int(np.argmax(pose == other))
        raise InputError(f"{columns.at(row)}, column 'other_pose': {other[row]:g} is that pose itself")
    missing = [k for k, o in enumerate(other) if float(o) not in where]
    if missing:
        raise InputError(
            f"{columns.at(missing[0])}, column 'other_pose': {other[missing[0]]:g} is no pose of this "
            "table; allowed: the numbers in column 'pose'"
        )
    return np.array([where[float(o)] for o in other])

"""Distances from the tool to a fixed point (an anchor), or between its positions at two poses."""

from typing import ClassVar

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.levenberg_marquardt import Evaluated, levenberg_marquardt
from casadical.core.statistics import first_of_best
from casadical.core.transforms import Symbolic
from casadical.measurements.columns import Columns
from casadical.measurements.kinds.base import Arrays, MeasurementKind, PoseExpression, PositionsAt
from casadical.measurements.kinds.contact import OfPoints, labels_of


class Distance(OfPoints):
    """Distance from the measured point to an anchor, which is given or identified too."""

    name = "distance"
    columns = (
        "`distance_mm` (or `_m`) to a point: known `to_x_mm, to_y_mm, to_z_mm` (or `_m`), or none "
        "of these; of several unknown ones `anchor` names each row's"
    )
    unknown = "the point, or each of several"
    fill: ClassVar[tuple[str, ...]] = ("distance_mm",)
    pattern = "distance_mm?|to_[xyz]_mm?|anchor"
    signs: ClassVar[tuple[str, ...]] = ("distance_mm?",)
    arrays: ClassVar[tuple[str, ...]] = ("distance",)
    lengths = 1
    point_array = "target"
    alone = "far end"

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Return `distance` (n,) [m] and, where given, `target` (n, 3) [m] and `label` (n,).

        They are the anchors' positions in the measuring frame and their names.
        """
        arrays = {"distance": positive_lengths(columns, "distance")}
        if any(str(name).startswith("to_x") for name in columns.table):
            arrays["target"] = columns.vector("to_")
        if "anchor" in columns.table:
            arrays["label"] = labels_of(columns, "anchor", "it names the far end of each distance")
        return arrays

    def residual(self, pose: PoseExpression) -> Symbolic:
        """Return the model's distance from the anchor minus the measured one, one number [m]."""
        line = pose.p - pose.take("target", 3) if pose.point is None else pose.from_point()
        return ca.norm_2(line) - pose.take("distance", 1)

    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        """Return the absolute errors of the distances, shape (n,) [m]."""
        return distance_errors(arrays, p, arrays["target"] if "target" in arrays else self.point_starts(arrays, p))

    def start(self, arrays: Arrays, p: Array) -> Array:
        """Return the position of one anchor that fits its distances best, shape (3,) [m].

        Single wrong distances, at most a fifth of 8 or more, are omitted: by least squares one of
        300 mm would move the anchor so far that all seem wrong. Two among ten may hide each other.

        p : positions of the model in the measuring frame, shape (n, 3) [m]
        """
        distance, found = arrays["distance"], _far_end(arrays["distance"], p)
        for _ in range(len(p) // 5 if len(p) >= 8 else 0):
            line = found - p
            length = np.linalg.norm(line, axis=1)
            J, e = line / length[:, None], distance - length
            leverage = np.einsum("ni,ij,nj->n", J, np.linalg.pinv(J.T @ J), J)
            gain = e**2 / np.maximum(1 - leverage, 1e-6)  # by which the sum of squares falls without the row
            worst = first_of_best(gain)
            # Ten standard deviations of the others, and more than rounding [m^2].
            if gain[worst] <= max(100 * (e @ e - gain[worst]) / (len(p) - 4), 1e-12):
                break
            distance, p = np.delete(distance, worst), np.delete(p, worst, axis=0)
            found = _far_end(distance, p)
        return found

    def unit_fault(self, arrays: Arrays, p: Array, positions_at: PositionsAt, reach: float) -> str:
        """Return a sentence if the distances must be in another unit, else an empty text.

        For an unknown anchor this is decided by how much distances to it can differ.
        """
        if "target" in arrays:
            return distance_fault(arrays, p, arrays["target"], reach)
        # For an unknown anchor, two distances differ by no more than the tool moves.
        moved = float(np.linalg.norm(np.ptp(p, axis=0)))
        distance = arrays["distance"]
        return _fault(distance, reach, np.ptp(distance) > 20 * reach, distance.max() < 0.02 * moved)


def _far_end(distance: Array, p: Array) -> Array:
    """Return the point whose distances from the points p fit best, in their frame, (3,) [m].

    First |p|^2 - L^2 = 2 p.P - |P|^2 is solved by least squares, with |P|^2 as one more unknown;
    then Levenberg-Marquardt steps on the distances follow. If all p lie in a plane, only the
    anchor's distance from that plane is determined, not its side.

    distance : shape (n,) [m]; p : positions of the measured point, shape (n, 3) [m]
    """
    centre = p.mean(axis=0)
    local = p - centre
    A = np.column_stack([2 * local, -np.ones(len(p))])
    *start, square = np.linalg.lstsq(A, (local**2).sum(axis=1) - distance**2, rcond=None)[0]
    P = np.array(start)
    spread, axes = np.linalg.svd(local, full_matrices=False)[1:]
    # If the third singular value is below this share of the second, the points lie in a plane.
    if len(axes) == 3 and spread[2] < 1e-6 * spread[1]:
        P += np.sqrt(max(square - P @ P, 0.0)) * axes[2]
    # A pose closer to the anchor than this coincides with it [m].
    if np.linalg.norm(P - local, axis=1).min() < 1e-6:  # too few poses: a length of zero has no direction
        P = np.array([0.0, 0.0, distance.mean()])

    def evaluate(anchors: Array) -> Evaluated:
        """Return the sum of squares [m^2] of each trial anchor, and a function of normal equations.

        anchors : shape (k, 3) [m], relative to the mean of p
        """
        line = anchors[:, None] - local
        length = np.linalg.norm(line, axis=2)
        residual = distance - length

        def sums(some: Array) -> tuple[Array, Array]:
            J = line[some] / length[some, :, None]
            return J.transpose(0, 2, 1) @ J, np.einsum("kni,kn->ki", J, residual[some])

        return (residual**2).sum(axis=1), sums

    scale = lambda diagonal: diagonal + 1e-9  # noqa: E731
    *_, end = levenberg_marquardt(evaluate, P[None], 20, scale=scale, absolute=1e-12)
    return np.asarray(end.point[0] + centre)


def positive_lengths(columns: Columns, name: str) -> Array:
    """Return the column NAME_mm or NAME_m, shape (n,) [m].

    Raises InputError: it is missing, or a length is not positive."""
    lengths = columns.si(name, ("_mm", "_m"))
    if (lengths <= 0).any():
        row = int(np.argmax(lengths <= 0))
        raise InputError(
            f"{columns.at(row)}, column {name!r}: {1e3 * lengths[row]:.4g} mm; a {name} must be "
            "positive (poses at one point are kind 'contact')"
        )
    return lengths


def distance_errors(arrays: Arrays, p: Array, far: Array) -> Array:
    """Return |distance from p to far - measured distance|, shape (n,) [m].

    p, far : points in the measuring frame, shape (n, 3) [m]
    """
    return np.asarray(np.abs(np.linalg.norm(p - far, axis=1) - arrays["distance"]))


def distance_fault(arrays: Arrays, p: Array, far: Array, reach: float) -> str:
    """Return a sentence if measured distances must be in another unit, else an empty text.

    p, far : points of the model between which they were measured, in the measuring frame, shape
        (n, 3) [m]; reach : of the robot [m]
    """
    distance = arrays["distance"]
    ratio = np.median(distance) / max(float(np.median(np.linalg.norm(p - far, axis=1))), 1e-3)
    return _fault(distance, reach, ratio > 100, ratio < 0.01)


def _fault(distance: Array, reach: float, too_long: bool, too_short: bool) -> str:
    """Return a sentence on distances in another unit; empty if neither flag is set.

    distance : measured, shape (n,) [m]; reach : of the robot [m]
    too_long : whether metres are assumed and mm meant; too_short : the reverse
    """
    if not (too_long or too_short):
        return ""
    used, other = ("metres", "mm") if too_long else ("millimetres", "m")
    return (
        f"distances up to {distance.max():.4g} m do not fit the robot, which reaches {reach:.3g} "
        f"m; they are taken as {used}: should the column be named distance_{other}?"
    )


class PairDistance(MeasurementKind):
    """Distance between the measured point at two poses of the table, under the same conditions."""

    name = "pair_distance"
    columns = "`distance_mm` (or `_m`) to where the tool is at another pose: `pose` and `other_pose`"
    fill = ("other_pose", "distance_mm")
    pattern = "distance_mm?"
    signs = ("distance_mm?", "other_pose")
    arrays = ("distance", "other")
    lengths = 1

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Return `distance`, shape (n,) [m], and `other`, the joint variables at the other pose.

        The latter have shape (n, joints) [rad or m].
        Raises InputError: a pose that is not in the table, or a distance that is not positive.
        """
        return {"distance": positive_lengths(columns, "distance"), "other": q[other_poses(columns)]}

    def residual(self, pose: PoseExpression) -> Symbolic:
        """Return the model's distance between both poses minus the measured one, one number [m]."""
        return ca.norm_2(pose.p - pose.position_at(pose.take("other", pose.joints))) - pose.take("distance", 1)

    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        """Return the absolute errors of the distances, shape (n,) [m]."""
        return distance_errors(arrays, p, positions_at(arrays["other"]))

    def unit_fault(self, arrays: Arrays, p: Array, positions_at: PositionsAt, reach: float) -> str:
        """Return a sentence if the distances must be in another unit, else an empty text."""
        return distance_fault(arrays, p, positions_at(arrays["other"]), reach)


def other_poses(columns: Columns) -> Array:
    """Return the index of the row whose `pose` is in each row's `other_pose`, shape (n,).

    Raises InputError: the pose is in no row, in two, or the same.
    """
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
            f"{columns.at(missing[0])}, column 'other_pose': {other[missing[0]]:g} is no pose of "
            "this table; allowed: the numbers in column 'pose'"
        )
    return np.array([where[float(o)] for o in other])

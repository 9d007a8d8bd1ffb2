"""Poses that touch a plane, whose place is unknown."""

from collections.abc import Sequence, Set

import casadi as ca
import numpy as np

from casadical.core.arrays import Array
from casadical.core.transforms import Symbolic
from casadical.measurements.columns import Columns
from casadical.measurements.kinds.base import Arrays, MeasurementKind, PoseExpression, PositionsAt
from casadical.measurements.kinds.contact import each_label, touched_often

# Three touches define a plane; from so many on they tell of the robot.
FEWEST = 4


class Plane(MeasurementKind):
    """Contact of the measured point with planes that are identified too, by their labels.

    A plane of unit normal n at the distance d >= 0 from the frame's origin is the unknown point (1 m + d) n, which has
    a direction wherever the plane lies. The reported error is the distance from the plane that fits all its poses best.
    """

    name = "plane"
    columns = "`plane`: poses of the same name touch the same plane with the measured point"
    unknown = "the planes"
    fill = ("plane",)
    pattern = "plane"
    arrays = ("label",)
    lengths = 1
    places = False
    has_scale = False
    touches = True

    def matches(self, names: Set[str]) -> bool:
        return "plane" in names

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Labels of the planes. Raises InputError: an empty label, or a plane that is touched too few times."""
        remedy = f"three touches only say where the plane is: touch it at {FEWEST} poses at least"
        return {"label": touched_often(columns, "plane", FEWEST, "it says which plane each pose touches", remedy)}

    def residual(self, pose: PoseExpression) -> Symbolic:
        point = pose.unknown_point()
        length = ca.norm_2(point)
        return ca.dot(pose.p, point) / length - (length - 1)

    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        point = self.point_starts(arrays, p)
        length = np.linalg.norm(point, axis=1)
        return np.asarray(np.abs((p * point).sum(axis=1) / length - (length - 1)))

    def at_rest(self, arrays: Arrays) -> bool:
        return False

    def point_names(self, arrays: Arrays) -> Sequence[str]:
        return list(arrays["label"])

    def point_starts(self, arrays: Arrays, p: Array) -> Array:
        out = np.empty_like(p)
        for own in each_label(arrays["label"]):
            middle = p[own].mean(axis=0)
            normal = np.linalg.svd(p[own] - middle)[2][2]
            d = float(normal @ middle)
            out[own] = (1 + abs(d)) * (normal if d >= 0 else -normal)
        return out

    def grown(self, points: Array, origin: Array) -> Array:
        length = np.linalg.norm(points, axis=1, keepdims=True)
        normal = points / length
        return np.asarray((length - 1 - normal @ origin[:, None]) * normal)

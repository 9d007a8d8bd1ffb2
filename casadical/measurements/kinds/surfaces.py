"""Poses that touch a surface whose place is unknown: a plane, or a ball of known radius."""

from collections.abc import Set
from typing import ClassVar

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.transforms import Symbolic
from casadical.measurements.columns import Columns
from casadical.measurements.kinds.base import Arrays, PoseExpression, PositionsAt
from casadical.measurements.kinds.contact import OfPoints, touched_often
from casadical.measurements.kinds.distance import Distance, positive_lengths

# Three touches define a plane; from so many on they tell of the robot.
PLANE_TOUCHES = 4


class Plane(OfPoints):
    """Contact of the measured point with planes that are identified too, by their labels.

    A plane of unit normal n at the distance d >= 0 from the frame's origin is the unknown point (1 m + d) n, which has
    a direction wherever the plane lies. The reported error is the distance from the plane that fits all its poses best.

    lever : of the unknown point, in place of 1 m
    """

    name = "plane"
    columns = "`plane`: poses of the same name touch the same plane with the measured point"
    unknown = "the planes"
    fill: ClassVar[tuple[str, ...]] = ("plane",)
    pattern = "plane"
    arrays: ClassVar[tuple[str, ...]] = ("label",)
    lengths = 1
    places = False
    has_scale = False
    touches = True
    lever = 1.0

    def matches(self, names: Set[str]) -> bool:
        return "plane" in names

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Labels of the planes. Raises InputError: an empty label, or a plane that is touched too few times."""
        remedy = f"three touches only say where the plane is: touch it at {PLANE_TOUCHES} poses at least"
        label = touched_often(columns, "plane", PLANE_TOUCHES, "it says which plane each pose touches", remedy)
        return {"label": label}

    def residual(self, pose: PoseExpression) -> Symbolic:
        point = pose.unknown_point()
        length = ca.norm_2(point)
        return ca.dot(pose.p, point) / length - (length - self.lever)

    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        return np.asarray(np.abs(self.heights(arrays, p)))

    def heights(self, arrays: Arrays, p: Array) -> Array:
        """Distances from the best plane of each label, signed, shape (n,) [m]; p : shape (n, 3) [m]"""
        point = self.point_starts(arrays, p)
        length = np.linalg.norm(point, axis=1)
        return np.asarray((p * point).sum(axis=1) / length - (length - self.lever))

    def start(self, arrays: Arrays, p: Array) -> Array:
        middle = p.mean(axis=0)
        normal = np.linalg.svd(p - middle)[2][2]
        d = float(normal @ middle)
        return np.asarray((1 + abs(d)) * (normal if d >= 0 else -normal))

    def grown(self, points: Array, origin: Array) -> Array:
        length = np.linalg.norm(points, axis=1, keepdims=True)
        normal = points / length
        return np.asarray((length - 1 - normal @ origin[:, None]) * normal)


# Four touches define the centre of a ball and its radius; from so many on they tell of the robot.
BALL_TOUCHES = 5
# Radii beyond so many reaches of the robot are in another unit.
LARGEST = 20.0


class Sphere(Distance):
    """Contact of the measured point with balls whose centres are identified too, by their labels.

    It is the distance to the centre, which is as long as the radius.
    """

    name = "sphere"
    columns = (
        "`sphere`: poses of the same name touch the same ball; `radius_mm` (or `_m`) from its centre to the measured "
        "point: the ball's and the tip's together"
    )
    unknown = "the centres"
    fill: ClassVar[tuple[str, ...]] = ("sphere", "radius_mm")
    pattern = "sphere|radius_mm?"
    arrays: ClassVar[tuple[str, ...]] = ("distance", "label")
    by_row = False
    touches = True

    def matches(self, names: Set[str]) -> bool:
        return "sphere" in names

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Radii as distances [m], labels. Raises InputError: no radius, or a ball that is touched too few times."""
        if not {"radius_mm", "radius_m"} & set(columns.table):
            raise InputError(
                f"{columns.source}: column 'radius_mm' is missing; a ball tells nothing of the robot unless its radius "
                "is known: the ball's and the tip's together, from the data sheet or by a calliper"
            )
        radius = positive_lengths(columns, "radius")
        remedy = f"touch it at {BALL_TOUCHES} poses at least, all around"
        label = touched_often(columns, "sphere", BALL_TOUCHES, "it says which ball each pose touches", remedy)
        return {"distance": radius, "label": label}

    def unit_fault(self, arrays: Arrays, p: Array, positions_at: PositionsAt, reach: float) -> str:
        longest = float(arrays["distance"].max())
        if longest < LARGEST * reach:
            return ""
        return f"a radius of {longest:.4g} m does not fit the robot, which reaches {reach:.3g} m; is it radius_mm?"

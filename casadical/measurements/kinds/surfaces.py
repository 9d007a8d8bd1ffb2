"""Contact with unknown surfaces (planes, balls of given radius), and readings of gauges."""

from typing import ClassVar

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.transforms import Symbolic
from casadical.measurements.columns import Columns
from casadical.measurements.kinds.base import Arrays, PoseExpression, PositionsAt
from casadical.measurements.kinds.contact import OfPoints, each_label, labels_of, labels_touched_often
from casadical.measurements.kinds.distance import Distance, positive_lengths


class Plane(OfPoints):
    """Contact of the measured point with planes that are identified too, by their labels.

    A plane of unit normal n at the distance d >= 0 from the frame's origin is the unknown point
    (lever + d) n, which has a direction wherever the plane lies. The reported error is the distance
    from the plane that fits all its poses best.

    lever : length that is added to the distance [m]
    """

    name = "plane"
    columns = "`plane`: poses of the same name touch the same plane with the measured point"
    unknown = "the planes"
    fill: ClassVar[tuple[str, ...]] = ("plane",)
    pattern = "plane"
    signs: ClassVar[tuple[str, ...]] = ("plane",)
    arrays: ClassVar[tuple[str, ...]] = ("label",)
    lengths = 1
    places = False
    has_scale = False
    touches = True
    lever = 1.0

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Return the name of the plane that each pose touches, as the array `label`, shape (n,).

        Raises InputError: an empty label, or a plane that is touched too few times.
        """
        # Three touches determine the plane itself; only a fourth one carries information on the
        # robot.
        min_touches_per_plane = 4
        remedy = f"three touches only say where the plane is: touch it at {min_touches_per_plane} poses at least"
        label = labels_touched_often(
            columns, "plane", min_touches_per_plane, "it says which plane each pose touches", remedy
        )
        return {"label": label}

    def residual(self, pose: PoseExpression) -> Symbolic:
        """Return the signed distance of the measured point from its plane, one number [m]."""
        point = pose.unknown_point()
        length = ca.norm_2(point)
        return ca.dot(pose.p, point) / length - (length - self.lever)

    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        """Return the distance of each pose from its label's best plane, shape (n,) [m]."""
        return np.asarray(np.abs(self.heights(arrays, p)))

    def heights(self, arrays: Arrays, p: Array) -> Array:
        """Return the signed distance of each pose from its label's best plane, shape (n,) [m].

        p : positions in the measuring frame, shape (n, 3) [m]
        """
        point = self.point_starts(arrays, p)
        length = np.linalg.norm(point, axis=1)
        return np.asarray((p * point).sum(axis=1) / length - (length - self.lever))

    def start(self, arrays: Arrays, p: Array) -> Array:
        """Return the unknown point (see `Plane`) of the plane that fits p best, shape (3,) [m].

        p : positions of the model in the measuring frame, shape (n, 3) [m]
        """
        middle = p.mean(axis=0)
        normal = np.linalg.svd(p - middle)[2][2]
        d = float(normal @ middle)
        return np.asarray((1 + abs(d)) * (normal if d >= 0 else -normal))

    def grown(self, points: Array, origin: Array) -> Array:
        """Return the derivative of the planes' unknown points by a common scale, (K, 3) [m].

        points : unknown points, shape (K, 3) [m]; origin : fixed point of the scale, shape (3,) [m]
        """
        length = np.linalg.norm(points, axis=1, keepdims=True)
        normal = points / length
        return np.asarray((length - 1 - normal @ origin[:, None]) * normal)


class Sphere(Distance):
    """Contact of the measured point with balls whose centres are identified too, by their labels.

    It is a distance to the centre that equals the given radius.
    """

    name = "sphere"
    columns = (
        "`sphere`: poses of the same name touch the same ball; `radius_mm` (or `_m`) from its "
        "centre to the measured point: the ball's and the tip's together"
    )
    unknown = "the centres"
    fill: ClassVar[tuple[str, ...]] = ("sphere", "radius_mm")
    pattern = "sphere|radius_mm?"
    signs = ("sphere",)
    arrays: ClassVar[tuple[str, ...]] = ("distance", "label")
    touches = True

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Return the radii as `distance`, shape (n,) [m], and the balls' names as `label`, (n,).

        Raises InputError: no radius, or a ball that is touched too few times.
        """
        if not {"radius_mm", "radius_m"} & set(columns.table):
            raise InputError(
                f"{columns.source}: column 'radius_mm' is missing; a ball tells nothing of the "
                "robot unless its radius is known: the ball's and the tip's together, from the "
                "data sheet or by a calliper"
            )
        radius = positive_lengths(columns, "radius")
        # Minimum number of poses that touch one ball: one more than determine centre and radius.
        min_touches_per_sphere = 5
        remedy = f"touch it at {min_touches_per_sphere} poses at least, all around"
        label = labels_touched_often(
            columns, "sphere", min_touches_per_sphere, "it says which ball each pose touches", remedy
        )
        return {"distance": radius, "label": label}

    def unit_fault(self, arrays: Arrays, p: Array, positions_at: PositionsAt, reach: float) -> str:
        """Return a sentence if a radius must be in another unit, else an empty text."""
        longest = float(arrays["distance"].max())
        # A radius beyond 20 reaches of the robot must be in another unit.
        if longest < 20.0 * reach:
            return ""
        return f"a radius of {longest:.4g} m does not fit the robot, which reaches {reach:.3g} m; is it radius_mm?"


class Dial(Plane):
    """Reading of a gauge (dial, height probe, displacement sensor) along an axis.

    Along a given axis a reading is the coordinate in the measuring frame; an offset of its zero
    moves the base, if that is unknown. An unknown axis n, with its zero at the distance d from the
    frame's origin, is described by the unknown point (10 m + d) n. The reported error is that of
    the reading.
    """

    name = "dial"
    columns = (
        "`reading_mm` (or `_m`) that grows along an axis: known `along_x, along_y, along_z`, or "
        "none of these; of several gauges of unknown axes `dial` names each row's"
    )
    unknown = "the axes and their zeros, or none"
    pattern = "reading_mm?|along_[xyz]|dial"
    signs = ("reading_mm?",)
    arrays = ("reading",)
    fill = ("reading_mm",)
    has_scale = True
    lever = 10.0
    point_array = "axis"
    alone = "dial"

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Return `reading`, shape (n,) [m], with `axis`, shape (n, 3), or `label`, shape (n,).

        Axes are given unit vectors in the measuring frame, labels name gauges of unknown axes.
        Raises InputError: an axis that is no unit vector, or too few readings of a gauge.
        """
        arrays = {"reading": columns.si("reading", ("_mm", "_m"))}
        if any(str(name).startswith("along_") for name in columns.table):
            axis = np.stack([columns.column(f"along_{c}") for c in "xyz"], axis=1)
            length = np.linalg.norm(axis, axis=1)
            # Given directions must be unit vectors within this tolerance.
            if (np.abs(length - 1) > 1e-2).any():
                row = int(np.argmax(np.abs(length - 1)))
                raise InputError(
                    f"{columns.at(row)}, columns 'along_x' to 'along_z': length {length[row]:.4g}; "
                    "allowed: unit vectors of the measuring frame, such as 0, 0, 1 for a height"
                )
            return arrays | {"axis": axis / length[:, None]}
        if "dial" in columns.table:
            arrays["label"] = labels_of(columns, "dial", "it names the gauge of each reading")
        # Three readings determine axis and zero of a gauge; only a fourth carries information on
        # the robot.
        min_readings_per_dial = 4
        for own in each_label(self._labels(arrays)):
            if len(own) < min_readings_per_dial:
                raise InputError(
                    f"{columns.at(int(own[0]))}, column 'reading': {len(own)} readings of one "
                    f"gauge; its axis and zero take three: give {min_readings_per_dial} at least, "
                    "or its axis in along_x, along_y, along_z"
                )
        return arrays

    def residual(self, pose: PoseExpression) -> Symbolic:
        """Return the model's reading of the gauge minus the measured one, one number [m]."""
        along = ca.dot(pose.p, pose.take("axis", 3)) if pose.point is None else super().residual(pose)
        return along - pose.take("reading", 1)

    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        """Return the absolute errors of the readings, shape (n,) [m]."""
        along = (p * arrays["axis"]).sum(axis=1) if "axis" in arrays else self.heights(arrays, p)
        return np.asarray(np.abs(along - arrays["reading"]))

    def start(self, arrays: Arrays, p: Array) -> Array:
        """Return the unknown point (see `Dial`) of the axis that fits the readings best, (3,) [m].

        p : positions of the model in the measuring frame, shape (n, 3) [m]
        """
        n, d = _axis(p, arrays["reading"])
        return np.asarray((self.lever + d) * n)


def _axis(p: Array, reading: Array) -> tuple[Array, float]:
    """Return unit vector n, shape (3,), and distance d [m] with n.p - d = reading in least squares.

    p : positions, shape (n, 3) [m]; reading : of the gauge at them, shape (n,) [m]
    Source: the secular equation of least squares on a sphere (Golub and Van Loan 2013, 6.2.1),
    solved by bisection.
    """
    local, centred = p - p.mean(axis=0), reading - reading.mean()
    value, V = np.linalg.eigh(local.T @ local)
    b = V.T @ (local.T @ centred)
    low, high = -value[0] + 1e-12 * value[-1], -value[0] + np.linalg.norm(b) + value[-1]
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.linalg.norm(b / (value + middle)) > 1 else (low, middle)
    n = V @ (b / (value + high))
    n = n / max(np.linalg.norm(n), 1e-300)
    return n, float(n @ p.mean(axis=0) - reading.mean())

"""Readings along one axis: a dial gauge, a height probe, a displacement sensor."""

from collections.abc import Set

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.transforms import Symbolic
from casadical.measurements.columns import Columns
from casadical.measurements.kinds.base import Arrays, PoseExpression, PositionsAt
from casadical.measurements.kinds.contact import each_label, labels_of
from casadical.measurements.kinds.surfaces import Plane

# Direction and zero of a gauge take three numbers; from so many readings on they tell of the robot.
FEWEST = 4
# Known directions whose length is off one by more than this are refused.
UNIT = 1e-2


class Dial(Plane):
    """How far the measured point is along a gauge's axis, which is known or, with its zero, identified too.

    Along a known axis a reading is the coordinate in the measuring frame; a zero elsewhere moves the base, where that
    is unknown. Of an unknown axis n, with its zero at the distance d from the frame's origin, (10 m + d) n is the
    unknown point. The reported error is that of the reading.
    """

    name = "dial"
    columns = (
        "`reading_mm` (or `_m`) that grows along an axis: known `along_x, along_y, along_z`, or none of these; of "
        "several gauges of unknown axes `dial` names each row's"
    )
    unknown = "the axes and their zeros, or none"
    pattern = "reading_mm?|along_[xyz]|dial"
    arrays = ("reading",)
    fill = ("reading_mm",)
    has_scale = True
    lever = 10.0
    known = "axis"
    alone = "dial"

    def matches(self, names: Set[str]) -> bool:
        return bool(names & {"reading_mm", "reading_m"})

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Readings [m], and their axes or the gauges' names. Raises InputError."""
        arrays = {"reading": columns.si("reading", ("_mm", "_m"))}
        if any(str(name).startswith("along_") for name in columns.table):
            axis = np.stack([columns.column(f"along_{c}") for c in "xyz"], axis=1)
            length = np.linalg.norm(axis, axis=1)
            if (np.abs(length - 1) > UNIT).any():
                row = int(np.argmax(np.abs(length - 1)))
                raise InputError(
                    f"{columns.at(row)}, columns 'along_x' to 'along_z': length {length[row]:.4g}; allowed: unit "
                    "vectors of the measuring frame, such as 0, 0, 1 for a height"
                )
            return arrays | {"axis": axis / length[:, None]}
        if "dial" in columns.table:
            arrays["label"] = labels_of(columns, "dial", "it names the gauge of each reading")
        for own in each_label(self._labels(arrays)):
            if len(own) < FEWEST:
                raise InputError(
                    f"{columns.at(int(own[0]))}, column 'reading': {len(own)} readings of one gauge; its axis and zero "
                    f"take three: give {FEWEST} at least, or its axis in along_x, along_y, along_z"
                )
        return arrays

    def residual(self, pose: PoseExpression) -> Symbolic:
        along = ca.dot(pose.p, pose.take("axis", 3)) if pose.point is None else super().residual(pose)
        return along - pose.take("reading", 1)

    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        along = (p * arrays["axis"]).sum(axis=1) if "axis" in arrays else self.heights(arrays, p)
        return np.asarray(np.abs(along - arrays["reading"]))

    def start(self, arrays: Arrays, p: Array) -> Array:
        n, d = _axis(p, arrays["reading"])
        return np.asarray((self.lever + d) * n)


def _axis(p: Array, reading: Array) -> tuple[Array, float]:
    """Unit vector n and distance d of n.p - d = reading, by least squares with n of length one, shape (n, 3) and (n,).

    Source: the secular equation of least squares on a sphere (Golub and Van Loan 2013, 6.2.1), solved by bisection.
    """
    local, left = p - p.mean(axis=0), reading - reading.mean()
    value, V = np.linalg.eigh(local.T @ local)
    b = V.T @ (local.T @ left)
    low, high = -value[0] + 1e-12 * value[-1], -value[0] + np.linalg.norm(b) + value[-1]
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.linalg.norm(b / (value + middle)) > 1 else (low, middle)
    n = V @ (b / (value + high))
    n = n / max(np.linalg.norm(n), 1e-300)
    return n, float(n @ p.mean(axis=0) - reading.mean())

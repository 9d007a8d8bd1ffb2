"""Poses that hold the tool at one point, whose place is unknown."""

from collections.abc import Sequence, Set

import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.core.transforms import Symbolic
from casadical.measurements.columns import Columns
from casadical.measurements.kinds.base import Arrays, MeasurementKind, PoseExpression, PositionsAt


class Contact(MeasurementKind):
    """Contact of the measured point with points that are identified too, by their labels.

    The reported error is the distance from the mean of all poses at the same point, which is all that can be known.
    """

    name = "contact"
    columns = "`point`: poses of the same name hold the tool at the same point"
    unknown = "the points"
    fill = ("point",)
    pattern = "point"
    arrays = ("label",)
    lengths = 3
    has_scale = False

    def matches(self, names: Set[str]) -> bool:
        return "point" in names

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Labels of the points. Raises InputError: an empty label, or no point that is touched twice."""
        if "point" not in columns.table:
            raise InputError(f"{columns.source}: column 'point' is missing; it says which point each pose touches")
        empty = columns.table["point"].isna().to_numpy()
        if empty.any():
            raise InputError(f"{columns.at(int(np.argmax(empty)))}, column 'point' is empty; name the point")
        label = columns.table["point"].astype(str).to_numpy(dtype=object)
        names, counts = np.unique(label.astype(str), return_counts=True)
        if counts.max() < 2:
            raise InputError(
                f"{columns.source}: column 'point': no point is touched twice ({len(names)} labels); "
                "poses at one point must have one label"
            )
        return {"label": label}

    def residual(self, pose: PoseExpression) -> Symbolic:
        return pose.from_point()

    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        return np.asarray(np.linalg.norm(p - self.point_starts(arrays, p), axis=1))

    def at_rest(self, arrays: Arrays) -> bool:
        return False

    def point_names(self, arrays: Arrays) -> Sequence[str]:
        return list(arrays["label"])

    def point_starts(self, arrays: Arrays, p: Array) -> Array:
        _, group = np.unique(arrays["label"].astype(str), return_inverse=True)
        sums = np.zeros((group.max() + 1, 3))
        np.add.at(sums, group, p)
        return np.asarray((sums / np.bincount(group)[:, None])[group])

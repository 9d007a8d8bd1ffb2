"""Contact of the tool with unknown points, and the base class of kinds with such points."""

from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.transforms import Symbolic
from casadical.measurements.columns import Columns
from casadical.measurements.kinds.base import Arrays, MeasurementKind, PoseExpression, PositionsAt


class OfPoints(MeasurementKind):
    """Base class of kinds whose poses refer to unknown points by their labels.

    point_array : name of the array that gives the points; "" if the kind has none
    alone : name of the one point where there are no labels
    """

    point_array: ClassVar[str] = ""
    alone: ClassVar[str] = ""

    def at_rest(self, arrays: Arrays) -> bool:
        """Return whether the points are given, so that the base is identifiable."""
        return self.point_array in arrays

    def point_names(self, arrays: Arrays) -> Sequence[str]:
        """Return the label of each pose's unknown point; empty if the points are given."""
        return () if self.point_array in arrays else list(self._labels(arrays))

    def point_starts(self, arrays: Arrays, p: Array) -> Array:
        """Return an initial estimate of each pose's unknown point, shape (n, 3) [m].

        p : positions of the model in the measuring frame, shape (n, 3) [m]
        """
        starts = np.empty_like(p)
        for own in each_label(self._labels(arrays)):
            starts[own] = self.start({name: values[own] for name, values in arrays.items()}, p[own])
        return starts

    def start(self, arrays: Arrays, p: Array) -> Array:
        """Return an initial estimate of one point from all poses at it, shape (3,) [m].

        It is the mean of their positions.

        p : positions of the model in the measuring frame, shape (n, 3) [m]
        """
        return np.asarray(sum(p) / len(p))

    def _labels(self, arrays: Arrays) -> Array:
        """Return the label of each pose; the same one for all if there is no column of labels."""
        return arrays["label"] if "label" in arrays else np.full(len(arrays[self.arrays[0]]), self.alone)


class Contact(OfPoints):
    """Contact of the measured point with points that are identified too, by their labels.

    The reported error is the distance from the mean of all poses at the same point, because the
    true points are unknown.
    """

    name = "contact"
    columns = "`point`: poses of the same name hold the tool at the same point"
    unknown = "the points"
    fill = ("point",)
    pattern = "point"
    signs = ("point",)
    arrays = ("label",)
    lengths = 3
    has_scale = False
    touches = True

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Return the name of the point that each pose touches, as the array `label`, shape (n,).

        Raises InputError: an empty label, or no point that is touched twice.
        """
        label = labels_of(columns, "point", "it says which point each pose touches")
        names, counts = np.unique(label.astype(str), return_counts=True)
        if counts.max() < 2:
            raise InputError(
                f"{columns.source}: column 'point': no point is touched twice ({len(names)} "
                "labels); poses at one point must have one label"
            )
        return {"label": label}

    def residual(self, pose: PoseExpression) -> Symbolic:
        """Return the measured point less the unknown point, three numbers [m]."""
        return pose.from_point()

    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        """Return the distance of each pose from the mean of its point's poses, shape (n,) [m]."""
        return np.asarray(np.linalg.norm(p - self.point_starts(arrays, p), axis=1))


def labels_of(columns: Columns, name: str, meaning: str) -> Array:
    """Return a column of names as texts, shape (n,).

    Raises InputError: it is missing, or a cell is empty.
    """
    if name not in columns.table:
        raise InputError(f"{columns.source}: column {name!r} is missing; {meaning}")
    empty = columns.table[name].isna().to_numpy()
    if empty.any():
        raise InputError(f"{columns.at(int(np.argmax(empty)))}, column {name!r} is empty; {meaning}")
    return np.asarray(columns.table[name].astype(str).to_numpy(dtype=object))


def labels_touched_often(columns: Columns, name: str, fewest: int, meaning: str, remedy: str) -> Array:
    """Return a column of names, shape (n,), after a check that each is at `fewest` poses or more.

    meaning : as of `labels_of`; remedy : end of the message on too few touches
    Raises InputError also where a name occurs at fewer poses.
    """
    label = labels_of(columns, name, meaning)
    for own in each_label(label):
        if len(own) < fewest:
            where = f"{columns.at(int(own[0]))}, column {name!r}: {label[own[0]]!r}"
            raise InputError(f"{where} is touched {len(own)} times; {remedy}, or leave these out")
    return label


def each_label(label: Array) -> Iterator[Array]:
    """Yield for each distinct label the indices of its poses; labels in alphabetic order.

    label : of each pose, shape (n,)
    """
    _, group = np.unique(label.astype(str), return_inverse=True)
    for k in range(int(group.max()) + 1):
        yield np.flatnonzero(group.ravel() == k)

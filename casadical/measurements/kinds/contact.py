"""Poses that hold the tool at one point, whose place is unknown; the base of all kinds with named unknown points."""

from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.transforms import Symbolic
from casadical.measurements.columns import Columns
from casadical.measurements.kinds.base import Arrays, MeasurementKind, PoseExpression, PositionsAt


class OfPoints(MeasurementKind):
    """A kind whose poses refer to unknown points by their labels.

    known : array that says where the points are, so that none is unknown; alone : name of the one without a label
    """

    known: ClassVar[str] = ""
    alone: ClassVar[str] = ""

    def at_rest(self, arrays: Arrays) -> bool:
        return self.known in arrays

    def point_names(self, arrays: Arrays) -> Sequence[str]:
        return () if self.known in arrays else list(self._labels(arrays))

    def point_starts(self, arrays: Arrays, p: Array) -> Array:
        starts = np.empty_like(p)
        for own in each_label(self._labels(arrays)):
            starts[own] = self.start({name: values[own] for name, values in arrays.items()}, p[own])
        return starts

    def start(self, arrays: Arrays, p: Array) -> Array:
        """Of one point, shape (3,) [m], by its own poses; p : shape (n, 3) [m]: positions of the model"""
        return np.asarray(sum(p) / len(p))

    def _labels(self, arrays: Arrays) -> Array:
        return arrays["label"] if "label" in arrays else np.full(len(arrays[self.arrays[0]]), self.alone)


class Contact(OfPoints):
    """Contact of the measured point with points that are identified too, by their labels.

    The reported error is the distance from the mean of all poses at the same point, which is all that can be known.
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
        """Labels of the points. Raises InputError: an empty label, or no point that is touched twice."""
        label = labels_of(columns, "point", "it says which point each pose touches")
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


def labels_of(columns: Columns, name: str, meaning: str) -> Array:
    """A column of names, shape (n,). Raises InputError: it is missing, or a cell is empty; meaning : what it says."""
    if name not in columns.table:
        raise InputError(f"{columns.source}: column {name!r} is missing; {meaning}")
    empty = columns.table[name].isna().to_numpy()
    if empty.any():
        raise InputError(f"{columns.at(int(np.argmax(empty)))}, column {name!r} is empty; {meaning}")
    return np.asarray(columns.table[name].astype(str).to_numpy(dtype=object))


def touched_often(columns: Columns, name: str, fewest: int, meaning: str, remedy: str) -> Array:
    """Names as of `labels_of`. Raises InputError also where a thing is touched less than `fewest` times."""
    label = labels_of(columns, name, meaning)
    for own in each_label(label):
        if len(own) < fewest:
            where = f"{columns.at(int(own[0]))}, column {name!r}: {label[own[0]]!r}"
            raise InputError(f"{where} is touched {len(own)} times; {remedy}, or leave these out")
    return label


def each_label(label: Array) -> Iterator[Array]:
    """The poses of each label, as their numbers."""
    _, group = np.unique(label.astype(str), return_inverse=True)
    for k in range(int(group.max()) + 1):
        yield np.flatnonzero(group.ravel() == k)

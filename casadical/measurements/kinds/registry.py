"""Registry of all kinds of measurement by their names."""

from collections.abc import Mapping
from functools import cache

from casadical.core.basics import InputError
from casadical.measurements.columns import Columns
from casadical.measurements.kinds.base import MeasurementKind
from casadical.measurements.kinds.contact import Contact
from casadical.measurements.kinds.distance import Distance, PairDistance
from casadical.measurements.kinds.position import Corners, Pose, Position, PositionCovariance, RelativePose
from casadical.measurements.kinds.surfaces import Dial, Plane, Sphere


@cache
def kinds() -> Mapping[str, MeasurementKind]:
    """Return every kind of measurement by its name, in the order in which a table is tested.

    A kind whose columns include those of another comes first.
    """
    order = (Pose, Corners, PositionCovariance, Position, PairDistance, Distance)
    return {kind.name: kind() for kind in (*order, Dial, Sphere, Plane, Contact, RelativePose)}


def find_kind(name: str, source: str = "measurements") -> MeasurementKind:
    """Return the kind of measurement of this name. Raises InputError for an unknown one."""
    if name not in kinds():
        raise InputError(f"{source}: kind {name!r} is unknown; allowed: {', '.join(kinds())}")
    return kinds()[name]


def kind_of(columns: Columns) -> MeasurementKind:
    """Return the first kind of measurement whose columns a table has.

    Raises InputError where it has those of none.
    """
    names = set(map(str, columns.table))
    for kind in kinds().values():
        if kind.matches(names):
            return kind
    needed = "; ".join(dict.fromkeys(", ".join(kind.fill) for kind in kinds().values() if kind.fill))
    raise InputError(
        f"{columns.source}: no observation found; there are {columns.names}; known are {needed} "
        "(docs/measurements.md), or other names by `columns` in problem.toml"
    )

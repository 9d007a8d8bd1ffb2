"""All kinds of measurement: ours, and those of installed packages."""

from collections.abc import Mapping
from functools import cache

from casadical.core.basics import InputError
from casadical.core.plugins import members
from casadical.measurements.columns import Columns
from casadical.measurements.kinds.base import MeasurementKind

# Entry points of other packages: `name = "module:Class"`, the class derived from `MeasurementKind`.
GROUP = "casadical.measurement_kinds"
# Tried on a table in this order, so that a kind comes before those that need fewer columns; plug-ins come last.
_OURS = (
    "casadical.measurements.kinds.position:Pose",
    "casadical.measurements.kinds.position:PositionCovariance",
    "casadical.measurements.kinds.position:Position",
    "casadical.measurements.kinds.distance:PairDistance",
    "casadical.measurements.kinds.distance:Distance",
    "casadical.measurements.kinds.surfaces:Dial",
    "casadical.measurements.kinds.surfaces:Sphere",
    "casadical.measurements.kinds.surfaces:Plane",
    "casadical.measurements.kinds.contact:Contact",
    "casadical.measurements.kinds.position:RelativePose",
)


@cache
def kinds() -> Mapping[str, MeasurementKind]:
    """Every kind by its name. Raises InputError for a faulty plug-in."""
    kinds = {name: member() for name, member in members(GROUP, MeasurementKind, _OURS).items()}  # type: ignore[type-abstract]
    for kind in kinds.values():
        if not 1 <= kind.numbers <= 6:
            raise InputError(f"kind {kind.name!r} observes {kind.numbers} numbers at a pose; allowed: 1 to 6")
    return kinds


def find_kind(name: str, source: str = "measurements") -> MeasurementKind:
    """The kind of a name. Raises InputError that lists those that exist; source : where the name stands."""
    if name not in kinds():
        raise InputError(f"{source}: kind {name!r} is not known; allowed: {', '.join(kinds())}")
    return kinds()[name]


def kind_of(columns: Columns) -> MeasurementKind:
    """The kind that a table's columns show. Raises InputError where they show none."""
    names = set(map(str, columns.table))
    for kind in kinds().values():
        if kind.matches(names):
            return kind
    needed = "; ".join(dict.fromkeys(", ".join(kind.fill) for kind in kinds().values() if kind.fill))
    raise InputError(
        f"{columns.source}: no observation found; there are {columns.names}; known are {needed} "
        "(docs/measurements.md), or other names by `columns` in problem.toml"
    )

"""Poses that touch a ball of known radius, whose centre is unknown."""

from collections.abc import Set
from typing import ClassVar

import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.measurements.columns import Columns
from casadical.measurements.kinds.base import Arrays, PositionsAt
from casadical.measurements.kinds.contact import touched_often
from casadical.measurements.kinds.distance import Distance

# Four touches define the centre of a ball and its radius; from so many on they tell of the robot.
FEWEST = 5
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
        radius = columns.si("radius", ("_mm", "_m"))
        if (radius <= 0).any():
            row = int(np.argmax(radius <= 0))
            raise InputError(
                f"{columns.at(row)}, column 'radius': {1e3 * radius[row]:.4g} mm; a radius must be positive (poses at "
                "one point are kind 'contact')"
            )
        remedy = f"touch it at {FEWEST} poses at least, all around"
        label = touched_often(columns, "sphere", FEWEST, "it says which ball each pose touches", remedy)
        return {"distance": radius, "label": label}

    def unit_fault(self, arrays: Arrays, p: Array, positions_at: PositionsAt, reach: float) -> str:
        longest = float(arrays["distance"].max())
        if longest < LARGEST * reach:
            return ""
        return f"a radius of {longest:.4g} m does not fit the robot, which reaches {reach:.3g} m; is it radius_mm?"

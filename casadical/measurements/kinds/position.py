"""Measured positions of the tool."""

from collections.abc import Set
from typing import ClassVar

import numpy as np

from casadical.core.arrays import Array
from casadical.core.transforms import Symbolic
from casadical.measurements.columns import Columns
from casadical.measurements.kinds.base import Arrays, MeasurementKind, PoseExpression, PositionsAt


class Position(MeasurementKind):
    """Position of the measured point."""

    name = "position"
    columns = "`x_mm, y_mm, z_mm` (or `_m`)"
    fill: ClassVar[tuple[str, ...]] = ("x_mm", "y_mm", "z_mm")
    pattern = "[xyz]_mm?"
    arrays: ClassVar[tuple[str, ...]] = ("position",)
    lengths = 3
    by_row: ClassVar[bool] = True

    def matches(self, names: Set[str]) -> bool:
        return bool(names & {"x_mm", "x_m"})

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        return {"position": columns.vector("")}

    def residual(self, pose: PoseExpression) -> Symbolic:
        return pose.p - pose.take("position", 3)

    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        return np.asarray(np.linalg.norm(p - arrays["position"], axis=1))

    def unit_fault(self, arrays: Arrays, p: Array, positions_at: PositionsAt, reach: float) -> str:
        measured, moved = (float(np.linalg.norm(np.ptp(x, axis=0))) for x in (arrays["position"], p))
        if measured > 20 * reach:
            return (
                f"positions spread over {measured:.4g} m, but the robot reaches {reach:.3g} m; "
                "are they millimetres? name the columns x_mm, y_mm, z_mm"
            )
        if measured < 0.02 * moved:
            return (
                f"positions spread over {1e3 * measured:.4g} mm only, the model over {1e3 * moved:.4g} mm; "
                "are they metres? name the columns x_m, y_m, z_m"
            )
        return ""

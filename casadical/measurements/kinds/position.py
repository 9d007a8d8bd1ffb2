"""Measured positions of the tool, with one noise for all or a covariance at each pose."""

from collections.abc import Set
from typing import ClassVar

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.linear_gaussian.noise import whitening_of
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


_ENTRIES = ("xx", "xy", "xz", "yy", "yz", "zz")


class PositionCovariance(Position):
    """Position of the measured point; `whitening` makes its noise alike in all directions and at all poses.

    A covariance C = L L' counts through L^-1 (model - measurement), in units of the typical sigma, which `sigma` gives.
    """

    name = "position_covariance"
    columns = "those of `position` and `cov_xx_mm2, cov_xy_mm2, cov_xz_mm2, cov_yy_mm2, cov_yz_mm2, cov_zz_mm2`"
    fill = ("x_mm", "y_mm", "z_mm")
    pattern = "[xyz]_mm?|cov_(xx|xy|xz|yy|yz|zz)_mm2"
    arrays: ClassVar[tuple[str, ...]] = ("position", "whitening")
    by_row = False  # the typical sigma is that of all rows

    def matches(self, names: Set[str]) -> bool:
        return super().matches(names) and "cov_xx_mm2" in names

    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        xx, xy, xz, yy, yz, zz = (1e-6 * columns.column(f"cov_{entry}_mm2") for entry in _ENTRIES)
        covariance = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
        smallest = np.linalg.eigvalsh(covariance)[:, 0]
        if (smallest <= 0).any():
            row = int(np.argmin(smallest))
            raise InputError(
                f"{columns.at(row)}, columns cov_xx_mm2 to cov_zz_mm2: no covariance (its smallest "
                f"variance is {1e6 * smallest[row]:.3g} mm2); allowed: symmetric, positive definite"
            )
        return {**super().read(columns, q), "whitening": whitening(covariance)}

    def residual(self, pose: PoseExpression) -> Symbolic:
        left = super().residual(pose)
        return ca.reshape(pose.take("whitening", 9), 3, 3).T @ left


def whitening(covariance: Array) -> Array:
    """What makes noise of these covariances white with their typical sigma, shape (n, 3, 3).

    covariance : shape (n, 3, 3) [m^2]
    """
    return np.asarray(typical_sigma(covariance) * whitening_of(covariance).W)


def typical_sigma(covariance: Array) -> float:
    """Root of the mean variance of a coordinate [m]; covariance : shape (n, 3, 3) [m^2]."""
    return float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean() / 3))

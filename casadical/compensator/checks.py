"""Checks of a user's arrays."""

import numpy as np
from numpy.typing import ArrayLike

from casadical.core.arrays import Array
from casadical.core.errors import InputError


def joint_angles(q: ArrayLike, joints: int) -> Array:
    """Return q as an array of shape (n, joints) [rad]; a single pose may have shape (joints,).

    Raises InputError for another shape or values that are not finite.
    """
    rows = _numbers(q, "q")
    rows = rows[None] if rows.ndim == 1 else rows
    if rows.ndim != 2 or rows.shape[1] != joints:
        raise InputError(f"q must have shape (n, {joints}) [rad]; its shape is {np.shape(q)}")
    _finite(rows, "q", "rad")
    return rows


def residuals(residual_mm: ArrayLike, poses: int, outputs: int) -> Array:
    """Return residuals as an array of shape (poses, outputs) [mm].

    Raises InputError for another shape or values that are not finite.
    """
    rows = _numbers(residual_mm, "residual_mm")
    if rows.shape != (poses, outputs):
        raise InputError(
            f"residual_mm must have shape ({poses}, {outputs}) [mm], one row for each row of q; "
            f"its shape is {rows.shape}"
        )
    _finite(rows, "residual_mm", "mm")
    return rows


def _numbers(values: ArrayLike, name: str) -> Array:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be an array of numbers: {error}") from None


def _finite(rows: Array, name: str, unit: str) -> None:
    bad = np.argwhere(~np.isfinite(rows))
    if len(bad):
        row, column = bad[0]
        raise InputError(
            f"{name}[{row}, {column}] is {rows[row, column]} {unit}: {len(bad)} value(s) of {name} are not finite; "
            "drop these poses or repair them"
        )

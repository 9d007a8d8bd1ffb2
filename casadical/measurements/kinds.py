"""What each kind of measurement observes at a pose, out of a table's columns."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from casadical.core.errors import InputError
from casadical.core.transforms import Array
from casadical.measurements.columns import Columns

Kind = Literal["position", "pose", "distance", "pair_distance", "contact"]

KINDS: tuple[Kind, ...] = ("position", "pose", "distance", "pair_distance", "contact")


def guess_kind(columns: Columns) -> Kind:
    """What the columns say was observed. Raises InputError where they say nothing."""
    has = set(columns.table)
    if has & {"x_mm", "x_m"}:
        turned = has & {"rx_deg", "rx_rad", "R00", "qw"}
        return "pose" if turned else "position"
    if has & {"distance_mm", "distance_m"}:
        return "pair_distance" if "other_pose" in has else "distance"
    if "point" in has:
        return "contact"
    raise InputError(
        f"{columns.source}: no observation found; need x_mm, y_mm, z_mm (or _m), distance_mm or point; "
        f"there are {', '.join(map(str, columns.table))}"
    )


def _position(columns: Columns, _q: Array) -> dict[str, Array | None]:
    return {"position": columns.vector("")}


def _pose(columns: Columns, _q: Array) -> dict[str, Array | None]:
    return {"position": columns.vector(""), "orientation": columns.orientation()}


def _distance(columns: Columns, _q: Array) -> dict[str, Array | None]:
    known = any(str(c).startswith("to_x") for c in columns.table)
    return {"distance": _positive_distance(columns), "target": columns.vector("to_") if known else None}


def _pair_distance(columns: Columns, q: Array) -> dict[str, Array | None]:
    pose, other = columns.column("pose"), columns.column("other_pose")
    where = {float(p): k for k, p in enumerate(pose)}
    if len(where) < len(pose):
        row = next(k for k, p in enumerate(pose) if where[float(p)] != k)
        raise InputError(
            f"{columns.at(row)}, column 'pose': {pose[row]:g} occurs again in row "
            f"{columns.row[where[float(pose[row])]]}; allowed: each pose's own number"
        )
    if (pose == other).any():
        row = int(np.argmax(pose == other))
        raise InputError(f"{columns.at(row)}, column 'other_pose': {other[row]:g} is that pose itself")
    missing = [k for k, o in enumerate(other) if float(o) not in where]
    if missing:
        raise InputError(
            f"{columns.at(missing[0])}, column 'other_pose': {other[missing[0]]:g} is no pose of this "
            "table; allowed: the numbers in column 'pose'"
        )
    return {"distance": _positive_distance(columns), "other": q[[where[float(o)] for o in other]]}


def _positive_distance(columns: Columns) -> Array:
    distance = columns.si("distance", ("_mm", "_m"))
    if (distance <= 0).any():
        row = int(np.argmax(distance <= 0))
        raise InputError(
            f"{columns.at(row)}, column 'distance': {1e3 * distance[row]:.4g} mm; a distance must be "
            "positive (poses at one point are kind 'contact')"
        )
    return distance


def _contact(columns: Columns, _q: Array) -> dict[str, Array | None]:
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


OBSERVED: dict[Kind, Callable[[Columns, Array], dict[str, Array | None]]] = {
    "position": _position,
    "pose": _pose,
    "distance": _distance,
    "pair_distance": _pair_distance,
    "contact": _contact,
}

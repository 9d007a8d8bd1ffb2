"""Derived columns for effects of instruments: distance anchors and camera images."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from casadical.core.basics import Array
from casadical.diagnosis.linearisation import condition_of_reading
from casadical.diagnosis.observations import Stops, row_slices
from casadical.effects.formula_effect import (
    ANCHOR_COLUMNS,
    INSTRUMENT_FLAG_COLUMNS,
    MAX_DISTANCE_INSTRUMENTS,
    image_columns,
)
from casadical.measurements.kinds.distance import Distance
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements


def with_anchor_columns(
    m: Measurements, sets: Sequence[Measurements], where: Mapping[str, Array], stops: Stops
) -> Measurements:
    """Return the combined table with columns of distance instruments (wires), if there are any.

    far_x_m, far_y_m, far_z_m are the anchor in the measuring frame [m], given or estimated by the
    base fit; wire1 is 1 where the first such instrument was read, else 0, and so on. Each distinct
    anchor of a table counts as one instrument; with more than MAX_DISTANCE_INSTRUMENTS in all no
    columns are added. Additional rows at a stop have columns of their own (see
    `linearisation.condition_of_reading`).
    where : estimate of each unknown point in the measuring frame, by name, shape (3,) [m]
    """
    rows = len(stops.of)
    anchor, wire, count = np.zeros((rows, 3)), np.zeros(rows, dtype=np.int64), 0
    for k, (part, at) in enumerate(zip(sets, row_slices(sets), strict=True)):
        if part.kind != Distance.name or part.distance is None:
            continue
        names = [f"{k}/{name}" for name in find_kind(part.kind).point_names(part.arrays)]
        anchor[at] = part.target if part.target is not None else np.array([where[name] for name in names])
        _, which = np.unique(anchor[at], axis=0, return_inverse=True)
        wire[at] = 1 + count + which.ravel()
        count = int(wire[at].max())
    if not 0 < count <= MAX_DISTANCE_INSTRUMENTS:
        return m
    of_row = {f: (wire == k).astype(float) for k, f in enumerate(INSTRUMENT_FLAG_COLUMNS, 1)} | dict(
        zip(ANCHOR_COLUMNS, anchor.T, strict=True)
    )
    return _with_row_columns(m, of_row, stops)


def _with_row_columns(m: Measurements, of_row: Mapping[str, Array], stops: Stops) -> Measurements:
    """Return the combined table with columns whose values are given by row of the sets.

    of_row : values by name, shape (rows,) each; for an additional row at a stop the column has a
        name of its own (see `linearisation.condition_of_reading`)
    """
    columns = dict(m.conditions)
    for turn in range(stops.most):
        own = np.flatnonzero(stops.turn == turn)
        for name, values in of_row.items():
            columns[condition_of_reading(name, turn)] = column = np.zeros(len(m))
            column[stops.of[own]] = values[own]
    return replace(m, conditions=columns)


def with_camera_columns(m: Measurements, sets: Sequence[Measurements], stops: Stops) -> Measurements:
    """Return the combined table with the columns that effects of cameras need.

    They are those of `camera_displacements`; without orientations m is returned unchanged.
    """
    if not any(part.orientation is not None for part in sets):
        return m
    names = [c for side in ("fixed", "carried") for what in ("depth", "radial") for c in image_columns(side, what)]
    of_row = {name: np.zeros(len(stops.of)) for name in names}
    for part, at in zip(sets, row_slices(sets), strict=True):
        if part.orientation is not None and part.position is not None:
            for name, values in camera_displacements(part.position, part.orientation).items():
                of_row[name][at] = values
    return _with_row_columns(m, of_row, stops)


def camera_displacements(p: Array, R: Array) -> Mapping[str, Array]:
    """Return the columns of `image_columns` for both mountings, shape (n,) each [m], by name.

    They are the components, in the measuring frame, of the vector from lens to target: along the
    optical axis (depth), and across it multiplied by the squared slope (radial). A fixed camera has
    its lens at the measuring frame's origin; a carried one has it at the tool frame's origin and
    sees the measuring frame's origin.
    p, R : tool's measured position and orientation, measuring frame, (n, 3) [m] and (n, 3, 3)
    """
    seen = {"fixed": (p, np.tile(np.eye(3), (len(p), 1, 1))), "carried": (-np.einsum("nji,nj->ni", R, p), -R)}
    images: dict[str, Array] = {}
    for side, (c, turn) in seen.items():
        # The slope against the lens's axis is limited to 2, beyond which no point is in an image.
        slope = np.minimum(np.hypot(c[:, 0], c[:, 1]) / np.maximum(np.abs(c[:, 2]), 1e-9), 2.0)
        parts = {"depth": c * [0, 0, 1], "radial": c * [1, 1, 0] * (slope**2)[:, None]}
        for what, part in parts.items():
            images |= dict(zip(image_columns(side, what), np.einsum("nij,nj->in", turn, part), strict=True))
    return images

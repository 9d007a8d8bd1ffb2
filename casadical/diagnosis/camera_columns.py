"""Columns of cameras, made of measured full poses: where what they see lies in their image."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.observations import by_turn, edges_of
from casadical.diagnosis.stops import Stops
from casadical.effects.formula_effect import image_columns
from casadical.measurements.measurements import Measurements

# A slope against the lens's axis beyond which nothing is in an image.
STEEPEST = 2.0


def with_images(m: Measurements, sets: Sequence[Measurements], stops: Stops) -> Measurements:
    """The table of all sets with the columns that effects of cameras need, where orientations were measured."""
    if not any(part.orientation is not None for part in sets):
        return m
    names = [c for side in ("fixed", "carried") for what in ("depth", "radial") for c in image_columns(side, what)]
    of_row = {name: np.zeros(len(stops.of)) for name in names}
    for part, at in zip(sets, edges_of(sets), strict=True):
        if part.orientation is not None and part.position is not None:
            for name, values in _images(part.position, part.orientation).items():
                of_row[name][at] = values
    return replace(m, conditions={**m.conditions, **by_turn(of_row, stops, len(m))})


def _images(p: Array, R: Array) -> Mapping[str, Array]:
    """Of measured positions, shape (n, 3) [m], and orientations, shape (n, 3, 3).

    A fixed camera has its lens where the measuring frame is, one that is carried where the tool frame is and sees the
    measuring frame's origin. What a fault adds is moved in the measuring frame.
    """
    seen = {"fixed": (p, np.tile(np.eye(3), (len(p), 1, 1))), "carried": (-np.einsum("nji,nj->ni", R, p), -R)}
    found: dict[str, Array] = {}
    for side, (c, turn) in seen.items():
        slope = np.minimum(np.hypot(c[:, 0], c[:, 1]) / np.maximum(np.abs(c[:, 2]), 1e-9), STEEPEST)
        parts = {"depth": c * [0, 0, 1], "radial": c * [1, 1, 0] * (slope**2)[:, None]}
        for what, part in parts.items():
            found |= dict(zip(image_columns(side, what), np.einsum("nij,nj->in", turn, part), strict=True))
    return found

"""Stops of the robot: what is read while it stands still shares how its joints repeat there."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casadical.core.basics import Array
from casadical.measurements.measurements import Measurements, same_readings

# Logged columns that are of the stop and not of the reading.
_OF_STOP = re.compile(r"payload_kg|approach\d+|(tool|session)_.*")


@dataclass(frozen=True, eq=False)
class Stops:
    """Rows of several sets, by the stops at which they were read.

    of : number of each row's stop, shape (rows,); turn : how many rows of its stop come before it, shape (rows,)
    rows : that is the first of each stop, shape (stops,)
    """

    of: Array
    turn: Array
    rows: Array

    @property
    def most(self) -> int:
        """Rows of the stop with the most."""
        return int(self.turn.max()) + 1

    def kept(self, mask: Array) -> Array:
        """Of the rows at stops that a mask keeps, the number of the stop among those, shape (k,)."""
        return np.asarray((np.cumsum(mask) - 1)[self.of[mask[self.of]]])


def stops_of(sets: Sequence[Measurements], measured_to: Array) -> Stops:
    """The stops of several sets, in the order of their first rows.

    Rows at equal readings and circumstances are of one stop, unless another reading lies between them by the logged
    time, else by the number of the pose. What is read twice to the same end are two stops, and so is each distance
    between two poses: each row of one set that is measured to one thing is a stop of its own.
    measured_to : number of set and far end of each row, shape (rows,)
    """
    n = len(measured_to)
    if len(sets) == 1 and sets[0].other is None and len(np.unique(measured_to)) == 1:
        return Stops(np.arange(n), np.zeros(n, dtype=np.int64), np.arange(n))
    shared = [c for c in sets[0].conditions if all(c in m.conditions for m in sets)]
    logged = {c: np.concatenate([m.conditions[c] for m in sets]) for c in shared}
    q = np.concatenate([m.q for m in sets])
    key = np.column_stack([same_readings(q), *(values for c, values in logged.items() if _OF_STOP.fullmatch(c))])
    key = np.unique(key, axis=0, return_inverse=True)[1].ravel()
    clock = next((logged[c] for c in ("time_s", "pose") if c in logged), None)
    if clock is not None:
        order = np.lexsort((key, clock))
        runs = np.empty(n, dtype=np.int64)
        runs[order] = np.cumsum(np.diff(key[order], prepend=key[order[0]]) != 0)
        key = runs
    alone = np.concatenate([np.full(len(m), m.other is not None) for m in sets])
    again = _counted(np.column_stack([key, measured_to]))
    again[alone] = 1 + n + np.flatnonzero(alone)
    _, first, stop = np.unique(np.column_stack([key, again]), axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    of = rank[stop.ravel()]
    return Stops(of, _counted(of[:, None]), np.sort(first))


def _counted(keys: Array) -> Array:
    """How often each row's numbers occur before it, shape (n,)."""
    number = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(number, kind="stable")
    starts = np.searchsorted(number[order], number[order])
    places = np.empty(len(number), dtype=np.int64)
    places[order] = np.arange(len(number)) - starts
    return places

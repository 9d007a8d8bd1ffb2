"""The order in which poses are measured: pass by pass, payload by payload, with short travel within each."""

from typing import Any

import numpy as np

from casadical.core.basics import Array, optional
from casadical.core.parts import GRAVITY
from casadical.core.statistics import TIE
from casadical.measurements.measurements import Measurements
from casadical.pose_selection.candidates import SESSION, SOCKET, Candidates, Circumstances, expected, timeline
from casadical.robot.robot import Robot

# Parts of a campaign within which poses planned for a certain time may be reordered.
TIME_PARTS = 4
# Columns that are chosen with a pose and go with it.
KEPT = ("payload_kg", SOCKET, *GRAVITY)
# Number of tours that are tried, each from another first pose.
STARTS = 12


def distances(robot: Robot, q: Array) -> Array:
    """Travel between readings, shape (n, n) [rad]: of the joint that turns most; a full stroke is half a turn."""
    unit = np.array([1.0 if j.kind == "revolute" else np.pi / (j.upper - j.lower) for j in robot.joints])
    return np.asarray(np.abs(unit * (q[:, None] - q[None])).max(axis=2))


def travel(robot: Robot, q: Array) -> float:
    """Sum of the travel from each reading to the next [rad]."""
    D = distances(robot, q)
    return float(D[np.arange(len(q) - 1), np.arange(1, len(q))].sum())


def tours() -> Any:
    """The library that orders poses. Raises InputError where it is not installed."""
    return optional(
        "networkx",
        "ordering for short travel needs networkx, which is not installed; pip install 'casadical[plan]', or keep "
        "the order in which poses were chosen (--no-order)",
    )


def short_path(D: Array, before: Array | None = None) -> Array:
    """An order, shape (n,), of small total distance: the best of networkx's greedy tours from several starts.

    D : distances, shape (n, n); before : distances from the pose before, shape (n,)
    Raises InputError where networkx is missing.
    """
    n = len(D)
    if n < 3:
        return np.arange(n) if before is None or n < 2 else np.argsort(before)
    nx = tours()
    # Zero would be read as "no edge".
    graph = nx.from_numpy_array(D + 1e-12)
    first = np.zeros(n) if before is None else before
    best: tuple[float, Array] | None = None
    for start in np.argsort(first, kind="stable")[:STARTS]:
        path = np.array(nx.approximation.greedy_tsp(graph, source=int(start))[:-1])
        length = float(first[path[0]] + D[path[:-1], path[1:]].sum())
        if best is None or length < (1 - TIE) * best[0]:
            best = (length, path)
    assert best is not None
    return best[1]


def arranged(robot: Robot, chosen: Candidates, circumstances: Circumstances, *, travel: bool) -> Measurements:
    """The chosen poses as measurements, in order; columns that depend on the order are computed again.

    travel : whether poses of one pass, part of the campaign and payload are ordered for short travel
    """
    rows = {n: v.ravel() for n, v in chosen.conditions.items()}
    q = np.repeat(chosen.q, chosen.size, axis=0)
    parts = [np.tile(chosen.turn, len(chosen))]
    if "progress" in rows:
        parts.append(np.minimum(TIME_PARTS * rows["progress"], TIME_PARTS - 1).astype(int))
    if "payload_kg" in rows:
        parts.append(rows["payload_kg"])
    _, part = np.unique(np.stack(parts, axis=1), axis=0, return_inverse=True)
    part = part.ravel()
    order: list[int] = []
    for number in range(part.max() + 1):
        block = np.flatnonzero(part == number)
        if travel:
            D = distances(robot, q[[*block, *order[-1:]]])
            size = len(block)
            block = block[short_path(D[:size, :size], D[size, :size] if order else None)]
        order += block.tolist()
    kept = {n: v[order] for n, v in rows.items() if n in KEPT or n.startswith(("approach", SESSION))}
    kept |= _timed(robot, q[order], circumstances)
    return expected(robot, q[order], kept, "plan")


def _timed(robot: Robot, q: Array, circumstances: Circumstances) -> dict[str, Array]:
    """Columns that depend on time, in the order of measuring."""
    names = [n for n in robot.conditions if n not in KEPT and not n.startswith(("approach", SESSION))]
    if not names:
        return {}
    progress = np.arange(len(q)) / max(1, len(q) - 1)
    return timeline(names, progress, len(q), circumstances)

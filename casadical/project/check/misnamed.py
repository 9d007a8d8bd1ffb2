"""Rows in which the column `tool` names another target than the one that was measured, as after a swap halfway."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from casadical.core.arrays import Array
from casadical.identification.accuracy import errors, predicted
from casadical.identification.placement import place_frames
from casadical.measurements.measurements import Measurements
from casadical.project.check.plausible import rigid
from casadical.robot.robot import Robot

# So many rows begin the search; a further name must be nearer by this factor, and halve the error of the table.
BEGIN, NEARER, WORTH = 18, 3.0, 0.5
ROUNDS = 5


@dataclass(frozen=True, eq=False)
class Misnamed:
    """names : of all targets; given, meant : index of the name in each row, shape (n,); row : of the file"""

    names: tuple[str, ...]
    given: Array
    meant: Array
    row: Array

    def in_words(self, source: str) -> str:
        """Which rows, and what they should name."""
        wrong = np.flatnonzero(self.given != self.meant)
        texts = []
        for a, b in sorted({(int(self.given[k]), int(self.meant[k])) for k in wrong}):
            rows = self.row[(self.given == a) & (self.meant == b)]
            listed = ", ".join(map(str, rows[:8])) + (" ..." if len(rows) > 8 else "")
            texts.append(f"{self.names[b]}, not {self.names[a]}, was measured in {len(rows)} rows: {listed}")
        first, last = self.row[wrong[0]], self.row[wrong[-1]]
        return (
            f"{source}: column 'tool' names the wrong target from row {first} to row {last}: {'; '.join(texts)}; "
            "correct the names, or casadical check --repair writes them, as `tools` in problem.toml"
        )


def misnamed(robot: Robot, m: Measurements) -> Misnamed | None:
    """Rows whose point lies where another target is, by a search that begins with a part of the rows; None of none.

    robot : with several targets; m : all rows of one table, in the order of the file
    """
    columns = [t.column for t in robot.targets]
    if not columns or m.position is None or len(m) < 2 * BEGIN:
        return None
    logged = m.condition_matrix(columns, np.zeros(len(columns)))
    given = np.where(logged.any(axis=1), 1 + np.argmax(logged, axis=1), 0)
    free = rigid(robot)
    before = _median(free, m)
    part = max(BEGIN, len(m) // 3)
    found = [_search(free, m, given, rows) for rows in (slice(0, part), slice(-part, None))]
    left = [_median(free, _named(m, robot, names)) for names in found]
    if min(left) > WORTH * before:
        return None
    # Of two names that change places nobody can say which half is right: the one with more rows is taken.
    as_good = [names for names, error in zip(found, left, strict=True) if error < min(left) / WORTH]
    meant = min(as_good, key=lambda names: int((names != given).sum()))
    if (meant == given).all():
        return None
    names = (robot.tool_name, *(t.name for t in robot.targets))
    return Misnamed(names, given, meant, m.row)


def _search(robot: Robot, m: Measurements, given: Array, rows: slice) -> Array:
    """The target of each row, where base and tools begin as these rows have them."""
    names, placed = given, place_frames(robot, m[rows])
    for _ in range(ROUNDS):
        points = np.array([placed.tool.T[:3, 3], *(t.point for t in placed.targets)])
        p, R = predicted(replace(placed, targets=(), tool_name=""), m)
        assert m.position is not None
        T = placed.tool.T
        seen = T[:3, 3] + np.einsum("nji,nj->ni", R, m.position - p) @ T[:3, :3].T
        far = np.linalg.norm(seen[:, None] - points, axis=2)
        nearest = np.argmin(far, axis=1)
        own = far[np.arange(len(m)), given]
        again = np.where(own > NEARER * far.min(axis=1), nearest, given)
        if (again == names).all():
            break
        names = again
        placed = place_frames(robot, _named(m, robot, names))
    return names


def _named(m: Measurements, robot: Robot, names: Array) -> Measurements:
    logged = {t.column: (names == k).astype(float) for k, t in enumerate(robot.targets, 1)}
    return replace(m, conditions={**m.conditions, **logged, f"tool_{robot.tool_name}": (names == 0).astype(float)})


def _median(robot: Robot, m: Measurements) -> float:
    with np.errstate(all="ignore"):
        return float(np.median(errors(place_frames(robot, m), m)))

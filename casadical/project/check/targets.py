"""Several targets on one flange, recognised from repeats: positions at equal readings that lie far apart.

Distances between the targets are the same at every pose, their directions turn with the flange. Neither a moved station
(one direction), nor bad rows, nor shifted readings (other distances each time) do both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from casadical.core.arrays import Array
from casadical.identification.accuracy import errors, predicted
from casadical.identification.placement import place_frames
from casadical.measurements.measurements import Measurements, same_readings
from casadical.project.check.plausible import rigid
from casadical.project.problem import Problem
from casadical.robot.robot import Robot

# Readings of a robot that stands still differ by less [rad or m]; targets are at least so far apart [m].
STANDS, APART = 5e-4, 5e-3
# Distances of one pair of targets differ by less [m].
ALIKE = 3e-3
# So many poses at least show a number of targets, at this share of those where repeats disagree; so many targets.
FEWEST, SHARE, MOST = 3, 0.2, 6
# Share of the repeated poses at which they disagree, and of those whose distances are the same.
DISAGREE, SAME = 0.5, 0.7
# Directions that are this much alike, as a share of their square sum, are one direction.
ONE_DIRECTION = 0.95
# Scatter of a target's position in the tool frame, as a share of the least distance, below which it is known.
SURE = 0.25


@dataclass(frozen=True, eq=False)
class Targets:
    """What repeats say.

    distances : between the targets, shape (K (K - 1) / 2,) [m], from the least; poses : at which they were seen
    turning : whether their directions turn with the flange; if not, the station may have been moved
    points : in the last link's frame, shape (K, 3) [m], which : target of each row of the file, both of shape (n,), and
    rows : those; None where the nominal model contradicts the data, so that it does not distinguish them
    """

    count: int
    distances: Array
    poses: int
    turning: bool
    points: Array | None = None
    which: Array | None = None
    rows: Array | None = None

    @property
    def names(self) -> list[str]:
        """As they are called where nobody has named them."""
        return [f"target{k}" for k in range(1, self.count + 1)]

    def in_words(self, source: str) -> str:
        """What disagrees, and what to do."""
        far = ", ".join(f"{1e3 * d:.1f}" for d in self.distances)
        if not self.turning:
            return (
                f"{source}: repeats disagree at {self.poses} poses, by the same way everywhere ({far} mm): the station "
                "was moved between them, or several targets were measured with one orientation of the tool; name them "
                "in a column 'tool', or turn the tool between poses"
            )
        return (
            f"{source}: repeats disagree: {self.count} targets on one flange, distances {far} mm between them (seen at "
            f"{self.poses} poses); a column 'tool' in the table and tables [[tool]] in the robot file name them"
        )


def recognised(robot: Robot, m: Measurements) -> Targets | None:
    """Several targets in a table that names none; None where repeats agree, or where there are none.

    robot : nominal; m : all rows of one table
    """
    if m.position is None or robot.targets or any(name.startswith("tool_") for name in m.conditions):
        return None
    poses = _poses(m)
    repeated = sum(len(rows) > 1 for rows, _ in poses)
    apart = [(rows, part) for rows, part in poses if part.max() > 0]
    if len(apart) < FEWEST or len(apart) < DISAGREE * repeated:
        return None
    sizes = np.array([1 + part.max() for _, part in apart])
    often = [k for k in range(2, MOST + 1) if (sizes == k).sum() >= max(FEWEST, SHARE * len(apart))]
    if not often:
        return None
    count = often[-1]
    points = [_means(m.position[rows], part) for rows, part in apart if part.max() + 1 == count]
    lengths = np.array([np.sort(_lengths(p)) for p in points])
    distances = np.median(lengths, axis=0)
    alike = (np.abs(lengths - distances) < ALIKE).all(axis=1)
    if alike.sum() < max(FEWEST, SAME * len(points)):
        return None
    distances = np.median(lengths[alike], axis=0)
    turning = _turning([p for p, ok in zip(points, alike, strict=True) if ok])
    found = Targets(count, distances, len(apart), turning)
    if not turning:
        return found
    whole = [(r, p) for r, p in apart if p.max() + 1 == count]
    return _distinguished(robot, m, poses, [pose for pose, ok in zip(whole, alike, strict=True) if ok], found)


def _poses(m: Measurements) -> list[tuple[Array, Array]]:
    """Rows at the same readings, and for each of them which of the points that lie apart it is."""
    reading = same_readings(m.q, STANDS)
    order = np.argsort(reading, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(reading[order])) + 1)
    assert m.position is not None
    return [(rows, _clusters(m.position[rows])) for rows in groups]


def _clusters(y: Array) -> Array:
    """Number of the cluster of each point, shape (n,), in the order in which they come; single linkage."""
    if len(y) == 1:
        return np.zeros(1, dtype=np.int64)
    part = np.full(len(y), -1)
    for k in range(len(y)):
        near = {int(part[j]) for j in range(k) if np.linalg.norm(y[j] - y[k]) < APART}
        part[k] = min(near, default=part.max() + 1)
        part[np.isin(part, list(near))] = part[k]
    return np.asarray(np.unique(part, return_inverse=True)[1].ravel())


def _means(y: Array, part: Array) -> Array:
    return np.array([y[part == k].mean(axis=0) for k in range(part.max() + 1)])


def _lengths(points: Array) -> Array:
    first, second = np.triu_indices(len(points), 1)
    return np.asarray(np.linalg.norm(points[first] - points[second], axis=1))


def _turning(points: list[Array]) -> bool:
    """Whether the longest way between two targets points elsewhere at other poses."""
    ways = []
    for p in points:
        first, second = np.triu_indices(len(p), 1)
        longest = int(np.argmax(_lengths(p)))
        ways.append(p[second[longest]] - p[first[longest]])
    values = np.linalg.eigvalsh(np.array(ways).T @ np.array(ways))
    return bool(values[-1] < ONE_DIRECTION * values.sum())


def _distinguished(
    robot: Robot, m: Measurements, poses: list[tuple[Array, Array]], whole: list[tuple[Array, Array]], found: Targets
) -> Targets:
    """Which row is which target, by the nominal model with base and tool at the middle of the targets.

    whole : poses at which every target was measured, at the distances found
    """
    placed = place_frames(rigid(robot), _middles(m, whole))
    p, R = predicted(placed, m)
    assert m.position is not None
    seen = np.einsum("nji,nj->ni", R, m.position - p)  # in the tool frame, from the middle of the targets
    middle = [(x := _means(seen[rows], part)) - x.mean(axis=0) for rows, part in whole]
    points, orders = middle[0], np.array(list(permutations(range(found.count))))
    for _ in range(3):
        ordered = np.array([x[orders[np.argmin(((x[orders] - points) ** 2).sum(axis=(1, 2)))]] for x in middle])
        points = np.median(ordered, axis=0)
    scatter = float(np.median(np.linalg.norm(ordered - points, axis=2)))
    if len(whole) < 2 * FEWEST or scatter > SURE * found.distances[0]:
        return found
    which = np.empty(len(m), dtype=np.int64)
    for rows, part in poses:
        which[rows] = _nearest(_means(seen[rows], part), points)[part]
    # In the order in which they come in the table.
    order = list(dict.fromkeys([*which.tolist(), *range(found.count)]))
    rank = np.argsort(order)
    points = placed.tool.T[:3, 3] + points[order] @ placed.tool.T[:3, :3].T
    return replace(found, points=points, which=rank[which], rows=m.row)


def _middles(m: Measurements, whole: list[tuple[Array, Array]]) -> Measurements:
    """One measurement of the middle of all targets at each of these poses."""
    assert m.position is not None
    first = m[np.array([rows[0] for rows, _ in whole])]
    q = np.array([m.q[rows].mean(axis=0) for rows, _ in whole])
    y = np.array([_means(m.position[rows], part).mean(axis=0) for rows, part in whole])
    return replace(first.positions_alone(), q=q, position=y)


def _nearest(x: Array, points: Array) -> Array:
    """The target that each point of one pose is: each another one, if there are no more points than targets."""
    k, count = len(x), len(points)
    if k > count:
        return np.asarray(np.argmin(np.linalg.norm(x[:, None] - points, axis=2), axis=1))
    orders = np.array(list(permutations(range(count), k)))
    off = x - points[orders]
    if k == count:  # what the nominal model misses by is the same for all
        off = off - np.median(off, axis=1, keepdims=True)
    most = _lengths(points).min() / 2  # what a bad row misses by does not count
    return np.asarray(orders[np.argmin(np.minimum(np.linalg.norm(off, axis=2), most).sum(axis=1))])


def middles(m: Measurements, count: int) -> Measurements | None:
    """The middle of all targets at every pose at which there are so many: a table of one target."""
    whole = [(rows, part) for rows, part in _poses(m) if part.max() + 1 == count]
    return _middles(m, whole) if whole else None


def whole_table(problem: Problem) -> Measurements | None:
    """All positions of a problem's only table, in the order of the file; None for several tables, or other kinds."""
    parts = [part for _, part in problem.parts()]
    first = parts[0]
    if any(part.source != first.source or part.position is None for part in parts):
        return None
    row = np.concatenate([part.row for part in parts])
    order = np.argsort(row)
    names = set.intersection(*(set(part.conditions) for part in parts))
    return replace(
        first.positions_alone()[np.zeros(len(row), dtype=np.int64)],
        q=np.concatenate([part.q for part in parts])[order],
        position=np.concatenate([part.position for part in parts if part.position is not None])[order],
        conditions={n: np.concatenate([part.conditions[n] for part in parts])[order] for n in sorted(names)},
        row=row[order],
    )


def unnamed_targets(problem: Problem) -> str:
    """Where a problem's only table has several targets and names none: that, and what to do; else nothing."""
    table = whole_table(problem)
    found = recognised(problem.robot, table) if table is not None else None
    if table is None or not found or not found.turning:
        return ""
    return f"{found.in_words(table.source)}; casadical check {problem.folder} --repair writes them"


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

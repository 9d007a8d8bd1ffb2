"""Recognition of several targets on one flange, from positions at equal readings that lie apart.

The distances between the targets are equal at all poses, and their directions rotate with the
flange. Neither a moved station (one constant direction), nor outliers, nor shifted readings
(different distances each time) show both.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.parts import Target
from casadical.core.statistics import first_of_best
from casadical.core.transforms import frame
from casadical.identification.accuracy import errors, predicted
from casadical.identification.placement import median_error, place_frames, rigid
from casadical.identification.plausibility import check_against
from casadical.measurements.arrangement import directions_turn
from casadical.measurements.measurements import STANDSTILL_TOLERANCE, Measurements, same_readings
from casadical.project.robot_columns import refuse_nameless, some_rows
from casadical.robot.robot import Robot

# Distance of positions at equal readings [m] above which they are of different targets; it is well
# above the noise of an instrument and below the distance of two reflectors.
MIN_TARGET_DISTANCE = 5e-3
# Tolerance within which the distances of one pair of targets at different poses are equal [m].
DISTANCE_TOLERANCE = 3e-3
# Largest number of targets that is searched for: the assignments grow with its factorial.
MAX_TARGETS = 6


@dataclass(frozen=True, eq=False)
class Targets:
    """Several targets on one flange, as repeated readings show them.

    count : number K of targets
    distances : median distances between the targets, ascending, shape (K (K - 1) / 2,) [m]
    poses : number of poses at which repeated readings disagree
    turning : whether the directions between targets rotate with the flange; if not, the station may
        have been moved
    points : targets in the frame of the last link, shape (K, 3) [m]; None where the nominal model
        is too inaccurate to distinguish them
    which : index of the target in each row of the table, shape (n,), None as `points`
    rows : row number in the file of each entry of `which`, shape (n,), None as `points`
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
        """Return default names of the targets: target1, target2 and so on."""
        return [f"target{k}" for k in range(1, self.count + 1)]

    def in_words(self, source: str) -> str:
        """Return the finding as a sentence that begins with the name of the table."""
        far = ", ".join(f"{1e3 * d:.1f}" for d in self.distances)
        if not self.turning:
            return (
                f"{source}: repeats disagree at {self.poses} poses, by the same way everywhere "
                f"({far} mm): the station was moved between them, or several targets were measured "
                "with one orientation of the tool; name them in a column 'tool', or turn the tool "
                "between poses"
            )
        return (
            f"{source}: repeats disagree: {self.count} targets on one flange, distances {far} mm "
            f"between them (seen at {self.poses} poses); a column 'tool' in the table and tables "
            "[[tool]] in the robot file name them"
        )


def recognised(robot: Robot, m: Measurements) -> Targets | None:
    """Return the several targets that a table measured but does not name, as repeats show them.

    None where the robot or the table names targets, or repeats show no certain number of them.

    robot : nominal robot
    m : measured poses
    """
    if m.position is None or robot.targets or m.target_names:
        return None
    poses = _poses(m)
    repeated = sum(len(rows) > 1 for rows, _ in poses)
    apart = [(rows, part) for rows, part in poses if part.max() > 0]
    least = 3  # minimum number of poses whose repeated readings must show a number of targets
    if len(apart) < least or len(apart) < 0.5 * repeated:
        return None
    sizes = np.array([1 + part.max() for _, part in apart])
    often = [k for k in range(2, MAX_TARGETS + 1) if (sizes == k).sum() >= max(least, 0.2 * len(apart))]
    if not often:
        return None
    count = often[-1]
    whole = [(rows, part) for rows, part in apart if part.max() + 1 == count]
    seen_at = [_means(m.position[rows], part) for rows, part in whole]
    lengths = np.array([np.sort(_lengths(p)) for p in seen_at])
    distances = np.median(lengths, axis=0)
    alike = (np.abs(lengths - distances) < DISTANCE_TOLERANCE).all(axis=1)
    if alike.sum() < max(least, 0.7 * len(seen_at)):
        return None
    distances = np.median(lengths[alike], axis=0)
    # The vector between the two farthest targets at each pose.
    first, second = np.triu_indices(count, 1)
    longest = [(p, int(np.argmax(_lengths(p)))) for p, ok in zip(seen_at, alike, strict=True) if ok]
    turning = directions_turn(np.array([p[second[k]] - p[first[k]] for p, k in longest]))
    targets = Targets(count, distances, len(apart), turning)
    if not turning:
        return targets
    whole = [pose for pose, ok in zip(whole, alike, strict=True) if ok]
    placed = place_frames(rigid(robot), _middles(m, whole))
    p, R = predicted(placed, m)
    assert m.position is not None
    seen = np.einsum("nji,nj->ni", R, m.position - p)  # tool frame, from the centroid
    middle = [(x := _means(seen[rows], part)) - x.mean(axis=0) for rows, part in whole]
    points, orders = middle[0], np.array(list(permutations(range(targets.count))))
    for _ in range(3):
        ordered = np.array([x[orders[first_of_best(-((x[orders] - points) ** 2).sum(axis=(1, 2)))]] for x in middle])
        points = np.median(ordered, axis=0)
    scatter = float(np.median(np.linalg.norm(ordered - points, axis=2)))
    # Targets are distinguished only where their scatter in the tool frame is below this share of
    # the smallest distance between them.
    if len(whole) < 2 * least or scatter > 0.25 * targets.distances[0]:
        return targets
    which = np.empty(len(m), dtype=np.int64)
    for rows, part in poses:
        which[rows] = _nearest(_means(seen[rows], part), points)[part]
    # Targets are numbered in the order in which they first appear in the table.
    order = list(dict.fromkeys([*which.tolist(), *range(targets.count)]))
    rank = np.argsort(order)
    points = placed.tool.T[:3, 3] + points[order] @ placed.tool.T[:3, :3].T
    return replace(targets, points=points, which=rank[which], rows=m.row)


def _poses(m: Measurements) -> list[tuple[Array, Array]]:
    """Return for each group of equal readings its k row indices and their clusters, both (k,).

    Positions of one cluster are of one target.
    """
    reading = same_readings(m.q, STANDSTILL_TOLERANCE)
    order = np.argsort(reading, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(reading[order])) + 1)
    assert m.position is not None
    return [(rows, _clusters(m.position[rows])) for rows in groups]


def _clusters(y: Array) -> Array:
    """Return the number of each point's single-linkage cluster, shape (n,), from 0.

    Points closer than MIN_TARGET_DISTANCE are in one cluster.

    y : points, shape (n, 3) [m]
    """
    if len(y) == 1:
        return np.zeros(1, dtype=np.int64)
    part = np.full(len(y), -1)
    for k in range(len(y)):
        near = {int(part[j]) for j in range(k) if np.linalg.norm(y[j] - y[k]) < MIN_TARGET_DISTANCE}
        part[k] = min(near, default=part.max() + 1)
        part[np.isin(part, list(near))] = part[k]
    return np.asarray(np.unique(part, return_inverse=True)[1].ravel())


def _means(y: Array, part: Array) -> Array:
    """Return the mean position of each of K clusters, shape (K, 3) [m].

    y : positions, shape (n, 3) [m]; part : cluster of each, shape (n,)
    """
    return np.array([y[part == k].mean(axis=0) for k in range(part.max() + 1)])


def _lengths(points: Array) -> Array:
    """Return the distances of all pairs of points, shape (K (K - 1) / 2,) [m]."""
    first, second = np.triu_indices(len(points), 1)
    return np.asarray(np.linalg.norm(points[first] - points[second], axis=1))


def _middles(m: Measurements, whole: list[tuple[Array, Array]]) -> Measurements:
    """Return one measurement of the centroid of all targets at each of these poses."""
    assert m.position is not None
    first = m[np.array([rows[0] for rows, _ in whole])]
    q = np.array([m.q[rows].mean(axis=0) for rows, _ in whole])
    y = np.array([_means(m.position[rows], part).mean(axis=0) for rows, part in whole])
    return replace(first.positions_alone(), q=q, position=y)


def _nearest(x: Array, points: Array) -> Array:
    """Return the index of the target nearest to each point of one pose, shape (k,).

    Each target is assigned at most once, unless there are more points than targets.

    x : points, shape (k, 3) [m]; points : targets, shape (K, 3) [m], in the same frame
    """
    k, count = len(x), len(points)
    if k > count:
        return np.asarray(np.argmin(np.linalg.norm(x[:, None] - points, axis=2), axis=1))
    orders = np.array(list(permutations(range(count), k)))
    off = x - points[orders]
    if k == count:  # the error of the nominal model is common to all targets of a pose
        off = off - np.median(off, axis=1, keepdims=True)
    most = _lengths(points).min() / 2  # the error of an outlier is capped
    return np.asarray(orders[first_of_best(-np.minimum(np.linalg.norm(off, axis=2), most).sum(axis=1))])


def middles(m: Measurements, count: int) -> Measurements | None:
    """Return a table of one point: the centroid of the targets at every pose with all of them.

    Returns None where no pose has measurements of `count` targets.
    """
    whole = [(rows, part) for rows, part in _poses(m) if part.max() + 1 == count]
    return _middles(m, whole) if whole else None


# Minimum number of rows from which the search for wrong names starts (the table needs twice as
# many), and of a table in which targets without names are searched for by distance.
MIN_SEARCH_ROWS = 18
# Other names are accepted if they reduce the median error to this fraction or less; K targets, if
# they reduce it to less than the K-th power of this fraction of that with one target.
MAX_ERROR_RATIO = 0.5


@dataclass(frozen=True, eq=False)
class WrongNames:
    """Rows in which the column `tool` names another target than the one that was measured.

    names : names of all targets
    given : index of the name that the table gives, shape (n,)
    meant : index of the target that was measured, shape (n,)
    row : row number in the file, shape (n,)
    """

    names: tuple[str, ...]
    given: Array
    meant: Array
    row: Array

    def in_words(self, source: str) -> str:
        """Return the wrong rows and the remedy as a sentence that begins with the table."""
        wrong = np.flatnonzero(self.given != self.meant)
        texts = []
        for a, b in sorted({(int(self.given[k]), int(self.meant[k])) for k in wrong}):
            rows = self.row[(self.given == a) & (self.meant == b)]
            listed = some_rows(rows.tolist())
            texts.append(f"{self.names[b]}, not {self.names[a]}, was measured in {len(rows)} rows: {listed}")
        first, last = self.row[wrong[0]], self.row[wrong[-1]]
        return (
            f"{source}: column 'tool' names the wrong target from row {first} to row {last}: "
            f"{'; '.join(texts)}; correct the names, or check --repair of a folder writes them, as "
            "`tools` in problem.toml"
        )


def wrong_names(robot: Robot, m: Measurements) -> WrongNames | None:
    """Return the rows whose position fits another target than the named one; None without any.

    None, too, of a robot without further targets or of fewer than 36 rows. The search starts from
    the first and from the last third of the rows.
    """
    columns = [t.column for t in robot.targets]
    if not columns or m.position is None or len(m) < 2 * MIN_SEARCH_ROWS:
        return None
    logged = m.condition_matrix(columns, np.zeros(len(columns)))
    given = np.where(logged.any(axis=1), 1 + np.argmax(logged, axis=1), 0)
    free = rigid(robot)
    before = median_error(free, m)
    part = max(MIN_SEARCH_ROWS, len(m) // 3)
    searched = [_search(free, m, given, rows) for rows in (slice(0, part), slice(-part, None))]
    medians = [median_error(free, _named(m, robot, names)) for names in searched]
    if min(medians) > MAX_ERROR_RATIO * before:
        return None
    # Where two names are swapped from some row on, it is unclear which part of the table is right:
    # the assignment that changes fewer rows is taken.
    as_good = [names for names, error in zip(searched, medians, strict=True) if error < min(medians) / MAX_ERROR_RATIO]
    meant = min(as_good, key=lambda names: int((names != given).sum()))
    if (meant == given).all():
        return None
    names = (robot.tool_name, *(t.name for t in robot.targets))
    return WrongNames(names, given, meant, m.row)


def _search(robot: Robot, m: Measurements, given: Array, rows: slice, nearer: float = 3.0) -> Array:
    """Return the index of each row's target, shape (n,), by alternating assignment and placement.

    given : index of the named target of each row, shape (n,)
    nearer : factor by which a row's own target must be farther than the nearest one for the row to
        be assigned to that
    """
    names, placed = given, place_frames(robot, _named(m, robot, given)[rows])
    for _ in range(5):
        points = np.array([*_points_of(placed).values()])
        far = np.linalg.norm(_in_last_link(placed, m)[:, None] - points, axis=2)
        nearest = np.argmin(far, axis=1)
        own = far[np.arange(len(m)), given if nearer > 1 else names]
        again = np.where(own > nearer * far.min(axis=1), nearest, given if nearer > 1 else names)
        if (again == names).all():
            break
        names = again
        placed = place_frames(robot, _named(m, robot, names))
    return names


def _points_of(robot: Robot) -> dict[str, Array]:
    """Return target -> point in the last link's frame, shape (3,) [m]; the tool's comes first."""
    return {robot.tool_name: robot.tool.T[:3, 3], **{t.name: t.point for t in robot.targets}}


def _in_last_link(placed: Robot, m: Measurements) -> Array:
    """Return each measured position in the last link's frame, shape (n, 3) [m]."""
    p, R = predicted(replace(placed, targets=(), tool_name=""), m)
    assert m.position is not None
    T = placed.tool.T
    return np.asarray(T[:3, 3] + np.einsum("nji,nj->ni", R, m.position - p) @ T[:3, :3].T)


def _named(m: Measurements, robot: Robot, names: Array) -> Measurements:
    """Return the measurements with each column `tool_NAME` 1 in its target's rows, 0 in others.

    names : index of each row's target, shape (n,): 0 is the tool, k the k-th of `robot.targets`
    """
    logged = {t.column: (names == k).astype(float) for k, t in enumerate(robot.targets, 1)}
    return replace(m, conditions={**m.conditions, **logged, f"tool_{robot.tool_name}": (names == 0).astype(float)})


def with_targets_of_rows(
    robot: Robot, sets: Sequence[Measurements]
) -> tuple[Robot, tuple[Measurements, ...], tuple[str, ...]]:
    """Return robot and later tables with a target for each row, and sentences on assumptions.

    The target of a row is named by a column; without one it follows from repeated readings, or from
    the positions of the rows relative to each other. The returned robot has the measured targets
    alone, at their given points or to be estimated. Raises InputError where repeats show several
    targets and the nominal model does not distinguish them.
    """
    points_by_name = _points_of(robot)
    placed_sets, notes = [], []
    for m in sets:
        points = {} if m.target_names or m.position is None else _by_position(robot, m)
        if points:
            places = np.arange(len(m))
            logged = {f"tool_{name}": np.isin(places, own).astype(float) for name, (_, own) in points.items()}
            placed_sets.append(replace(m, conditions={**m.conditions, **logged}))
            points_by_name |= {name: point for name, (point, _) in points.items()}
            rows = ", ".join(f"{name} {len(own)}" for name, (_, own) in points.items())
            notes.append(f"{m.source}: no column names the targets; as they lie, {rows} rows")
        else:
            placed_sets.append(m)
    names = [*dict.fromkeys(name for m in placed_sets for name in m.target_names)]
    one = names[0] if names else robot.tool_name
    if len(names) < 2:
        placed_sets = [
            replace(m, conditions={k: v for k, v in m.conditions.items() if not k.startswith("tool_")})
            for m in placed_sets
        ]
    T = frame(robot.tool.T[:3, :3], points_by_name.get(one, robot.tool.T[:3, 3]))
    more = tuple(Target(name, points_by_name.get(name, T[:3, 3])) for name in names[1:])
    arm = replace(robot, tool=replace(robot.tool, T=T), tool_name=one if more else "", targets=more)
    for m in placed_sets:
        refuse_nameless(m, arm)
    return arm, tuple(placed_sets), tuple(notes)


def _by_position(robot: Robot, m: Measurements) -> dict[str, tuple[Array, Array]]:
    """Return name of a target -> its point and its rows, as positions show; {} for a single target.

    Points are in the last link's frame, shape (3,) [m]; rows are indices.
    """
    alone = replace(robot, targets=(), tool_name="")
    if (targets := recognised(alone, m)) and targets.turning:
        if targets.points is None or targets.which is None:
            raise InputError(targets.in_words(m.source))
        points, which = targets.points, targets.which
    else:
        free = rigid(alone)
        one = median_error(free, m)
        if one < MIN_TARGET_DISTANCE / 2:
            return {}
        check_against(alone, m)
        tried = [_scattered(free, m, which) for which in _starts(robot, free, m)]
        points, which, error = min(
            tried, key=lambda t: t[2] / MAX_ERROR_RATIO ** len(t[0]), default=(np.empty((0, 3)), m.row, one)
        )
        if error >= MAX_ERROR_RATIO ** len(points) * one:
            return {}
    names = _names_of(points, robot)
    return {name: (points[k], np.flatnonzero(which == k)) for k, name in enumerate(names)}


def _starts(robot: Robot, free: Robot, m: Measurements) -> Iterator[Array]:
    """Yield initial assignments of rows to targets, shape (n,): by given targets, then by distance.

    The latter have two targets and more, around rows that are far from the others.
    """
    placed = place_frames(free, m)
    if robot.targets:
        yield _by_distances_to_points(placed, np.array([*_points_of(robot).values()]), m)
    seen = _in_last_link(placed, m)
    points = seen[:1]
    for _ in range(1, MAX_TARGETS if len(m) >= MIN_SEARCH_ROWS else 1):
        far = np.linalg.norm(seen[:, None] - points, axis=2).min(axis=1)
        # The next seed is the 85 % quantile, as the farthest rows may be outliers.
        points = np.vstack([points, seen[np.argsort(far)[int(0.85 * len(far))]]])
        yield np.argmin(np.linalg.norm(seen[:, None] - points, axis=2), axis=1)


def _by_distances_to_points(placed: Robot, points: Array, m: Measurements) -> Array:
    """Return the index of the given point that was measured in each row, shape (n,).

    points : in the last link's frame, shape (K, 3) [m]

    For every assignment of four rows the base is fitted to them; the one with the smallest median
    distance counts.
    """
    p, R = predicted(placed, m)
    assert m.position is not None
    away = (points - placed.tool.T[:3, 3]) @ placed.tool.T[:3, :3]
    x = p + np.einsum("nij,kj->kni", R, away)  # where each point would be
    four = np.linspace(0, len(m) - 1, 4).astype(int)
    some = np.linspace(0, len(m) - 1, min(len(m), 60)).astype(int)
    own, y = x[np.array(list(product(range(len(points)), repeat=4))), four], m.position[four]
    middle = own.mean(axis=1, keepdims=True)
    U, _, V = np.linalg.svd(np.swapaxes(own - middle, 1, 2) @ (y - y.mean(axis=0)))
    U[:, :, 2] *= np.sign(np.linalg.det(U @ V))[:, None]
    turn = U @ V  # of rows of coordinates, by Kabsch (1976)
    far = [(x[:, some] - c) @ T + y.mean(axis=0) - m.position[some] for c, T in zip(middle, turn, strict=True)]
    best = first_of_best(-np.median(np.linalg.norm(far, axis=3).min(axis=1), axis=1))
    off = (x - middle[best]) @ turn[best] + y.mean(axis=0) - m.position
    return np.asarray(np.argmin(np.linalg.norm(off, axis=2), axis=0))


def _scattered(free: Robot, m: Measurements, which: Array) -> tuple[Array, Array, float]:
    """Return the refined targets, each row's target, and the targets' greatest median error.

    which : index of the initial target of each row, shape (n,)
    Returns points (K, 3) [m] and indices (n,); the error [m] is infinite where targets coincide, or
    a single one remains
    """
    several = _with_targets(free, which)
    which = np.unique(_search(several, m, which, slice(None), 1.0), return_inverse=True)[1]
    several = _with_targets(free, which)
    named = _named(m, several, which)
    placed = place_frames(several, named)
    points = np.array([*_points_of(placed).values()])
    apart = len(points) > 1 and _lengths(points).min() > MIN_TARGET_DISTANCE
    e = errors(placed, named)
    return points, which, max(float(np.median(e[which == k])) for k in range(len(points))) if apart else np.inf


def _with_targets(free: Robot, which: Array) -> Robot:
    """Return the robot with as many targets as `which` has indices, all of them at its tool point.

    free : robot with unknown tool; which : index of the target of each row, from 0, shape (n,)
    """
    return replace(
        free, tool_name="0", targets=tuple(Target(str(k), free.tool.T[:3, 3]) for k in range(1, which.max() + 1))
    )


def _names_of(points: Array, robot: Robot) -> list[str]:
    """Return the names of given targets with the same mutual distances, else target1, ...

    points : in the last link's frame, shape (K, 3) [m]
    """
    points_by_name = _points_of(robot)
    for some in permutations(points_by_name, len(points)) if len(points) <= len(points_by_name) <= MAX_TARGETS else ():
        if (
            np.abs(_lengths(np.array([points_by_name[name] for name in some])) - _lengths(points)).max()
            < DISTANCE_TOLERANCE
        ):
            return [*some]
    return [f"target{k}" for k in range(1, len(points) + 1)]

"""Plausibility checks: refuse measurements that contradict the nominal robot before a solve."""

from collections.abc import Iterator, Sequence

import numpy as np

from casadical.core.basics import Array, Fault, FaultsError, InputError
from casadical.core.transforms import nearest_rotation
from casadical.effects import Session
from casadical.identification.accuracy import errors, positions_at, predicted
from casadical.identification.placement import place_frames
from casadical.identification.residuals import MAX_CACHED_DATA_POSES
from casadical.measurements.columns import MAX_TURNS
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.robot.kinematics import MIN_LOOP_MARGIN
from casadical.robot.robot import Robot

# Minimum number of poses in a part that is checked for another unit, and for the check whether
# orientations and positions are in one frame; number of poses in a sample of `gross_errors`.
MIN_POSES_PER_PART = 6
# Maximum median error of orientations [rad], after base and tool are rotated to fit, with which
# measurements are accepted.
MAX_ORIENTATION_ERROR_RAD = np.deg2rad(10.0)
# Maximum ratio of the orientations' error with the tool (or base) as given to that with it rotated
# to fit, with which the given one is accepted.
MAX_ORIENTATION_ERROR_RATIO = 3.0
# Number of iterations of a fit of frames in which poses with large errors are excluded.
EXCLUSION_ROUNDS = 3


def check_against(robot: Robot, *sets: Measurements) -> None:
    """Refuse measurements that this robot cannot have made.

    Raises InputError: wrong number of joints, joints out of range (all of them, FaultsError), loads
    in the wrong unit, an open loop, effects without a finite position, positions in the wrong unit,
    orientations of another robot.
    """
    for m in sets:
        if m.q.shape[1] != robot.n:
            raise InputError(f"{m.source}: {m.q.shape[1]} joint columns, but {robot.name} has {robot.n} joints")
    if faults := [fault for m in sets for fault in _out_of_range(robot, m)]:
        raise FaultsError(faults)
    for m in sets:
        links = sum(joint.body.mass for joint in robot.joints if joint.body)
        loads = m.conditions.get("payload_kg", np.zeros(1))
        if links and robot.masses == "declared" and loads.max() > 10.0 * links:
            value = f"{loads.max():.6g} kg"
            allowed = f"up to {10.0 * links:.6g}, of an arm of {links:.6g} kg"
            rows = tuple(map(int, m.row[loads > 10.0 * links]))
            raise FaultsError(
                [Fault(m.source, rows, "payload_kg", value, "is too heavy", allowed, "are these grams? give kg")]
            )
        refuse_undefined(robot, m)
        _refuse_implausible(robot, m)


def refuse_undefined(robot: Robot, m: Measurements) -> None:
    """Refuse poses at which a robot with effects has no finite position, such as a zero divisor.

    The other poses of pair distances are tested, too. Raises InputError with the row.
    """
    for k in range(0, len(m) if robot.effects else 0, MAX_CACHED_DATA_POSES):
        some = m[k : k + MAX_CACHED_DATA_POSES]
        for q in (some.q,) if some.other is None else (some.q, some.other):
            bad = np.asarray(~np.isfinite(positions_at(robot, some)(q)).all(axis=1))
            if bad.any():
                raise undefined(robot, some, bad)


def undefined(robot: Robot, m: Measurements, bad: Array) -> InputError:
    """Return the InputError (not raised) for rows at which the robot's model is not finite.

    bad : mask of these rows, shape (n,)
    """
    words = robot.effects_in_words and f" with {robot.effects_in_words}"
    such = f" ({bad.sum()} such rows)" if bad.sum() > 1 else ""
    return InputError(
        f"{m.source}: row {m.row[np.argmax(bad)]}: the model{words} gives no finite number there{such}; change the "
        "effect so that it does (does it divide by what may be zero?), or leave the rows out"
    )


def _out_of_range(robot: Robot, m: Measurements) -> Iterator[Fault]:
    """Yield a fault for each joint and each limit that its variable clearly exceeds.

    A fault lists the rows, the farthest first.
    """
    # Allowance beyond a joint's limit [rad or m], for poses that were commanded at the limit.
    allowance = 2e-3
    for i, joint in enumerate(robot.joints):
        unit, factor = ("deg", 180 / np.pi) if joint.kind == "revolute" else ("mm", 1e3)
        q, remedy = m.q[:, i], "correct the reading or the limits in the robot file"
        if joint.kind == "revolute" and np.abs(q).max() > MAX_TURNS * 2 * np.pi:
            remedy = "are these degrees? readings of joints that turn are in rad"
        limits = f"[{joint.lower * factor:.6g}, {joint.upper * factor:.6g}] {unit}"
        for far in (np.maximum(0, joint.lower - allowance - q), np.maximum(0, q - joint.upper - allowance)):
            if far.any():
                order = np.argsort(-far, kind="stable")[: np.count_nonzero(far)]
                yield Fault(
                    m.source,
                    tuple(map(int, m.row[order])),
                    f"q{i + 1}",
                    f"{q[order[0]] * factor:.6g} {unit}",
                    "is outside of the joint's range",
                    limits,
                    remedy,
                )


def _refuse_implausible(robot: Robot, m: Measurements) -> None:
    """Raise InputError for open four-bars, wrong orientations, and lengths in another unit."""
    if robot.loops and (smallest := least_margins(robot, m)).min() < MIN_LOOP_MARGIN:
        k = int(np.argmin(smallest))
        raise InputError(
            f"{m.source}: row {m.row[k]}: the four-bar cannot close there, or nearly not (margin {smallest[k]:.3f}; "
            f"at least {MIN_LOOP_MARGIN} is needed, {int((smallest < MIN_LOOP_MARGIN).sum())} such poses); "
            "check the signs and zeros of its joints, or leave these poses out"
        )
    if fault := fault_of_orientations(robot, m):
        raise InputError(f"{m.source}: {fault}")
    if len(m) > 3:
        # About so many poses are enough to see that lengths are in another unit.
        some = m[:: max(1, len(m) // 200)]
        p, _ = predicted(robot, some)
        if fault := _unit_fault(robot, some, p):
            raise InputError(f"{m.source}: {fault}")
        _refuse_another_unit_midway(robot, m, some, p)


def gross_errors(robot: Robot, sets: Sequence[Measurements]) -> tuple[tuple[int, int], ...]:
    """Return (set, pose) indices of poses that no fit of base and tool to the others explains.

    Base and tool are placed by random samples of a few poses; the sample with the least median
    error over all poses decides (least median of squares, Rousseeuw 1984), then the poses within
    five times the median. A pose is far off by ten times the median and by
    2 % of the reach, which no nominal robot reaches. No pose is returned for several
    targets or sessions, a given base, and of sets without positions, with too few poses, or where
    more than 40 % would be far off.
    """
    far: list[tuple[int, int]] = []
    several = bool(robot.targets) or any(isinstance(e, Session) for e in robot.effects)
    if several or robot.base.unknown != "pose":
        return ()
    for k, m in enumerate(sets):
        if m.position is None or len(m) < 2 * MIN_POSES_PER_PART:
            continue
        limit, rng = 0.02 * robot.reach, np.random.default_rng(0)
        e = errors(place_frames(robot, m), m)
        # 60 samples of six hold one without any of 30 % wrong poses with a probability of 99.9 %.
        for _ in range(60 if e.max() > limit else 0):
            some = rng.choice(len(m), MIN_POSES_PER_PART, replace=False)
            other = errors(place_frames(robot, m[some]), m)
            e = other if np.median(other) < np.median(e) else e
        for _ in range(EXCLUSION_ROUNDS if e.max() > limit else 0):
            e = errors(place_frames(robot, m[e <= 5.0 * np.median(e)]), m)
        bad = np.flatnonzero(e > max(limit, 10.0 * float(np.median(e))))
        far += [(k, int(i)) for i in bad] if len(bad) <= 0.4 * len(m) else []
    return tuple(far)


def fault_of_orientations(robot: Robot, m: Measurements) -> str:
    """Return why the measured orientations do not fit the nominal robot, with a remedy, as text.

    The text is empty where they fit, or none were measured.
    """
    if m.orientation is None:
        return ""
    alone = 'kind = "position" in problem.toml takes the positions alone'
    given = free = orientation_error(robot, m)
    least = np.deg2rad(1.0)  # up to it a tool as given is not compared with a rotated one
    if given > least:
        free = orientation_error(robot.with_unknown(tool="pose"), m)
    if free > MAX_ORIENTATION_ERROR_RAD:
        return (
            f"the orientations are {np.rad2deg(free):.3g} deg (median) from the nominal robot, however "
            "base and tool are turned: are the angles of another convention, or joints counted the other way? "
            f"casadical check searches for slips; {alone}"
        )
    if robot.tool.unknown != "pose" and given > max(least, MAX_ORIENTATION_ERROR_RATIO * free):
        return (
            f"the orientations are {np.rad2deg(given):.3g} deg (median) from the nominal robot, and would "
            f'be {np.rad2deg(free):.2g} deg with the tool turned: write unknown = "pose" in [tool] of the robot file '
            f"([[urdf.tool]] in problem.toml for a URDF), or {alone}"
        )
    off = frame_error(robot, m)
    if off:
        return (
            f"the orientations are {np.rad2deg(off):.3g} deg (median) from the nominal robot where its "
            "base stands by the positions: they are of another frame than these, as the controller's own would be; "
            f"{alone}"
        )
    return ""


def frame_error(robot: Robot, m: Measurements) -> float:
    """Return the median orientation error [rad] that shows another frame than the positions', or 0.

    The base is placed by the positions alone. Zero means that positions and orientations are in one
    frame, or that the data do not show the opposite.
    """
    free = robot.with_unknown(tool="pose")
    if robot.base.unknown != "pose" or m.position is None or len(m) < MIN_POSES_PER_PART:
        return 0.0
    inliers, placed = np.ones(len(m), dtype=bool), robot
    for _ in range(EXCLUSION_ROUNDS):
        placed = place_frames(free, m[inliers])
        length = np.linalg.norm(predicted(placed, m)[0] - m.position, axis=1)
        # Positions with more than five times the median error are excluded.
        inliers = length <= 5.0 * np.median(length)
    # A model this wrong does not determine the base's orientation.
    if np.median(length) > 0.02 * robot.reach:
        return 0.0
    off = orientation_error(placed.with_unknown(base="none"), m)
    # With a median error above 2 deg they are of another frame than the positions.
    return off if off > max(np.deg2rad(2.0), MAX_ORIENTATION_ERROR_RATIO * orientation_error(free, m)) else 0.0


def orientation_error(robot: Robot, m: Measurements) -> float:
    """Return the median angle [rad] between measured and computed orientations over the poses.

    At most 200 poses are compared. Base and tool are rotated to fit where their
    orientation is unknown (`unknown` = "pose").
    """
    assert m.orientation is not None
    some = m[np.linspace(0, len(m) - 1, min(len(m), 200)).astype(int)]
    seen, model = some.orientation, predicted(robot, some)[1]
    assert seen is not None
    base, tool = np.eye(3), np.eye(3)
    if robot.base.unknown == "pose" and robot.tool.unknown == "pose":
        # seen tool' = base model is linear in tool and base: the last right singular vector has
        # both, up to a factor.
        A = np.concatenate([np.kron(R, np.eye(3)) for R in seen])
        B = np.concatenate([np.kron(np.eye(3), R.T) for R in model])
        both = np.linalg.svd(np.hstack([A, -B]), full_matrices=False)[2][-1].reshape(2, 3, 3)
        both = both * np.sign(np.linalg.det(both[1]))
        tool, base = nearest_rotation(both[0]).T, nearest_rotation(both[1])
    angle = np.zeros(len(some))
    for _ in range(EXCLUSION_ROUNDS):
        near = angle <= 3 * np.median(angle)
        if robot.base.unknown == "pose":
            base = nearest_rotation(np.einsum("nij,nkj->ik", seen[near], (model @ tool)[near]))
        if robot.tool.unknown == "pose":
            tool = nearest_rotation(np.einsum("nji,njk->ik", (base @ model)[near], seen[near]))
        trace = np.einsum("nij,nij->n", base @ model @ tool, seen)
        angle = np.arccos(np.clip((trace - 1) / 2, -1, 1))
    return float(np.median(angle))


def _refuse_another_unit_midway(robot: Robot, m: Measurements, some: Measurements, p: Array) -> None:
    """Raise InputError where consecutive rows of a table are in another unit than the others.

    some : a sample of the poses m; p : its positions by the model, shape (n, 3) [m]
    """
    by_row = _by_row(some)
    parts, said = [], ""
    # At most five parts are checked, where the computed positions extend over 0.3 of the reach.
    for part in np.array_split(by_row, max(1, min(5, len(by_row) // MIN_POSES_PER_PART))):
        if np.linalg.norm(np.ptp(p[part], axis=0)) > 0.3 * robot.reach:
            fault = _unit_fault(robot, some, p, part)
            parts += [(some.row[part[0]], some.row[part[-1]])] if fault else []
            said = said or fault
    if said:
        runs = " and ".join(f"{a} to {b}" for a, b in _runs(robot, m, parts))
        raise InputError(
            f"{m.source}: rows {runs} are in another unit than the others: {said}. One unit a column: correct these "
            "rows, or make two tables of it"
        )


def _by_row(m: Measurements) -> Array:
    """Return the indices of the poses with a weight, in the order of their rows."""
    order = np.argsort(m.row, kind="stable")
    return np.asarray(order[m.weight[order] > 0])


def _unit_fault(robot: Robot, m: Measurements, p: Array, which: Array | slice = slice(None)) -> str:
    """Return a sentence if measured lengths seem to be mm read as m, or the reverse; else empty.

    p : positions of the poses m by the model, shape (n, 3) [m]
    which : indices of the poses that are judged together, all by default
    """
    arrays = {name: values[which] for name, values in m.arrays.items()}
    return find_kind(m.kind).unit_fault(arrays, p[which], positions_at(robot, m[which]), robot.reach)


def _runs(robot: Robot, m: Measurements, parts: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return first and last row number of each run of rows in another unit.

    Each run is grown row by row from a part in which the fault was found.
    """
    by_row, (p, _) = _by_row(m), predicted(robot, m)
    rows = m.row[by_row]
    runs: list[tuple[int, int]] = []
    for begin, end in parts:
        first, last = (int(k) for k in np.searchsorted(rows, (begin, end)))
        few = np.linspace(first, last, MIN_POSES_PER_PART).astype(int)

        def in_other_unit(k: int, few: Array = few) -> bool:
            """Return whether a pose next to a faulty part is in another unit, too."""
            # The row is repeated to outweigh the others, for faults that a median shows.
            which = by_row[[*few, *[k] * (len(few) + 1)]]
            return bool(_unit_fault(robot, m, p, which))

        while first > 0 and in_other_unit(first - 1):
            first -= 1
        while last + 1 < len(rows) and in_other_unit(last + 1):
            last += 1
        runs.append((int(rows[first]), int(rows[last])))
    return list(dict.fromkeys(runs))


def least_margins(robot: Robot, m: Measurements) -> Array:
    """Return the smallest margin of the robot's four-bars at each pose, shape (n,), at most 1.

    It is the squared sine between rocker and diagonal (`kinematics.loop_margin`): 1 where they are
    perpendicular, negative where a four-bar cannot close, 0 also where it is undefined.
    """
    w = m.condition_matrix(robot.conditions, robot.declared)
    (margin,) = robot.model.evaluate(("margin",), m.q, w, robot.parameters.values)
    # The margin is NaN where the crank's end is on the driven joint: the rocker's direction is
    # undefined.
    return np.asarray(np.nan_to_num(margin.min(axis=0), nan=0.0))

"""Refuse measurements that contradict the nominal robot, before a solve."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from casadical.core.basics import Array, Fault, FaultsError, InputError
from casadical.core.transforms import nearest_rotation
from casadical.identification.accuracy import positions_at, predicted
from casadical.identification.placement import place_frames
from casadical.identification.residuals import HELD
from casadical.measurements.columns import MAX_TURNS
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.robot.kinematics import LEAST_MARGIN
from casadical.robot.robot import Robot

# Parts of a table in the order of its rows, of which each may have its unit; poses of one, and share of the reach over
# which the model moves in one, from which on its unit is seen.
PARTS, LEAST_POSES, MOVED = 5, 6, 0.3
# Orientations that are off by more [rad] at most poses, base and tool turned as they fit, are no measured ones; with
# the tool as it is given they may be off by so much, and so many times as far as with another one.
TURNED, GIVEN, TIMES = np.deg2rad(10.0), np.deg2rad(1.0), 3.0
# Orientations that are off by more [rad] with the base where the positions put it are of another frame.
OTHER_FRAME = np.deg2rad(2.0)
# Poses that tell it, and rounds in which poses that are far off do not count.
TURNS, ROUNDS = 200, 3
# A reading may lie so far beyond a joint's limit [rad or m], as of a pose that was commanded there.
BEYOND = 2e-3
# A load may weigh so many times what the arm's links do.
HEAVY = 10.0


def check_against(robot: Robot, *sets: Measurements) -> None:
    """Refuse measurements that this robot cannot have made.

    Raises InputError: wrong number of joints, joints out of range (all of them, FaultsError), loads in the wrong unit,
    an open loop, effects without a finite position, positions in the wrong unit, orientations of another robot.
    """
    for m in sets:
        if m.q.shape[1] != robot.n:
            raise InputError(f"{m.source}: {m.q.shape[1]} joint columns, but {robot.name} has {robot.n} joints")
    if faults := [fault for m in sets for fault in _out_of_range(robot, m)]:
        raise FaultsError(faults)
    for m in sets:
        _refuse_payload(robot, m)
        refuse_undefined(robot, m)
        _refuse_implausible(robot, m)


def refuse_undefined(robot: Robot, m: Measurements) -> None:
    """Raises InputError, with the row, where a robot with effects has no finite position, as with a divisor of zero."""
    for k in range(0, len(m) if robot.effects else 0, HELD):
        some = m[k : k + HELD]
        for q in (some.q,) if some.other is None else (some.q, some.other):
            bad = np.asarray(~np.isfinite(predicted(robot, replace(some, q=q))[0]).all(axis=1))
            if bad.any():
                raise undefined(robot, some, bad)


def undefined(robot: Robot, m: Measurements, bad: Array) -> InputError:
    """The error that a robot's model gives no finite number at some rows; bad : whether at each, shape (n,)."""
    words = robot.effects_in_words and f" with {robot.effects_in_words}"
    such = f" ({bad.sum()} such rows)" if bad.sum() > 1 else ""
    return InputError(
        f"{m.source}: row {m.row[np.argmax(bad)]}: the model{words} gives no finite number there{such}; change the "
        "effect so that it does (does it divide by what may be zero?), or leave the rows out"
    )


def _refuse_payload(robot: Robot, m: Measurements) -> None:
    """Refuses loads that weigh so much more than the arm, where its masses are known, that they are no kilograms."""
    links = sum(joint.body.mass for joint in robot.joints if joint.body)
    loads = m.conditions.get("payload_kg", np.zeros(1))
    if links and robot.masses == "declared" and loads.max() > HEAVY * links:
        value, allowed = f"{loads.max():.6g} kg", f"up to {HEAVY * links:.6g}, of an arm of {links:.6g} kg"
        rows = tuple(map(int, m.row[loads > HEAVY * links]))
        raise FaultsError(
            [Fault(m.source, rows, "payload_kg", value, "is too heavy", allowed, "are these grams? give kg")]
        )


def _out_of_range(robot: Robot, m: Measurements) -> Iterator[Fault]:
    """Readings beyond the limits, of each joint those on one side, with the farthest one."""
    for i, joint in enumerate(robot.joints):
        unit, factor = ("deg", 180 / np.pi) if joint.kind == "revolute" else ("mm", 1e3)
        q, remedy = m.q[:, i], "correct the reading or the limits in the robot file"
        if joint.kind == "revolute" and np.abs(q).max() > MAX_TURNS * 2 * np.pi:
            remedy = "are these degrees? readings of joints that turn are in rad"
        limits = f"[{joint.lower * factor:.6g}, {joint.upper * factor:.6g}] {unit}"
        for far in (np.maximum(0, joint.lower - BEYOND - q), np.maximum(0, q - joint.upper - BEYOND)):
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
    if robot.loops and (smallest := least_margins(robot, m)).min() < LEAST_MARGIN:
        k = int(np.argmin(smallest))
        raise InputError(
            f"{m.source}: row {m.row[k]}: the four-bar cannot close there, or nearly not (margin {smallest[k]:.3f}; "
            f"at least {LEAST_MARGIN} is needed, {int((smallest < LEAST_MARGIN).sum())} such poses); "
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


def fault_of_orientations(robot: Robot, m: Measurements) -> str:
    """Why the robot cannot have had the measured orientations, and what to do; empty where it can, or has none."""
    if m.orientation is None:
        return ""
    alone = 'kind = "position" in problem.toml takes the positions alone'
    given = turned_off(robot, m)
    free = turned_off(replace(robot, tool=replace(robot.tool, unknown="pose")), m) if given > GIVEN else given
    if free > TURNED:
        return (
            f"the orientations are {np.rad2deg(free):.3g} deg (median) from the nominal robot, however "
            "base and tool are turned: are the angles of another convention, or joints counted the other way? "
            f"casadical check searches for slips; {alone}"
        )
    if robot.tool.unknown != "pose" and given > max(GIVEN, TIMES * free):
        return (
            f"the orientations are {np.rad2deg(given):.3g} deg (median) from the nominal robot, and would "
            f'be {np.rad2deg(free):.2g} deg with the tool turned: write unknown = "pose" in [tool] of the robot file '
            f"([[urdf.tool]] in problem.toml for a URDF), or {alone}"
        )
    off = of_another_frame(robot, m)
    if off:
        return (
            f"the orientations are {np.rad2deg(off):.3g} deg (median) from the nominal robot where its "
            "base stands by the positions: they are of another frame than these, as the controller's own would be; "
            f"{alone}"
        )
    return ""


def of_another_frame(robot: Robot, m: Measurements) -> float:
    """How far [rad] orientations are off with the base where the positions put it; 0 where they are of one frame."""
    free = replace(robot, tool=replace(robot.tool, unknown="pose"))
    if robot.base.unknown != "pose" or m.position is None or len(m) < LEAST_POSES:
        return 0.0
    kept, placed = np.ones(len(m), dtype=bool), robot
    for _ in range(ROUNDS):
        placed = place_frames(free, m[kept])
        length = np.linalg.norm(predicted(placed, m)[0] - m.position, axis=1)
        # Positions with so many times the median error do not count for that, nor any where the
        # model is off by this share of its reach.
        kept = length <= 5.0 * np.median(length)
    if np.median(length) > 0.02 * robot.reach:
        return 0.0
    off = turned_off(replace(placed, base=replace(placed.base, unknown="none")), m)
    return off if off > max(OTHER_FRAME, TIMES * turned_off(free, m)) else 0.0


def turned_off(robot: Robot, m: Measurements) -> float:
    """Median angle [rad] by which measured orientations are off, what is unknown of base and tool turned to fit."""
    assert m.orientation is not None
    some = m[np.linspace(0, len(m) - 1, min(len(m), TURNS)).astype(int)]
    seen, model = some.orientation, predicted(robot, some)[1]
    assert seen is not None
    base, tool = np.eye(3), np.eye(3)
    if robot.base.unknown == "pose" and robot.tool.unknown == "pose":
        # seen tool' = base model is linear in both: the least singular vector is both, times a factor.
        A = np.concatenate([np.kron(R, np.eye(3)) for R in seen])
        B = np.concatenate([np.kron(np.eye(3), R.T) for R in model])
        both = np.linalg.svd(np.hstack([A, -B]), full_matrices=False)[2][-1].reshape(2, 3, 3)
        both = both * np.sign(np.linalg.det(both[1]))
        tool, base = nearest_rotation(both[0]).T, nearest_rotation(both[1])
    angle = np.zeros(len(some))
    for _ in range(ROUNDS):
        near = angle <= 3 * np.median(angle)
        if robot.base.unknown == "pose":
            base = nearest_rotation(np.einsum("nij,nkj->ik", seen[near], (model @ tool)[near]))
        if robot.tool.unknown == "pose":
            tool = nearest_rotation(np.einsum("nji,njk->ik", (base @ model)[near], seen[near]))
        trace = np.einsum("nij,nij->n", base @ model @ tool, seen)
        angle = np.arccos(np.clip((trace - 1) / 2, -1, 1))
    return float(np.median(angle))


def _refuse_another_unit_midway(robot: Robot, m: Measurements, some: Measurements, p: Array) -> None:
    """Raise InputError where rows are in another unit; p : positions of `some` by the model, shape (n, 3) [m]."""
    by_row = _by_row(some)
    parts, said = [], ""
    for part in np.array_split(by_row, max(1, min(PARTS, len(by_row) // LEAST_POSES))):
        if np.linalg.norm(np.ptp(p[part], axis=0)) > MOVED * robot.reach:
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
    """Places of the poses that count, in the order of their rows."""
    order = np.argsort(m.row, kind="stable")
    return np.asarray(order[m.weight[order] > 0])


def _unit_fault(robot: Robot, m: Measurements, p: Array, which: Array | slice = slice(None)) -> str:
    """What is wrong with the unit of some of the poses; p : positions of the model, shape (n, 3) [m]."""
    arrays = {name: values[which] for name, values in m.arrays.items()}
    return find_kind(m.kind).unit_fault(arrays, p[which], lambda q: positions_at(robot, m[which])(q), robot.reach)


def _runs(robot: Robot, m: Measurements, parts: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """First and last row of each run in another unit, grown row by row from the parts that were found."""
    by_row, (p, _) = _by_row(m), predicted(robot, m)
    rows = m.row[by_row]
    runs: list[tuple[int, int]] = []
    for begin, end in parts:
        first, last = (int(k) for k in np.searchsorted(rows, (begin, end)))
        few = np.linspace(first, last, LEAST_POSES).astype(int)

        def beside(k: int, few: Array = few) -> bool:
            # As often as all others together, for faults that a median tells.
            which = by_row[[*few, *[k] * (len(few) + 1)]]
            return bool(_unit_fault(robot, m, p, which))

        while first > 0 and beside(first - 1):
            first -= 1
        while last + 1 < len(rows) and beside(last + 1):
            last += 1
        runs.append((int(rows[first]), int(rows[last])))
    return list(dict.fromkeys(runs))


def least_margins(robot: Robot, m: Measurements) -> Array:
    """The smallest margin of the robot's four-bars at each pose, shape (n,): 1 is square, below 0 they are open."""
    w = m.condition_matrix(robot.conditions, robot.declared)
    (margin,) = robot.model.evaluate(("margin",), m.q, w, robot.parameters.values)
    # Not a number where the crank's end lies on the driven joint: the rocker's direction is then open.
    return np.asarray(np.nan_to_num(margin.min(axis=0), nan=0.0))

"""Refuse measurements that contradict the nominal robot, before a solve."""

from collections.abc import Sequence

import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.identification.accuracy import positions_at, predicted
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.robot.kinematics import LEAST_MARGIN
from casadical.robot.robot import Robot

# About so many poses are enough to see that lengths are in another unit.
UNIT_POSES = 200
# Parts of a table in the order of its rows, of which each may have its unit; poses of one, and share of the reach over
# which the model moves in one, from which on its unit is seen.
PARTS, LEAST_POSES, MOVED = 5, 6, 0.3
# A reading may lie so far beyond a joint's limit [rad or m], as of a pose that was commanded there.
BEYOND = 2e-3


def check_against(robot: Robot, m: Measurements) -> None:
    """Refuse measurements that this robot cannot have made.

    Raises InputError: wrong number of joints, joints out of range, an open loop, positions in the wrong unit.
    """
    if m.q.shape[1] != robot.n:
        raise InputError(f"{m.source}: {m.q.shape[1]} joint columns, but {robot.name} has {robot.n} joints")
    lower = np.array([j.lower for j in robot.joints])
    upper = np.array([j.upper for j in robot.joints])
    outside = (m.q < lower - BEYOND) | (m.q > upper + BEYOND)
    if outside.any():
        k, i = (int(v[0]) for v in np.nonzero(outside))
        unit, factor = ("deg", 180 / np.pi) if robot.joints[i].kind == "revolute" else ("mm", 1e3)
        raise InputError(
            f"{m.source}: row {m.row[k]}, q{i + 1} = {m.q[k, i] * factor:.6g} {unit} is outside of the joint's range "
            f"[{lower[i] * factor:.6g}, {upper[i] * factor:.6g}] {unit} ({outside.any(axis=1).sum()} such poses); "
            "correct the reading or the limits in the robot file"
        )
    if robot.loops:
        _refuse_open_loop(robot, m)
    if len(m) > 3:
        some = m[:: max(1, len(m) // UNIT_POSES)]
        p, _ = predicted(robot, some)
        fault = find_kind(m.kind).unit_fault(some.arrays, p, positions_at(robot, some), robot.reach)
        if fault:
            raise InputError(f"{m.source}: {fault}")
        _refuse_another_unit_midway(robot, m, some, p)


def _refuse_another_unit_midway(robot: Robot, m: Measurements, some: Measurements, p: Array) -> None:
    """Raise InputError where rows are in another unit; p : positions of `some` by the model, shape (n, 3) [m]."""
    by_row = _by_row(some)
    found, said = [], ""
    for part in np.array_split(by_row, max(1, min(PARTS, len(by_row) // LEAST_POSES))):
        if np.linalg.norm(np.ptp(p[part], axis=0)) > MOVED * robot.reach:
            fault = _unit_fault(robot, some, p, part)
            found += [(some.row[part[0]], some.row[part[-1]])] if fault else []
            said = said or fault
    if said:
        runs = " and ".join(f"{a} to {b}" for a, b in _runs(robot, m, found))
        raise InputError(
            f"{m.source}: rows {runs} are in another unit than the others: {said}. One unit a column: correct these "
            "rows, or make two tables of it"
        )


def _by_row(m: Measurements) -> Array:
    """Places of the poses that count, in the order of their rows."""
    order = np.argsort(m.row, kind="stable")
    return np.asarray(order[m.weight[order] > 0])


def _unit_fault(robot: Robot, m: Measurements, p: Array, which: Array) -> str:
    """What is wrong with the unit of some poses; p : positions of the model, shape (n, 3) [m]."""
    some = m[which]
    return find_kind(m.kind).unit_fault(some.arrays, p[which], positions_at(robot, some), robot.reach)


def _runs(robot: Robot, m: Measurements, found: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """First and last row of each run in another unit, grown row by row from the parts that were found."""
    by_row, (p, _) = _by_row(m), predicted(robot, m)
    rows = m.row[by_row]
    runs: list[tuple[int, int]] = []
    for begin, end in found:
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


def _refuse_open_loop(robot: Robot, m: Measurements) -> None:
    smallest = least_margins(robot, m)
    k = int(np.argmin(smallest))
    if smallest[k] < LEAST_MARGIN:
        raise InputError(
            f"{m.source}: row {m.row[k]}: the four-bar cannot close there, or nearly not (margin {smallest[k]:.3f}; "
            f"at least {LEAST_MARGIN} is needed, {int((smallest < LEAST_MARGIN).sum())} such poses); "
            "check the signs and zeros of its joints, or leave these poses out"
        )

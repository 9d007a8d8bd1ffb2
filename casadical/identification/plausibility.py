"""Refuse measurements that contradict the nominal robot, before a solve."""

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
        _refuse_another_unit_midway(robot, some, p)


def _refuse_another_unit_midway(robot: Robot, m: Measurements, p: Array) -> None:
    """Raise InputError where some rows are in another unit; p : positions of the model, shape (n, 3) [m]."""
    by_row = np.argsort(m.row, kind="stable")
    by_row = by_row[m.weight[by_row] > 0]
    found, said = [], ""
    for part in np.array_split(by_row, max(1, min(PARTS, len(by_row) // LEAST_POSES))):
        if np.linalg.norm(np.ptp(p[part], axis=0)) > MOVED * robot.reach:
            some = m[part]
            fault = find_kind(m.kind).unit_fault(some.arrays, p[part], positions_at(robot, some), robot.reach)
            found += [some.row.min(), some.row.max()] if fault else []
            said = said or fault
    if said:
        raise InputError(
            f"{m.source}: between rows {min(found)} and {max(found)} another unit than in the others: {said}. One unit "
            "a column: correct these rows, or make two tables of it"
        )


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

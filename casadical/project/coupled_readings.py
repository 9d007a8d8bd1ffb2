"""Readings of joints without an encoder of their own: mimic joints, passive ones of palletisers, locked ones."""

from dataclasses import replace

import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.measurements.columns import Columns
from casadical.robot.robot import Robot

# Logged readings of such a joint may differ by so much from what the robot file says [rad or m].
WITHIN = 2e-3


def with_coupled(columns: Columns, robot: Robot) -> Columns:
    """The table with the readings of coupled and locked joints, in radians or metres where they were not logged.

    Raises InputError for a logged one that is elsewhere than the robot file says, with file, row and column.
    """
    coupled = [i for i, joint in enumerate(robot.joints, 1) if joint.coupling is not None]
    if not coupled:
        return columns
    read: dict[int, Array] = {}
    for i, joint in enumerate(robot.joints, 1):
        units = ("_deg", "_rad") if joint.kind == "revolute" else ("_mm", "_m")
        if i not in coupled or any(f"q{i}{u}" in columns.table for u in units):
            read[i] = columns.si(f"q{i}", units)
    q = np.column_stack([read.get(i, np.zeros(len(columns.table))) for i in robot.numbers])
    made = robot.coupled(q)
    table = columns.table
    for i in coupled:
        turning = robot.joints[i - 1].kind == "revolute"
        if i not in read:
            table = table.assign(**{f"q{i}_{'rad' if turning else 'm'}": made[:, i - 1]})
            continue
        off = np.abs(q[:, i - 1] - made[:, i - 1])
        if off.max() > WITHIN:
            _refuse(columns, robot, i, int(np.argmax(off)), q, made)
    return replace(columns, table=table)


def _refuse(columns: Columns, robot: Robot, i: int, row: int, q: Array, made: Array) -> None:
    factor, unit = (180 / np.pi, "deg") if robot.joints[i - 1].kind == "revolute" else (1e3, "mm")
    coupling = robot.joints[i - 1].coupling
    what = "follows other joints and would be" if coupling and coupling.follows else "is locked"
    read, said = (f"{factor * v[row, i - 1]:.6g} {unit}" for v in (q, made))
    raise InputError(
        f"{columns.at(row)}, column q{i}: {read}, and by the robot file joint {i} {what} at {said}: no pose can be "
        f"computed from both. Leave `follows` and `at_{unit}` out of its row if it moves by itself; else leave the "
        f"column q{i} out"
    )

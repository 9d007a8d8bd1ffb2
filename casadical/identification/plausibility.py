"""Refuse measurements that a robot cannot have made, before any solve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from casadical.core.errors import InputError
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import Measurements
from casadical.robot.kinematics import LEAST_MARGIN
from casadical.robot.robot import Robot


def check_against(robot: Robot, m: Measurements) -> None:
    """Refuse measurements that this robot cannot have made.

    Raises InputError: wrong number of joints, joints out of range, an open loop, positions in the wrong unit.
    """
    if m.q.shape[1] != robot.n:
        raise InputError(f"{m.source}: {m.q.shape[1]} joint columns, but {robot.name} has {robot.n} joints")
    lower = np.array([j.lower for j in robot.joints])
    upper = np.array([j.upper for j in robot.joints])
    outside = (m.q < lower - 1e-6) | (m.q > upper + 1e-6)
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
    if m.position is not None:
        _refuse_wrong_length_unit(robot, m)
    if m.distance is not None:
        _refuse_wrong_distance_unit(robot, m)


def _refuse_open_loop(robot: Robot, m: Measurements) -> None:
    w = m.condition_matrix(robot.conditions, robot.declared)
    (margin,) = robot.model.evaluate(("margin",), m.q, w, robot.parameters.values)
    # Not a number where the crank's end lies on the driven joint: the rocker's direction is then open.
    smallest = np.nan_to_num(margin.min(axis=0), nan=0.0)
    k = int(np.argmin(smallest))
    if smallest[k] < LEAST_MARGIN:
        raise InputError(
            f"{m.source}: row {m.row[k]}: the four-bar cannot close there, or nearly not (margin {smallest[k]:.3f}; "
            f"at least {LEAST_MARGIN} is needed, {int((smallest < LEAST_MARGIN).sum())} such poses); "
            "check the signs and zeros of its joints, or leave these poses out"
        )


def _refuse_wrong_length_unit(robot: Robot, m: Measurements) -> None:
    assert m.position is not None
    spread = float(np.linalg.norm(np.ptp(m.position, axis=0)))
    if len(m) > 3 and spread > 20 * robot.reach:
        raise InputError(
            f"{m.source}: positions spread over {spread:.4g} m, but {robot.name} reaches {robot.reach:.3g} m; "
            "are they millimetres? name the columns x_mm, y_mm, z_mm"
        )
    some = m[:: max(1, len(m) // 200)]
    nominal, _ = predicted(robot, some)
    moved = float(np.linalg.norm(np.ptp(nominal, axis=0)))
    if len(m) > 3 and spread < 0.02 * moved:
        raise InputError(
            f"{m.source}: positions spread over {1e3 * spread:.4g} mm only, the model over {1e3 * moved:.4g} mm; "
            "are they metres? name the columns x_m, y_m, z_m"
        )


def _refuse_wrong_distance_unit(robot: Robot, m: Measurements) -> None:
    """By the model's own distances; to an unknown point, by how far apart two ends of distances to it can be."""
    assert m.distance is not None
    nominal, _ = predicted(robot, m)
    if m.kind == "distance" and m.target is None:
        moved = float(np.linalg.norm(np.ptp(nominal, axis=0)))
        too_long, too_short = np.ptp(m.distance) > 20 * robot.reach, m.distance.max() < 0.02 * moved
    else:
        far = m.target if m.other is None else predicted(robot, replace(m, q=m.other))[0]
        ratio = np.median(m.distance) / max(float(np.median(np.linalg.norm(nominal - far, axis=1))), 1e-3)
        too_long, too_short = ratio > 100, ratio < 0.01
    if len(m) > 3 and (too_long or too_short):
        used, other = ("metres", "mm") if too_long else ("millimetres", "m")
        raise InputError(
            f"{m.source}: distances up to {m.distance.max():.4g} m do not fit {robot.name}, which reaches "
            f"{robot.reach:.3g} m; they are taken as {used}: should the column be named distance_{other}?"
        )

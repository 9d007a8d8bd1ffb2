"""Poses that hold the tool at given places, by Gauss-Newton from random readings."""

import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.pose_selection.candidates import draw, expected
from casadical.pose_selection.information import by_joints
from casadical.pose_selection.workspace import Workspace
from casadical.robot.robot import Robot

STEPS, CLOSE = 40, 1e-7
# Readings tried for each that is wanted.
TRIED = 4
# Of a step [rad or m], and the share of the Jacobian's greatest singular value from which on a direction counts.
LONGEST, LEAST = 0.3, 1e-2
# A socket that fewer poses hold, of 8 times as many tried, is out of reach.
FEWEST = 4


def held_in(
    robot: Robot, places: Array, count: int, workspace: Workspace, rng: np.random.Generator
) -> tuple[Array, Array]:
    """About so many readings that hold the tool at the places, shape (k, 3) [m], and at which, counted from 0.

    Places that the robot hardly reaches have none.
    """
    each = -(-count // len(places))
    lower, upper = workspace.ranges(robot)
    found, which = [], []
    for k, place in enumerate(places):
        q = draw(robot, TRIED * each, workspace, rng)
        for _ in range(STEPS):
            m = expected(robot, q, {}, "sockets")
            assert m.position is not None
            left = place - m.position
            U, s, Vt = np.linalg.svd(by_joints(robot, m), full_matrices=False)
            inverse = np.where(s > LEAST * s[:, :1], 1 / np.maximum(s, 1e-12), 0.0)
            step = np.einsum("nki,nk,njk,nj->ni", Vt, inverse, U, left)
            q = robot.coupled(np.clip(q + np.clip(step, -LONGEST, LONGEST), lower, upper))
        at = expected(robot, q, {}, "sockets").position
        assert at is not None
        good = np.flatnonzero((np.linalg.norm(at - place, axis=1) < CLOSE) & workspace.allows(robot, q))[:each]
        found.append(q[good])
        which.append(np.full(len(good), float(k)))
    return np.concatenate([np.zeros((0, robot.n)), *found]), np.concatenate([np.zeros(0), *which])


def reached(robot: Robot, places: Array, count: int, workspace: Workspace, rng: np.random.Generator) -> Array:
    """Those of the places, shape (k, 3) [m], that the robot reaches well. Raises InputError where they are fewer."""
    _, which = held_in(robot, places, 2 * FEWEST * len(places), workspace, rng)
    there = np.bincount(which.astype(int), minlength=len(places)) >= FEWEST
    if there.sum() < count:
        out = int(np.argmin(there))
        text = ", ".join(f"{1e3 * x:.0f}" for x in places[out])
        raise InputError(
            f"{robot.name} reaches {there.sum()} of {len(places)} sockets, and {count} are wanted: socket {out + 1} at "
            f"({text}) mm, for one, is out of reach or not allowed; give other places"
        )
    return np.asarray(places[there])

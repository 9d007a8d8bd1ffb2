"""The next poses, planned with what is known by now, and how many more gain something."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.measurements.noise import Noise
from casadical.pose_selection.candidates import draw
from casadical.pose_selection.pose_order import distances
from casadical.pose_selection.pose_search import select_poses
from casadical.pose_selection.stopping_rule import forecast
from casadical.pose_selection.workspace import Workspace, places_about
from casadical.project.live.estimate import Estimate
from casadical.project.new.synthetic import one_turn
from casadical.robot.robot import Robot

# Poses that are chosen from, poses of the task, poses planned at once, and looked at beyond what is measured.
POOL, TASK, BATCH, BEYOND = 300, 150, 8, 60
# That are planned before anything is known; a pose is done that was measured within so much [rad or m].
FIRST, DONE = 12, 0.02
# Without a workspace poses stay so far above the plane that the robot stands on [m].
CLEARANCE, LEAST = 0.05, 1e-6
# Of a coordinate [m], before readings tell it.
NOISE = 5e-5


@dataclass(frozen=True, eq=False)
class Ahead:
    """What to measure.

    q : next poses in order, shape (k, joints) [rad or m]; to_go : how many more gain something, None: not known
    """

    robot: Robot
    q: Array
    to_go: int | None
    words: str


def look_ahead(
    robot: Robot, found: Estimate | None, room: Workspace | None, target: float | None, before: Array
) -> Ahead:
    """The next poses of a robot, those first that are near to where it is.

    found : None of too few readings; room : None: above the plane that it stands on; target : accuracy wanted [m]
    before : joints of all readings, shape (n, joints), where the robot stands last
    Raises InputError where the room allows no pose.
    """
    m = found.m if found else None
    done = len(m) if m is not None else 0
    noise = Noise(found.sigma if found else NOISE)
    robot = replace(robot, targets=(), tool_name="")
    among, said = candidates(robot, room, done)
    count = BATCH if found else FIRST + len(before)
    chosen = select_poses(
        robot,
        among,
        count,
        measured=m,
        noise=noise,
        restarts=1,
        pool=len(among),
        free=_FREE,
        prior=found.prior if found else None,
    ).q
    if not found and len(before):  # the same poses as after the reading before, less those that are done
        away = np.abs(chosen[:, None] - before[None]).max(axis=2).min(axis=1)
        chosen = chosen[away > DONE] if (away > DONE).any() else chosen
    order = _nearest_first(robot, chosen, before[-1] if len(before) else None)
    to_go, words = None, f"at least {max(1, FIRST - len(before))} more"
    if found:
        course = forecast(
            robot, done + BEYOND, workspace=room, measured=m, noise=noise, pool=POOL, free=_FREE, prior=found.prior
        )
        last = course.enough(target) if target else course.stop()
        to_go = None if last is None else max(0, last - done)
        words = _words(to_go, target, 1e3 * float(course.error[0]))
    return Ahead(robot, chosen[order], to_go, f"{words}{said}")


_FREE = ("kinematic", "compliance")


def _words(to_go: int | None, target: float | None, now: float) -> str:
    goal = f"{1e3 * target:.3g} mm are reached" if target else "ten more gain less than a tenth"
    expected_now = f"{now:.3f} mm to expect of the robot now"
    if to_go is None:
        return f"{expected_now}; more than {BEYOND} poses until {goal}"
    return f"{expected_now}; enough: {goal}" if to_go == 0 else f"{expected_now}; about {to_go} more until {goal}"


def _nearest_first(robot: Robot, q: Array, near: Array | None) -> list[int]:
    """An order of short travel, each pose the nearest to the one before."""
    D = distances(robot, q if near is None else np.vstack([q, near]))
    left, at, order = set(range(len(q))), len(q) if near is not None else 0, []
    while left:
        at = min(left, key=lambda k: D[at, k])
        left.remove(at)
        order.append(at)
    return order


def candidates(robot: Robot, room: Workspace | None, seed: int) -> tuple[Array, str]:
    """Poses that may be measured, shape (POOL, joints), and what was not checked. Raises InputError of a room."""
    rng = np.random.default_rng(seed)
    if room is not None:
        return draw(one_turn(robot), POOL, room, rng, to_ends=True), ""
    own = one_turn(in_base(robot))
    for clearance in (CLEARANCE, -LEAST):  # some robots have axes in the plane that they stand on
        with suppress(InputError):
            return draw(own, POOL, Workspace(floor=0.0, clearance=clearance), rng, to_ends=True), ""
    return draw(own, POOL, Workspace(), rng, to_ends=True), "; floor and obstacles were not checked: --room FILE.toml"


def arms(robot: Robot, q: Array) -> Array:
    """Points of the arm at joints q, shape (n, joints + 1, 3), from base to target [mm]."""
    points = places_about(robot, q)[0]
    return (1e3 * np.concatenate([np.zeros((len(q), 1, 3)), points], axis=1)).round(1)


def in_base(robot: Robot) -> Robot:
    """The robot with the base's own frame as measuring frame."""
    return replace(robot, base=replace(robot.base, T=np.eye(4)))


def task_readings(robot: Robot) -> Array:
    """Readings all over the joints' ranges, shape (TASK, joints), at which the error to expect is stated."""
    return draw(robot, TASK, Workspace(), np.random.default_rng(1))

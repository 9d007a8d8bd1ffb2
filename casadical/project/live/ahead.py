"""The next poses, planned with what is known by now, and how many more gain something."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.identification.least_squares import LeastSquares
from casadical.identification.prior import Prior
from casadical.identification.reduction import independent_parameters
from casadical.measurements.measurements import Measurements
from casadical.measurements.noise import Noise
from casadical.pose_selection.candidates import Circumstances, draw, expected
from casadical.pose_selection.design_problem import prepare
from casadical.pose_selection.experimental_design import search
from casadical.pose_selection.information import MM
from casadical.pose_selection.instruments import Instrument
from casadical.pose_selection.pose_order import distances
from casadical.pose_selection.stopping_rule import forecast
from casadical.pose_selection.workspace import Workspace, places_about
from casadical.project.live.estimate import Estimate, known_at_first
from casadical.project.new.synthetic import one_turn
from casadical.robot.robot import Robot

# Poses that are chosen from, poses of the task, poses planned at once, and looked at beyond what is measured.
POOL, TASK, BATCH, BEYOND = 300, 150, 8, 60
# Before anything is known so many are said to be needed. Of those that gain this share of the best one's gain, the
# nearest is next.
FIRST, SHARE = 12, 0.5
# Without a workspace poses stay so far above the plane that the robot stands on [m].
CLEARANCE, LEAST = 0.05, 1e-6


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
    robot: Robot, found: Estimate | None, room: Workspace | None, target: float | None, m: Measurements | None
) -> Ahead:
    """The next poses of a robot: one that gains much and is near to where the robot is, then the others.

    found : None of too few readings; room : None: above the plane that it stands on; target : accuracy wanted [m]
    m : all readings, at the last of which the robot stands
    Raises InputError where the room allows no pose.
    """
    robot = replace(robot, targets=(), tool_name="")
    before = m.q if m is not None else np.zeros((0, robot.n))
    among, said = candidates(robot, room, len(before))
    names, information, sigma = found.known if found else known_at_first(robot, m)
    free, prior = _independent(robot, names, information, among)
    wires = None
    if m is not None and m.distance is not None and m.target is not None:
        wires = Instrument("wires", np.unique(m.target.round(6), axis=0), known=True)
    problem = prepare(
        robot, BATCH, "V", candidates=among, workspace=Workspace(), circumstances=Circumstances(), measured=None,
        free=free, interest=(), task=None, noise=Noise(sigma), pool=len(among), rng=np.random.default_rng(0),
        instrument=wires, prior=prior,
    )  # fmt: skip
    design = problem.design(problem.pool, "V", 0.0)
    chosen = search(design, BATCH, 1, 0)
    design.start([])
    q, gain = problem.pool.q[chosen], design.gains(chosen, 1)[chosen]
    to_go, words = None, f"at least {max(1, FIRST - len(before))} more"
    if found:
        course = forecast(
            robot, BEYOND, workspace=room, noise=Noise(sigma), pool=POOL, free=free, instrument=wires, prior=prior
        )
        to_go = course.enough(target) if target else course.stop()
        words = _words(to_go, target, 1e3 * float(course.error[0]))
    return Ahead(robot, q[_order(robot, q, gain, before)], to_go, f"{words}{said}")


def _independent(robot: Robot, names: tuple[str, ...], information: Array, q: Array) -> tuple[tuple[str, ...], Prior]:
    """Parameters that readings q distinguish, and what is known of them where the others are held."""
    m = expected(robot, q, {}, "planned")
    kept = independent_parameters(LeastSquares(robot, (m,), names, "linear", False, ((MM, MM),))).independent
    at, scale = [names.index(n) for n in kept], np.array([robot.parameters[n].scale for n in kept])
    covariance = np.linalg.inv(information[np.ix_(at, at)]) * np.outer(scale, scale)
    return tuple(kept), Prior(known=((tuple(kept), covariance),))


def _words(to_go: int | None, target: float | None, now: float) -> str:
    goal = f"{1e3 * target:.3g} mm are reached" if target else "ten more gain less than a tenth"
    expected_now = f"{now:.3f} mm to expect of the robot now"
    if to_go is None:
        return f"{expected_now}; more than {BEYOND} poses until {goal}"
    return f"{expected_now}; enough: {goal}" if to_go == 0 else f"{expected_now}; about {to_go} more until {goal}"


def _order(robot: Robot, q: Array, gain: Array, before: Array) -> list[int]:
    """An order of short travel that begins with a pose that gains much, each then the nearest to the one before."""
    n, last = len(q), before[-1:] if len(before) else q[[np.argmax(gain)]]
    D = distances(robot, np.vstack([q, last]))
    order: list[int] = []
    left, at = set(range(n)), n
    while left:
        among = left if order else [k for k in left if gain[k] >= SHARE * gain.max()]
        at = min(among, key=lambda k: D[at, k])
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

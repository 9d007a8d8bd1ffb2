"""The next poses, planned with what is known by now, and how many more gain something."""

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.statistics import first_of_best
from casadical.effects import Session
from casadical.identification.accuracy import predicted
from casadical.identification.least_squares import LeastSquares
from casadical.identification.prior import Prior
from casadical.identification.reduction import independent_parameters
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements, Noise
from casadical.pose_selection.candidates import Circumstances, draw, expected, held_in
from casadical.pose_selection.design_problem import prepare
from casadical.pose_selection.experimental_design import search
from casadical.pose_selection.information import MM
from casadical.pose_selection.instruments import Instrument
from casadical.pose_selection.pose_search import Forecast, forecast
from casadical.pose_selection.selection import distances
from casadical.pose_selection.workspace import Workspace, places_about
from casadical.project.live.estimate import Estimate, known_at_first, labels_of
from casadical.project.new.new import one_turn
from casadical.robot.robot import Robot

# Poses that are chosen from, poses of the task, poses planned at once, and looked at beyond what is measured.
POOL, TASK, BATCH, BEYOND = 300, 150, 8, 60
# Where the tool may be held, of what it touches.
PLACES = 8
# Before anything is known so many are said to be needed. Of those that gain this share of the best one's gain, the
# nearest is next.
FIRST, SHARE = 12, 0.5
# Without a workspace poses stay so far above the plane that the robot stands on [m].
CLEARANCE, LEAST = 0.05, 1e-6


@dataclass(frozen=True, eq=False)
class Ahead:
    """What to measure.

    q : next poses in order, shape (k, joints) [rad or m]; to_go : how many more gain something, None: not known
    touch : what the tool touches at the first of them, "" where it touches nothing that has a name
    """

    robot: Robot
    q: Array
    to_go: int | None
    words: str
    touch: str = ""


def look_ahead(
    robot: Robot, found: Estimate | None, room: Workspace | None, target: float | None, m: Measurements | None
) -> Ahead:
    """The next poses of a robot: one that gains much and is near to where the robot is, then the others.

    found : None of too few readings; room : None: above the plane that it stands on; target : accuracy wanted [m]
    m : all readings, at the last of which the robot stands
    Raises InputError where the room allows no pose.
    """
    robot = replace(robot.with_only(e for e in robot.effects if not isinstance(e, Session)), targets=(), tool_name="")
    before = m.q if m is not None else np.zeros((0, robot.n))
    touches = m is not None and find_kind(m.kind).touches
    among, said = candidates(robot, room, len(before), m if touches else None)
    names, information, sigma = found.known if found else known_at_first(robot, m)
    own = [k for k, name in enumerate(names) if name in robot.parameters.names]  # of the first target and session
    if len(own) < len(names):
        names = tuple(names[k] for k in own)
        information = np.linalg.inv(np.linalg.inv(information)[np.ix_(own, own)])
    free, prior = _independent(robot, names, information, among)
    wires = None
    if m is not None and m.kind == "distance" and (m.target is not None or found):
        ends = m.target if m.target is not None else np.array([*found.points.values()] if found else [])
        wires = Instrument("wires", np.unique(ends.round(6), axis=0), known=True)
    problem = prepare(
        robot, min(BATCH, len(among)), candidates=among, workspace=Workspace(), circumstances=Circumstances(),
        measured=None, free=free, interest=(), task=None, noise=Noise(sigma), pool=len(among),
        rng=np.random.default_rng(0), instrument=wires, prior=prior,
    )  # fmt: skip
    design = problem.design(problem.pool, 0.0)
    chosen = search(design, min(BATCH, len(among)), 1, 0)
    design.start([])
    q, gain = problem.pool.q[chosen], design.gains(chosen, 1)
    to_go, words = None, f"at least {max(1, FIRST - len(before))} more"
    if found:
        if found.m.position is None and found.m.target is None:
            task = expected(robot, task_readings(robot), {}, "task")
            course = Forecast(np.arange(BEYOND + 1), found.expected(task, BEYOND))
        else:
            course = forecast(
                robot, BEYOND, workspace=room, noise=Noise(sigma), pool=POOL, free=free, instrument=wires, prior=prior
            )
        to_go = course.enough(target) if target else course.stop()
        words = _words(to_go, target, 1e3 * float(course.error[0]))
    order = _order(robot, q, gain, before)
    touch = _touched_at(robot, m, q[order[0]]) if touches and m is not None else ""
    return Ahead(robot, q[order], to_go, f"{words}{said}", touch)


def _touched_at(robot: Robot, m: Measurements, q: Array) -> str:
    """The name of what was touched nearest to where joints q, shape (joints,), hold the tool; "" where it has none."""
    there, p = predicted(robot, m)[0], expected(robot, q[None], {}, "planned").position
    names = labels_of(m)
    return names[int(np.argmin(np.linalg.norm(there - p, axis=1)))] if names else ""


def _touched(robot: Robot, m: Measurements, rng: np.random.Generator) -> Array:
    """Where the tool touches what readings touched, shape (PLACES, 3) [m]: where it was or, on what is straight,
    between two such places."""
    p, labels = predicted(robot, m)[0], np.array(labels_of(m) or [""] * len(m))
    first = rng.integers(len(m), size=PLACES)
    other = np.array([rng.choice(np.flatnonzero(labels == labels[k])) for k in first])
    share = np.zeros((PLACES, 1)) if find_kind(m.kind).places else rng.uniform(size=(PLACES, 1))
    return np.asarray(p[first] + share * (p[other] - p[first]))


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
    n, last = len(q), before[-1:] if len(before) else q[[first_of_best(gain)]]
    D = distances(robot, np.vstack([q, last]))
    order: list[int] = []
    left, at = set(range(n)), n
    while left:
        among = left if order else [k for k in left if gain[k] >= SHARE * gain.max()]
        listed = sorted(among)
        at = listed[first_of_best(-D[at, listed])]
        left.remove(at)
        order.append(at)
    return order


def candidates(
    robot: Robot, room: Workspace | None, seed: int, touches: Measurements | None = None
) -> tuple[Array, str]:
    """Poses to choose from, (POOL, joints), and what was not checked; touches : what the tool is to touch."""
    rng, own = np.random.default_rng(seed), one_turn(robot if room else in_base(robot))
    # Some robots have axes in the plane that they stand on.
    standing = [Workspace(floor=0.0, clearance=clearance) for clearance in (CLEARANCE, -LEAST)]
    if touches is not None:
        places = _touched(own, touches, rng)
        for each in [room] if room else [*standing, Workspace()]:
            with suppress(InputError):
                if len(held := held_in(own, places, POOL // 2, each, rng)[0]) >= BATCH:
                    return held, ""
    for each in [] if room else standing:
        with suppress(InputError):
            return draw(own, POOL, each, rng, to_ends=True), ""
    said = "" if room else "; floor and obstacles were not checked: --room FILE.toml"
    return draw(own, POOL, room or Workspace(), rng, to_ends=True), said


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

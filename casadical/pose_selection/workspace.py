"""Where poses may lie: joint ranges, four-bar margin, floor, boxes, and what a laser tracker can see."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.robot.kinematics import LEAST_MARGIN, link_frames
from casadical.robot.model import base_frame
from casadical.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Box:
    """A box as an obstacle, parallel to the measuring frame's axes.

    low, high : two corners, shape (3,) [m]. Raises InputError unless each coordinate of low is below that of high.
    """

    low: Array
    high: Array

    def __post_init__(self) -> None:
        if not (np.shape(self.low) == np.shape(self.high) == (3,) and (np.less(self.low, self.high)).all()):
            raise InputError(
                f"box from {self.low} to {self.high} m; allowed: two corners (x, y, z), the first below the second"
            )

    def holds(self, points: Array, clearance: float = 0.0) -> Array:
        """Which points, shape (..., 3) [m], are in the box or closer than clearance [m] to it: boolean, (...)."""
        inside = (points > np.asarray(self.low) - clearance) & (points < np.asarray(self.high) + clearance)
        return np.asarray(inside.all(axis=-1))

    def hides(self, points: Array, station: Array) -> Array:
        """Whether the straight lines from station, shape (3,) [m], to points, shape (n, 3) [m], pass through it."""
        along = points - station
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.stack([(np.asarray(corner) - station) / along for corner in (self.low, self.high)])
        # A line that runs along a face has no crossing there: it is between the faces, or never.
        between = (np.asarray(self.low) <= station) & (station <= np.asarray(self.high))
        parallel = along == 0
        enter = np.where(parallel, np.where(between, -np.inf, np.inf), t.min(axis=0)).max(axis=1)
        leave = np.where(parallel, np.where(between, np.inf, -np.inf), t.max(axis=0)).min(axis=1)
        return np.asarray((enter < leave) & (leave > 0) & (enter < 1))


@dataclass(frozen=True, eq=False)
class Tracker:
    """A laser tracker in the measuring frame and the cone in which it sees.

    station : position of its head, shape (3,) [m]; towards : a point on the axis of its cone, shape (3,) [m], or None:
        it sees all around; half_angle : half of the cone's angle [rad]; nearest, farthest : range of distances [m]
    opening : direction of the reflector's opening in the tool frame, shape (3,), or None: it is visible from all sides
    acceptance : largest angle between the beam and that direction [rad]
    """

    station: Array
    towards: Array | None = None
    half_angle: float = np.pi / 4
    nearest: float = 0.3
    farthest: float = 30.0
    opening: Array | None = None
    acceptance: float = np.pi / 6

    def sees(self, points: Array, R: Array) -> Array:
        """Whether it sees reflectors at points, shape (n, 3) [m], tools turned by R, shape (n, 3, 3); boolean, (n,)."""
        beam = points - self.station
        distance = np.linalg.norm(beam, axis=1)
        seen = (distance >= self.nearest) & (distance <= self.farthest)
        beam /= np.maximum(distance, 1e-12)[:, None]
        if self.towards is not None:
            axis = np.asarray(self.towards, dtype=float) - self.station
            seen &= beam @ (axis / np.linalg.norm(axis)) >= np.cos(self.half_angle)
        if self.opening is not None:
            opening = R @ (np.asarray(self.opening, dtype=float) / np.linalg.norm(self.opening))
            seen &= -(opening * beam).sum(axis=1) >= np.cos(self.acceptance)
        return np.asarray(seen)


@dataclass(frozen=True, eq=False)
class Workspace:
    """Which poses can be measured.

    lower, upper : least and greatest readings, shape (joints,) [rad or m]; None: the robot's ranges
    margin : least margin of every four-bar (see `fourbar.margin`)
    floor : height in the measuring frame [m] below which no point may lie
    boxes : obstacles; clearance : least distance of tool point and link origins from floor and boxes [m]
    tracker : it must see the tool point, past the boxes
    """

    lower: Array | None = None
    upper: Array | None = None
    margin: float = 5 * LEAST_MARGIN
    floor: float | None = None
    boxes: tuple[Box, ...] = ()
    clearance: float = 0.0
    tracker: Tracker | None = field(default=None)

    def ranges(self, robot: Robot) -> tuple[Array, Array]:
        """Least and greatest readings, shape (joints,) each [rad or m]. Raises InputError."""
        lower = np.array([j.lower for j in robot.joints]) if self.lower is None else np.asarray(self.lower, float)
        upper = np.array([j.upper for j in robot.joints]) if self.upper is None else np.asarray(self.upper, float)
        if lower.shape != (robot.n,) or upper.shape != (robot.n,) or not (lower < upper).all():
            raise InputError(
                f"workspace: ranges {lower} to {upper}; {robot.name} needs {robot.n} readings each, lower below upper"
            )
        return lower, upper

    def refusals(self, robot: Robot, q: Array) -> dict[str, Array]:
        """By reason, which of the readings q, shape (n, joints) [rad or m], are ruled out, boolean, shape (n,).

        Links are checked by the origins of their frames and the tool by its point, not by their shapes.
        """
        lower, upper = self.ranges(robot)
        found: dict[str, Array] = {"joint range": np.asarray(((q < lower - 1e-9) | (q > upper + 1e-9)).any(axis=1))}
        points, R, margin = _places(robot, q)
        if robot.loops:
            found["four-bar margin"] = ~(margin >= self.margin)
        tool = points[:, -1]
        if self.floor is not None:
            found["floor"] = np.asarray((points[:, :, 2] < self.floor + self.clearance).any(axis=1))
        if self.boxes:
            struck = [b.holds(points, self.clearance).any(axis=1) for b in self.boxes]
            found["box"] = np.asarray(np.any(struck, axis=0))
        if self.tracker is not None:
            hidden = [b.hides(tool, np.asarray(self.tracker.station, float)) for b in self.boxes]
            found["line of sight"] = ~self.tracker.sees(tool, R) | np.any(hidden, axis=0)
        return found

    def as_open_as(self, robot: Robot, q: Array) -> Workspace:
        """The workspace with four-bars no less open than at any of the readings q, shape (n, joints) [rad or m]."""
        if not robot.loops:
            return self
        return replace(self, margin=max(self.margin, float(_places(robot, q)[2].min())))

    def allows(self, robot: Robot, q: Array) -> Array:
        """Which of the readings q, shape (n, joints) [rad or m], may be measured, boolean, shape (n,)."""
        return np.asarray(~np.any(list(self.refusals(robot, q).values()), axis=0))


@lru_cache(maxsize=16)
def _places_function(robot: Robot) -> ca.Function:
    """places:(q, w, phi)->(points[3, n], R, margin): origins of frames 2 to n, then the tool point.

    Frame 1 does not move, so it cannot collide.
    """
    rigid = robot.with_only(())
    model = rigid.model
    values = dict(zip(rigid.parameters.names, ca.vertsplit(model.phi), strict=True))
    T_M0 = base_frame(rigid, values, ca.DM(rigid.base.T))
    frames = link_frames(rigid, ca.vertsplit(model.q), values)
    points = [(T_M0 @ T)[:3, 3] for T in frames[1:]]
    return ca.Function(
        "places",
        [model.q, model.w, model.phi],
        [ca.densify(ca.horzcat(*points, model.p)), model.R, model.margin],
        ["q", "w", "phi"],
        ["points", "R", "margin"],
    )


def _places(robot: Robot, q: Array) -> tuple[Array, Array, Array]:
    """Points, shape (n, joints, 3) [m], tool orientations, shape (n, 3, 3), least margins of loops, shape (n,)."""
    count, rigid = len(q), robot.with_only(())
    f = _places_function(robot)
    points, R, margin = f.map(count)(q.T, np.tile(rigid.declared[:, None], count), rigid.parameters.values)
    least = margin.full().min(axis=0) if robot.loops else np.ones(count)
    return (points.full().T.reshape(count, robot.n, 3), R.full().reshape(3, count, 3).transpose(1, 0, 2), least)

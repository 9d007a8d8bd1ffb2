"""The workspace for measurements: joint ranges, four-bar margin, obstacles, laser tracker."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import casadi as ca
import numpy as np
from pydantic import Field, model_validator

from casadical.core.basics import Array, InputError
from casadical.core.reading import load_toml
from casadical.core.schema import (
    ANGLE,
    LENGTH,
    READING,
    WHOLE_NUMBER,
    FaultError,
    Pair,
    Quantity,
    TomlTable,
    Triple,
    check,
)
from casadical.robot.kinematics import MIN_LOOP_MARGIN, link_frames
from casadical.robot.model import base_frame
from casadical.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Box:
    """A box-shaped obstacle, parallel to the measuring frame's axes.

    low, high : opposite corners in that frame, shape (3,) [m]
    Raises InputError: a coordinate of low that is not below that of high.
    """

    low: Array
    high: Array

    def __post_init__(self) -> None:
        """Refuse corners in the wrong order. Raises InputError."""
        if not (np.shape(self.low) == np.shape(self.high) == (3,) and (np.less(self.low, self.high)).all()):
            raise InputError(
                f"box from {self.low} to {self.high} m; allowed: two corners (x, y, z), the first below the second"
            )

    def holds(self, points: Array, clearance: float = 0.0) -> Array:
        """Return which points are in the box or within a clearance [m] of it, boolean, shape (...).

        points : in the measuring frame, shape (..., 3) [m]
        """
        inside = (points > np.asarray(self.low) - clearance) & (points < np.asarray(self.high) + clearance)
        return np.asarray(inside.all(axis=-1))

    def hides(self, points: Array, station: Array) -> Array:
        """Return whether lines from a station to points pass through the box, shape (n,).

        points : shape (n, 3) [m]; station : shape (3,) [m]; both in the measuring frame
        """
        along = points - station
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.stack([(np.asarray(corner) - station) / along for corner in (self.low, self.high)])
        # A line parallel to a face never crosses it: it is between the two faces, or always
        # outside.
        between = (np.asarray(self.low) <= station) & (station <= np.asarray(self.high))
        parallel = along == 0
        enter = np.where(parallel, np.where(between, -np.inf, np.inf), t.min(axis=0)).max(axis=1)
        leave = np.where(parallel, np.where(between, np.inf, -np.inf), t.max(axis=0)).min(axis=1)
        return np.asarray((enter < leave) & (leave > 0) & (enter < 1))


@dataclass(frozen=True, eq=False)
class Tracker:
    """A laser tracker in the measuring frame and the cone in which it sees.

    station : Array, shape (3,) [m]: position of its head
    towards : Array, shape (3,) [m]: a point on the axis of its cone; None: it sees all around
    half_angle : half of the cone's angle [rad]
    nearest : least distance [m]
    farthest : greatest distance [m]
    opening : Array, shape (3,): direction of the reflector's opening in the tool frame; None: it is
        visible from all sides
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
        """Return whether the tracker sees reflectors, shape (n,).

        points : in the measuring frame, shape (n, 3) [m]; R : orientations of their tool frames,
            shape (n, 3, 3)
        """
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

    lower : shape (joints,) [rad or m]: least readings; None: the robot's
    upper : shape (joints,) [rad or m]: greatest readings; None: the robot's
    margin : least margin of every four-bar, see `fourbar.margin`
    floor : height in the measuring frame below which no point may lie [m]
    boxes : obstacles
    clearance : least distance of tool point and link origins from floor and boxes [m]
    tracker : it must see the tool point, past the boxes

    Examples
    --------
    >>> from casadical.pose_selection.workspace import Box
    >>> box = Box(np.array([0.5, -1, -1]), np.array([1.0, 1, 1]))
    >>> where = casadical.pose_selection.Workspace(boxes=(box,))
    >>> q = np.array([[0.0, 0.0], [np.pi / 2, 0.0]])
    >>> where.allows(robot, q), sorted(where.refusals(robot, q))
    (array([False,  True]), ['box', 'joint range'])
    >>> [limit.round(2) for limit in where.ranges(robot)]
    [array([-3.14, -3.14]), array([3.14, 3.14])]
    >>> where.as_open_as(robot, q).boxes == where.boxes
    True
    """

    lower: Array | None = None
    upper: Array | None = None
    margin: float = 5 * MIN_LOOP_MARGIN
    floor: float | None = None
    boxes: tuple[Box, ...] = ()
    clearance: float = 0.0
    tracker: Tracker | None = None

    def ranges(self, robot: Robot) -> tuple[Array, Array]:
        """Return least and greatest readings, shape (joints,) each [rad or m].

        Raises InputError: limits of another number of joints, or a lower one that is not below the
        upper.
        """
        given = zip((self.lower, self.upper), robot.limits, strict=True)
        lower, upper = (own if side is None else np.asarray(side, float) for side, own in given)
        if lower.shape != (robot.n,) or upper.shape != (robot.n,) or not (lower < upper).all():
            raise InputError(
                f"workspace: ranges {lower} to {upper}; {robot.name} needs {robot.n} readings each, lower below upper"
            )
        return lower, upper

    def refusals(self, robot: Robot, q: Array) -> dict[str, Array]:
        """Return for each reason which readings it excludes, boolean, shape (n,).

        q : shape (n, joints) [rad or m]
        """
        lower, upper = self.ranges(robot)
        refused: dict[str, Array] = {"joint range": np.asarray(((q < lower - 1e-9) | (q > upper + 1e-9)).any(axis=1))}
        points, R, margin = places_about(robot, q)
        if robot.loops:
            refused["four-bar margin"] = ~(margin >= self.margin)
        tool = points[:, -1]
        if self.floor is not None:
            refused["floor"] = np.asarray((points[:, :, 2] < self.floor + self.clearance).any(axis=1))
        if self.boxes:
            struck = [b.holds(points, self.clearance).any(axis=1) for b in self.boxes]
            refused["box"] = np.asarray(np.any(struck, axis=0))
        if self.tracker is not None:
            hidden = [b.hides(tool, np.asarray(self.tracker.station, float)) for b in self.boxes]
            refused["line of sight"] = ~self.tracker.sees(tool, R) | np.any(hidden, axis=0)
        return refused

    def as_open_as(self, robot: Robot, q: Array) -> Workspace:
        """Return the workspace with four-bars no less open than at any of some readings.

        q : shape (n, joints) [rad or m]
        """
        if not robot.loops:
            return self
        return replace(self, margin=max(self.margin, float(places_about(robot, q)[2].min())))

    def allows(self, robot: Robot, q: Array) -> Array:
        """Return which readings may be measured, boolean, shape (n,).

        q : shape (n, joints) [rad or m]
        """
        return np.asarray(~np.any(list(self.refusals(robot, q).values()), axis=0))


@lru_cache(maxsize=16)
def _places_function(robot: Robot) -> ca.Function:
    """Return the function (q, w, phi) -> (points[3, n], R, margin).

    Points are the origins of frames 2 to n (the first is fixed), then the tool.
    """
    rigid = robot.with_only(())
    model = rigid.model
    values = dict(zip(rigid.parameters.names, ca.vertsplit(model.phi), strict=True))
    T_M0 = base_frame(rigid, values, ca.DM(rigid.base.T))
    frames = link_frames(rigid, ca.vertsplit(model.q), values)
    points = [(T_M0 @ T)[:3, 3] for T in frames[1:]]
    outputs = [ca.densify(ca.horzcat(*points, model.p)), model.R, model.margin]
    names = ["q", "w", "phi"], ["points", "R", "margin"]
    return ca.Function("places", [model.q, model.w, model.phi], outputs, *names)


def places_about(robot: Robot, q: Array) -> tuple[Array, Array, Array]:
    """Return link origins and tool points, tool orientations, and least four-bar margins.

    The points have shape (n, joints, 3) [m], the orientations (n, 3, 3), both in the measuring
    frame; the margins (n,).
    """
    count, rigid = len(q), robot.with_only(())
    f = _places_function(robot)
    points, R, margin = f.map(count)(q.T, np.tile(rigid.declared[:, None], count), rigid.parameters.values)
    least = margin.full().min(axis=0) if robot.loops else np.ones(count)
    return (points.full().T.reshape(count, robot.n, 3), R.full().reshape(3, count, 3).transpose(1, 0, 2), least)


# An angle of a TOML file between 0 and half a turn, in rad or deg.
HalfTurn = Annotated[float, Quantity(ANGLE.factors, np.pi), Field(gt=0)]


class _Joint(TomlTable):
    """Limits of one joint in a workspace file."""

    number: int = Field(ge=1)
    limits: Annotated[Pair, READING]


class _Box(TomlTable):
    """An obstacle in a workspace file."""

    low: Annotated[Triple, LENGTH]
    high: Annotated[Triple, LENGTH]

    @model_validator(mode="after")
    def _ordered(self) -> _Box:
        """Refuse a box unless its corners are in order."""
        if not np.less(self.low, self.high).all():
            raise FaultError("high", "each of its coordinates must be greater than that of low")
        return self


class _Tracker(TomlTable):
    """A laser tracker in a workspace file."""

    station: Annotated[Triple, LENGTH]
    towards: Annotated[Triple | None, LENGTH] = None
    half_angle: HalfTurn = np.pi / 4
    nearest: Annotated[float, LENGTH, Field(ge=0)] = 0.3
    farthest: Annotated[float, LENGTH, Field(gt=0)] = 30.0
    opening: Triple | None = None
    acceptance: HalfTurn = np.pi / 6

    @model_validator(mode="after")
    def _sees(self) -> _Tracker:
        """Refuse a tracker whose keys are incomplete or whose cone is empty."""
        for needed, key in (("towards", "half_angle"), ("opening", "acceptance")):
            if key in self.model_fields_set and getattr(self, needed) is None:
                raise FaultError(key, f"has no effect without {needed}; give both")
        if self.towards == self.station:
            raise FaultError("towards", "is the station itself; name another point on the axis of its cone")
        if self.opening is not None and not any(self.opening):
            raise FaultError("opening", "has no direction; allowed: a vector that is not zero")
        if self.nearest >= self.farthest:
            raise FaultError("farthest", f"must be greater than nearest, {self.nearest:g} m")
        return self


class _Workspace(TomlTable):
    """The schema of a workspace file."""

    casadical: Annotated[Literal[1], WHOLE_NUMBER]
    floor: Annotated[float | None, LENGTH] = None
    clearance: Annotated[float, LENGTH, Field(ge=0)] = 0.0
    four_bar_margin: float = Field(default=0.1, gt=0, lt=1)
    joint: list[_Joint] = Field(default=[])
    box: list[_Box] = Field(default=[])
    tracker: _Tracker | None = None


def read_workspace(path: str | Path, robot: Robot) -> Workspace:
    """Read a workspace file, which is in the measuring frame.

    Raises InputError that names file and key.
    """
    given = check(_Workspace, load_toml(Path(path)), str(path))
    lower, upper = robot.limits
    for joint in given.joint:
        if joint.number > robot.n:
            raise InputError(f"{path}: joint {joint.number}: {robot.name} has {robot.n} joints")
        k = joint.number - 1
        # The robot's own range always applies.
        lower[k], upper[k] = max(lower[k], joint.limits[0]), min(upper[k], joint.limits[1])
        if lower[k] >= upper[k]:
            raise InputError(f"{path}: joint {joint.number}: nothing of its range is left between these limits")
    boxes = tuple(Box(np.array(b.low), np.array(b.high)) for b in given.box)
    seen: dict[str, Any] = {key: np.array(v) if isinstance(v, tuple) else v for key, v in given.tracker or ()}
    tracker = Tracker(**seen) if seen else None
    return Workspace(lower, upper, given.four_bar_margin, given.floor, boxes, given.clearance, tracker)

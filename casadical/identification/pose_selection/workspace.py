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
    Raises InputError: another shape, or a coordinate of low that is not below that of high.
    """

    low: Array
    high: Array

    def __post_init__(self) -> None:
        """Refuse corners of another shape or in the wrong order. Raises InputError."""
        if not (np.shape(self.low) == np.shape(self.high) == (3,) and (np.less(self.low, self.high)).all()):
            raise InputError(
                f"box from {self.low} to {self.high} m; allowed: two corners (x, y, z), the first below the second"
            )

    def holds(self, points: Array, clearance: float = 0.0) -> Array:
        """Return a mask of points in the box widened by a clearance, shape (...).

        points : in the measuring frame, shape (..., 3) [m]
        clearance : distance by which each face is moved outwards [m]
        """
        inside = (points > np.asarray(self.low) - clearance) & (points < np.asarray(self.high) + clearance)
        return np.asarray(inside.all(axis=-1))

    def hides(self, points: Array, station: Array) -> Array:
        """Return whether the box hides each of n points from a station, boolean, shape (n,).

        points : shape (n, 3) [m]; station : shape (3,) [m]; both in the measuring frame
        """
        along = points - station
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.stack([(np.asarray(corner) - station) / along for corner in (self.low, self.high)])
        # A line parallel to a face never crosses it: it is between the two faces or outside.
        between = (np.asarray(self.low) <= station) & (station <= np.asarray(self.high))
        parallel = along == 0
        enter = np.where(parallel, np.where(between, -np.inf, np.inf), t.min(axis=0)).max(axis=1)
        leave = np.where(parallel, np.where(between, np.inf, -np.inf), t.max(axis=0)).min(axis=1)
        return np.asarray((enter < leave) & (leave > 0) & (enter < 1))


@dataclass(frozen=True, eq=False)
class Tracker:
    """A laser tracker in the measuring frame and the cone in which it sees.

    station : position of its head in the measuring frame, shape (3,) [m]
    towards : a point on the axis of its cone in the measuring frame, shape (3,) [m]; None: it sees
        all around
    half_angle : half of the cone's opening angle [rad]
    nearest : smallest distance of a reflector [m]
    farthest : largest distance of a reflector [m]
    opening : direction out of the reflector's opening in the tool frame, shape (3,), of any length;
        None: it is visible from all sides
    acceptance : largest angle between `opening` and the direction to the tracker [rad]
    """

    station: Array
    towards: Array | None = None
    half_angle: float = np.pi / 4
    nearest: float = 0.3
    farthest: float = 30.0
    opening: Array | None = None
    acceptance: float = np.pi / 6

    def sees(self, points: Array, R: Array) -> Array:
        """Return whether the tracker sees each of n reflectors, boolean, shape (n,).

        points : reflectors in the measuring frame, shape (n, 3) [m]
        R : orientations of their tool frames in the measuring frame, shape (n, 3, 3)
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

    lower, upper : limits of the joint variables, shape (joints,) [rad or m]; None: the robot's
    margin : smallest allowed margin of a four-bar, see `kinematics.loop_margin`
    floor : height in the measuring frame below which no origin of links 2 to n, nor the tool point,
        may lie [m]; None: any
    boxes : obstacles
    clearance : smallest distance of these points from floor and boxes' faces [m]
    tracker : laser tracker that must see the tool point, past the boxes; None: none

    Examples
    --------
    >>> from casadical.identification.pose_selection.workspace import Box
    >>> box = Box(np.array([0.5, -1, -1]), np.array([1.0, 1, 1]))
    >>> where = casadical.identification.pose_selection.Workspace(boxes=(box,))
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
        """Return lower and upper limits of the joint variables, shape (joints,) each [rad or m].

        Where the workspace has none, they are the robot's own.

        Raises InputError: limits whose number is not the number of joints, or a lower limit that is
        not below the upper one.
        """
        given = zip((self.lower, self.upper), robot.limits, strict=True)
        lower, upper = (own if side is None else np.asarray(side, float) for side, own in given)
        if lower.shape != (robot.n,) or upper.shape != (robot.n,) or not (lower < upper).all():
            raise InputError(
                f"workspace: ranges {lower} to {upper}; {robot.name} needs {robot.n} readings each, lower below upper"
            )
        return lower, upper

    def refusals(self, robot: Robot, q: Array) -> dict[str, Array]:
        """Return a mask of the poses that the workspace excludes, shape (n,), for each reason.

        The reasons are "joint range", "four-bar margin", "floor", "box" and "line of sight", as far
        as the workspace has such limits.

        q : joint variables, shape (n, joints) [rad or m]
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
        """Return the workspace with the smallest four-bar margin of some poses as its own.

        A larger margin of the workspace stays; without four-bars it is returned unchanged.

        q : joint variables, shape (n, joints) [rad or m]
        """
        if not robot.loops:
            return self
        return replace(self, margin=max(self.margin, float(places_about(robot, q)[2].min())))

    def allows(self, robot: Robot, q: Array) -> Array:
        """Return a mask of the poses that may be measured, shape (n,).

        q : joint variables, shape (n, joints) [rad or m]
        """
        return np.asarray(~np.any(list(self.refusals(robot, q).values()), axis=0))


@lru_cache(maxsize=16)
def _places_function(robot: Robot) -> ca.Function:
    """Return the CasADi function (q, w, phi) -> (points[3, n], R[3, 3], margin), without effects.

    Points are the origins of link frames 2 to n (the first is fixed) of rigid joints, then the tool
    point with deflections, in the measuring frame [m]; R is the tool's orientation there, margin
    that of each four-bar.
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
    """Return points of the robot, tool orientations, and smallest four-bar margins at n poses.

    The points, shape (n, joints, 3) [m], are the origins of link frames 2 to n, then the tool
    point; the orientations have the shape (n, 3, 3), both in the measuring frame; the margins (n,)
    are 1 without a four-bar. Effects are omitted.

    q : joint variables, shape (n, joints) [rad or m]
    """
    count, rigid = len(q), robot.with_only(())
    f = _places_function(robot)
    points, R, margin = f.map(count)(q.T, np.tile(rigid.declared[:, None], count), rigid.parameters.values)
    least = margin.full().min(axis=0) if robot.loops else np.ones(count)
    return (points.full().T.reshape(count, robot.n, 3), R.full().reshape(3, count, 3).transpose(1, 0, 2), least)


# Type of an angle in a TOML file, above 0 and at most pi, with its unit in the key.
HalfTurn = Annotated[float, Quantity(ANGLE.factors, np.pi), Field(gt=0)]


class _Joint(TomlTable):
    """Limits of one joint's variable in a workspace file [rad or m]."""

    number: int = Field(ge=1)
    limits: Annotated[Pair, READING]


class _Box(TomlTable):
    """An obstacle in a workspace file [m]; see `Box`."""

    low: Annotated[Triple, LENGTH]
    high: Annotated[Triple, LENGTH]

    @model_validator(mode="after")
    def _ordered(self) -> _Box:
        """Check that each coordinate of low is below that of high. Raises FaultError."""
        if not np.less(self.low, self.high).all():
            raise FaultError("high", "each of its coordinates must be greater than that of low")
        return self


class _Tracker(TomlTable):
    """A laser tracker in a workspace file [m, rad]; see `Tracker`."""

    station: Annotated[Triple, LENGTH]
    towards: Annotated[Triple | None, LENGTH] = None
    half_angle: HalfTurn = np.pi / 4
    nearest: Annotated[float, LENGTH, Field(ge=0)] = 0.3
    farthest: Annotated[float, LENGTH, Field(gt=0)] = 30.0
    opening: Triple | None = None
    acceptance: HalfTurn = np.pi / 6

    @model_validator(mode="after")
    def _sees(self) -> _Tracker:
        """Check that the keys are complete and it can see anything. Raises FaultError."""
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
    """The schema of a workspace file [m]; see `Workspace`."""

    casadical: Annotated[Literal[1], WHOLE_NUMBER]
    floor: Annotated[float | None, LENGTH] = None
    clearance: Annotated[float, LENGTH, Field(ge=0)] = 0.0
    four_bar_margin: float = Field(default=0.1, gt=0, lt=1)
    joint: list[_Joint] = Field(default=[])
    box: list[_Box] = Field(default=[])
    tracker: _Tracker | None = None


def read_workspace(path: str | Path, robot: Robot) -> Workspace:
    """Return the workspace in a TOML file, whose coordinates are in the measuring frame.

    Its joint limits are the robot's own, narrowed to those of the file.
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

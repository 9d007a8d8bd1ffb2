"""A workspace file (`--room`): where poses may lie, as TOML with units in the keys; see docs/plan.md."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from casadical.core.errors import InputError
from casadical.core.reading import load_toml
from casadical.core.schema import ANGLE, LENGTH, READING, Angle, Length, Pair, TomlTable, Triple, check
from casadical.pose_selection.workspace import Box, Tracker, Workspace
from casadical.robot.robot import Robot


class _Joint(TomlTable):
    number: int = Field(ge=1)
    limits: Annotated[Pair, READING]


class _Box(TomlTable):
    low: Annotated[Triple, LENGTH]
    high: Annotated[Triple, LENGTH]


class _Tracker(TomlTable):
    station: Annotated[Triple, LENGTH]
    towards: Annotated[Triple | None, LENGTH] = None
    half_angle: Angle = np.pi / 4
    nearest: Length = 0.3
    farthest: Length = 30.0
    opening: Triple | None = None
    acceptance: Annotated[float, ANGLE] = np.pi / 6


class _Workspace(TomlTable):
    casadical: Literal[1]
    floor: Annotated[float | None, LENGTH] = None
    clearance: Length = 0.0
    four_bar_margin: float = Field(default=0.1, gt=0, lt=1)
    joint: list[_Joint] = Field(default=[])
    box: list[_Box] = Field(default=[])
    tracker: _Tracker | None = None


def read_workspace(path: str | Path, robot: Robot) -> Workspace:
    """The workspace of a file, in the measuring frame. Raises InputError that names file and key."""
    given = check(_Workspace, load_toml(Path(path)), str(path))
    lower, upper = robot.limits
    for joint in given.joint:
        if joint.number > robot.n:
            raise InputError(f"{path}: joint {joint.number}: {robot.name} has {robot.n} joints")
        k = joint.number - 1
        # Within the robot's own range in any case.
        lower[k], upper[k] = max(lower[k], joint.limits[0]), min(upper[k], joint.limits[1])
        if lower[k] >= upper[k]:
            raise InputError(f"{path}: joint {joint.number}: nothing of its range is left between these limits")
    boxes = tuple(Box(np.array(b.low), np.array(b.high)) for b in given.box)
    return Workspace(lower, upper, given.four_bar_margin, given.floor, boxes, given.clearance, _tracker(given.tracker))


def _tracker(t: _Tracker | None) -> Tracker | None:
    if t is None:
        return None
    towards = None if t.towards is None else np.array(t.towards)
    opening = None if t.opening is None else np.array(t.opening)
    return Tracker(np.array(t.station), towards, t.half_angle, t.nearest, t.farthest, opening, t.acceptance)

"""Interpretation of a table by the nominal robot: ambiguous headings, targets, coupled joints."""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casadical.core.basics import Array, ConvergenceError, InputError
from casadical.identification.accuracy import errors as position_errors
from casadical.identification.arm_or_camera import evidence_of
from casadical.identification.identification import identify
from casadical.identification.placement import place_frames
from casadical.identification.plausibility import orientation_error
from casadical.measurements.camera_noise import Camera
from casadical.measurements.columns import Columns
from casadical.measurements.derived_columns import TIME_COLUMN
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

# Minimum ratio of the error with every other meaning of a heading to that with the best one, with
# which the best one is accepted without a question.
MIN_ERROR_RATIO_TO_OTHERS = 4.0


def poses_in_words(m: Measurements) -> str:
    """Return a sentence on whether poses are inverted and where their camera is.

    Empty without orientations.
    """
    where = {
        "in hand": "the camera is on the robot (eye in hand), its target stands still",
        "to base": "the camera stands still (eye to base), its target is on the robot",
        "": "if a camera measured them, say where it is: --eye-in-hand or --eye-to-base",
    }[m.camera]
    if m.orientation is None:
        return ""
    clock = f" {m.clock_in_words}" if m.clock_offset else ""
    if not m.inverted:
        return f"Poses as they are: {where}.{clock}"
    return f"Each pose is inverted: the table has the fixed frame as the tool sees it; {where}.{clock}"


def as_poses(m: Measurements, robot: Robot, inverted: bool | None = None, camera: Camera = "") -> Measurements:
    """Return measurements with poses of the tool in the measuring frame, and their camera's place.

    Poses that the table gives inverted are inverted; joint readings next to a camera's poses are
    taken at the times of its images (`_synchronised`); without orientations all is unchanged.

    inverted : whether the table has the inverse of these poses; None: of five poses or more, where
        only the inverse fits the robot, or none fits clearly better and the camera is in hand
    camera : where the camera is; empty: as the poses and their noise show
    Raises InputError: measurements without orientations that are declared to be inverted, or to be
    of a camera.
    """
    if m.position is None or m.orientation is None:
        if inverted or camera:
            key = "inverted" if inverted else "camera"
            raise InputError(f"{m.source}: {key}: has no effect on kind {m.kind!r}; take it out of problem.toml")
        return m
    m = of_tool(m, robot, inverted, camera)
    if "corners" in m.extra:
        camera = "in hand" if m.inverted else "to base"
    m = replace(m, camera=camera or _camera_of(m, robot))
    time = m.conditions.get(TIME_COLUMN)
    if not m.camera or time is None or len(m) < 30:
        return m
    order = np.argsort(time, kind="stable")
    if not (np.diff(time[order]) > 0).all() or np.median(np.diff(time[order])) > 0.2:
        return m
    from scipy.interpolate import CubicSpline
    from scipy.optimize import minimize_scalar

    reading = CubicSpline(time[order], m.q[order])
    some = m.positions_alone()[np.linspace(0, len(m) - 1, min(len(m), 200)).astype(int)]
    free = robot.with_unknown(base="pose", tool="position")

    def misfit(offset: float) -> float:
        """Return the mean square of the smaller four fifths of the errors [m^2]."""
        moved = replace(some, q=reading(some.conditions[TIME_COLUMN] + offset))
        e = np.sort(position_errors(place_frames(free, moved), moved))[: len(some) * 4 // 5]
        return float(np.mean(e**2))

    grid = np.linspace(-0.3, 0.3, 25)
    best = grid[int(np.argmin([misfit(offset) for offset in grid]))]
    offset = float(minimize_scalar(misfit, bounds=(best - 0.025, best + 0.025), method="bounded").x)
    # By chance the logarithm of a likelihood grows by 10 with a probability below 1e-5.
    if abs(offset) > 0.29 or 0.5 * len(some) * np.log(misfit(0.0) / misfit(offset)) < 10:
        return m
    return replace(m, q=np.asarray(reading(time + offset)), clock_offset=offset)


def of_tool(m: Measurements, robot: Robot, inverted: bool | None = None, camera: Camera = "") -> Measurements:
    """Return poses of the tool in the measuring frame, inverted where the table has their inverse.

    Arguments are as of `as_poses`; without orientations all is unchanged.
    """
    if m.position is None or m.orientation is None:
        return m
    if "corners" in m.extra and camera and inverted is None:
        inverted = camera == "in hand"  # what was seen is the target in the camera
    # With fewer poses it is not judged whether they are inverted.
    if inverted is None and len(m) >= 5:
        free = robot.with_unknown(base="pose", tool="pose")
        both = (m, m.inverse())
        # Median orientation error [rad] plus median position error divided by the reach.
        here, there = (orientation_error(free, poses) + placed_by(robot, poses)[1] / robot.reach for poses in both)
        inverted = MIN_ERROR_RATIO_TO_OTHERS * there < here
        undecided = there < MIN_ERROR_RATIO_TO_OTHERS * here and not inverted
        inverted = camera == "in hand" if undecided and camera else inverted
    return m.inverse() if inverted else m


def _camera_of(m: Measurements, robot: Robot) -> Camera:
    """Return where the camera is, by the frame (tool or fixed) that has the other near its z axis.

    Empty where that is not clear. A camera sees its target within its field of view; how a target
    is turned has no such limit. Of twelve poses or more, the noise of an identification is judged
    as well: in the frame of the camera alone, errors of the orientation do not move the target.
    """
    off: dict[Camera, float] = {}
    place: Camera
    for place, poses in (("to base", m), ("in hand", m.inverse())):
        assert poses.position is not None
        x, y, z = poses.position.T
        off[place] = float(np.quantile(np.arctan2(np.hypot(x, y), z), 0.9))
    near, far = sorted(off, key=lambda camera: off[camera])
    # A field of view is at most 100 deg wide.
    # A camera is where it has its target at an angle that the other frame exceeds by this factor.
    sure = off[near] < np.deg2rad(50.0) and 1.3 * off[near] < off[far]
    by_angle: Camera = near if sure else ""
    # A frame that has the other this far off its axis is no camera's, whatever the noise; of fewer
    # poses the noise is too uncertain.
    if (by_angle and off[far] > np.deg2rad(60.0)) or len(m) < 12:
        return by_angle
    # More poses than 80 are not needed.
    some = replace(m, camera="", noise=None)[np.unique(np.linspace(0, len(m) - 1, min(len(m), 80)).astype(int))]
    try:
        found = identify(robot.with_unknown(base="pose", tool="pose"), some, method="KM", loss="huber")
        likely = {camera: evidence_of(found, camera) for camera in off}
    except (InputError, ConvergenceError, np.linalg.LinAlgError):
        return by_angle
    best, other = sorted(likely, key=lambda camera: -likely[camera][0])
    lateral, depth, _, _ = likely[best][1].ratios
    # The origin of a board, its corner, may be further off the axis than its middle.
    if likely[best][0] > likely[other][0] + 5 and depth > lateral and off[best] < np.deg2rad(60.0):
        return best  # by chance with a probability below 1 %
    return by_angle if by_angle == best else ""


def placed_by(robot: Robot, m: Measurements) -> tuple[Robot, float]:
    """Return the robot with base and tool position fitted, and its median position error [m]."""
    free = robot.with_unknown(base="pose", tool="position")
    placed = place_frames(free, m.positions_alone())
    return placed, float(np.median(position_errors(placed, m.positions_alone())))


def with_target_positions(m: Measurements, robot: Robot) -> Measurements:
    """Return the measurements, whose targets (column `tool`) must be targets of the robot file.

    Where the robot has a single target, a column `tool` that names one alone is removed, whatever
    the name. Raises InputError where the column names a target that the robot file does not have.
    """
    measured = m.target_names
    target_names = [robot.tool_name, *(t.name for t in robot.targets)]
    if not robot.targets and len(measured) < 2:
        return replace(m, conditions={k: v for k, v in m.conditions.items() if not k.startswith("tool_")})
    missing = [name for name in measured if name not in target_names]
    if missing:
        there = f"the robot file has {', '.join(target_names)}" if robot.targets else "the robot file has one tool"
        raise InputError(
            f"{m.source}: column 'tool' names {', '.join(measured)}, and {there}: give a table "
            "[[tool]] with name, xyz_mm and unknown for each (docs/robot-file.md); missing: "
            f"{', '.join(missing)}"
        )
    return m


def some_rows(rows: Sequence[object]) -> str:
    """Return the first eight rows, separated by commas, with dots where there are more."""
    return ", ".join(map(str, rows[:8])) + (" ..." if len(rows) > 8 else "")


def refuse_nameless(m: Measurements, robot: Robot) -> None:
    """Check that a table names its target, if the robot has several. Raises InputError."""
    if robot.targets and not m.target_names:
        target_names = ", ".join([robot.tool_name, *(t.name for t in robot.targets)])
        raise InputError(
            f"{m.source}: the robot file has several targets, {target_names}, and the table does "
            "not say which one was measured: add a column 'tool' with one of these names in each "
            "row, or list the rows in `tools` of problem.toml (docs/problem-folder.md)"
        )


def with_coupled(columns: Columns, robot: Robot) -> Columns:
    """Return the table with the variables of the robot file's rows in place of readings.

    Variables of coupled and locked joints are added. Where the controller counts otherwise than the
    rows (`readings` of the robot file), its readings are converted. Such columns are in rad or m;
    for other robots nothing is changed. Raises InputError where a logged reading contradicts the
    robot file.
    """
    coupled = [i for i, joint in enumerate(robot.joints, 1) if joint.coupling is not None]
    if not coupled and not robot.counts_otherwise:
        return columns
    read: dict[int, Array] = {}
    for i, joint in enumerate(robot.joints, 1):
        units = ("_deg", "_rad") if joint.kind == "revolute" else ("_mm", "_m")
        if any(f"q{i}{u}" in columns.table for u in units):  # others that are missing are refused later
            read[i] = columns.si(f"q{i}", units)
    q = np.column_stack([read.get(i, np.zeros(len(columns.table))) for i in robot.numbers])
    made = robot.coupled(q, readings=True)
    table = columns.table
    for i in coupled:
        turning = robot.joints[i - 1].kind == "revolute"
        if i not in read:
            table = table.assign(**{f"q{i}_{'rad' if turning else 'm'}": made[:, i - 1]})
            continue
        off = np.abs(q[:, i - 1] - made[:, i - 1])
        # Logged readings of a coupled or locked joint may differ by this from what the robot file
        # computes [rad or m]; it is well above the resolution of a reading.
        if off.max() > 2e-3:
            row = int(np.argmax(off))
            factor, unit = (180 / np.pi, "deg") if turning else (1e3, "mm")
            coupling = robot.joints[i - 1].coupling
            follows = coupling is not None and coupling.follows
            what = "follows other joints and would be" if follows else "is locked"
            logged, said = (f"{factor * v[row, i - 1]:.6g} {unit}" for v in (q, made))
            raise InputError(
                f"{columns.at(row)}, column q{i}: {logged}, and by the robot file joint {i} {what} "
                f"at {said}: no pose can be computed from both. Leave `follows` and `at_{unit}` out "
                f"of its row if it moves by itself; else leave the column q{i} out"
            )
    if robot.counts_otherwise and {*read, *coupled} == {*robot.numbers}:
        table = table.drop(columns=[c for c in table if re.fullmatch(r"q\d+_(deg|rad|mm|m)", str(c))])
        names = [f"q{i}_{unit}" for i, unit in enumerate(robot.units, 1)]
        table = table.assign(**dict(zip(names, robot.variables_of(made).T, strict=True)))
    return replace(columns, table=table)

"""Tests by ISO 9283:1998: planned poses in the standard's cube, and evaluation of measured tables.

The table has one row for each visit: `test` (accuracy, directions or drift), `pose` (1 to 5),
`cycle`, for directions `path` (1 to 3), for drift `group` (0 at the start), the command cx_mm,
cy_mm, cz_mm in the robot's base frame and the measured x_mm, y_mm, z_mm in the measuring frame.
Formulas, with a bar for the mean over a pose's n visits and c for the command (sections 7.2, 7.3):

    AP = |p_bar - p_c|                        accuracy of a pose
    RP = l_bar + 3 S_l, l_j = |p_j - p_bar|   repeatability, S_l with n - 1
    vAP = max |p_bar_h - p_bar_k|             multi-directional variation, over the approach paths h and k
    dAP = max |AP_0 - AP_T|, dRP alike        drift, over the groups after the first
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd

from casadical.core.basics import Array, InputError
from casadical.core.reporting.blocks import Table, Words, mm
from casadical.core.reporting.plain import IN_MM, WRITTEN, Key, plain, written
from casadical.core.reporting.result import Result
from casadical.identification.accuracy import predicted
from casadical.identification.pose_selection.candidates import draw, expected, poses_at_places
from casadical.identification.pose_selection.workspace import Workspace
from casadical.measurements.columns import Columns
from casadical.measurements.measurements import unmeasured
from casadical.measurements.raw_table import read_table
from casadical.robot.inverse_kinematics import solve_joints
from casadical.robot.robot import Robot

# Number of visits of each pose in the standard's tests of accuracy and of directions.
STANDARD_CYCLES = 30


def poses_in(centre: Array, side: float) -> Array:
    """Return the test poses P1 to P5 of a cube, shape (5, 3) [m]; P1 is the cube's centre.

    They lie on its plane C1-C2-C7-C8 (the names of the standard).

    centre : of the cube, shape (3,) [m], in the frame of its edges
    side : of the cube [m]
    """
    # P2 to P5 lie on the cube's diagonals, 10 % from their ends (section 6.8).
    h = side / 2 * (1 - 2 * 0.1)
    return np.asarray(centre + h * np.array([[0, 0, 0], [-1, -1, -1], [-1, 1, -1], [1, 1, 1], [1, -1, 1]]))


def planned_test(
    robot: Robot, side: float | None = None, workspace: Workspace | None = None, seed: int = 0
) -> tuple[pd.DataFrame, Array, float]:
    """Return the table of a test to measure, and centre and side [m] of its cube.

    The centre has shape (3,) and is in the robot's base frame.

    side : side of the cube [m]; None: the largest of the standard that the robot reaches
    workspace : where poses may lie; None: everywhere
    Raises InputError: no cube is within reach.
    """
    room, rng = workspace or Workspace(), np.random.default_rng(seed)
    inside = expected(robot, draw(robot, 500, room, rng), {}, "position").position
    assert inside is not None
    R, origin = robot.base.T[:3, :3], robot.base.T[:3, 3]
    farthest = float(np.linalg.norm(inside - origin, axis=1).max())
    order = np.argsort(np.linalg.norm(inside - np.median(inside, axis=0), axis=1))
    # Sides of the standard's cubes [m], the largest first.
    for size in (side,) if side else (1.0, 0.63, 0.4, 0.25):
        # Twelve centres are tried, spread over the most central half of the reachable places.
        for middle in inside[order[:240:20]]:
            local = (middle - origin) @ R
            places = poses_in(local, size) @ R.T + origin
            if np.linalg.norm(places - origin, axis=1).max() > 1.05 * farthest:
                continue
            # The other poses are reached from twenty readings with the tool at P1.
            q, _ = poses_at_places(robot, places[:1], 20, room, rng)
            solutions = _one_orientation(robot, q, places, room) if len(q) else None
            if solutions is not None:
                return _test_table(robot, solutions, poses_in(local, size)), local, size
    wanted = "of the standard" if side is None else f"of {1e3 * side:.0f} mm"
    raise InputError(f"{robot.name}: no cube {wanted} is within its reach in one orientation; give --cube-mm or --room")


def _one_orientation(robot: Robot, q: Array, places: Array, room: Workspace) -> Array | None:
    """Return joint variables that reach five places, shape (5, joints) [rad or m], or None.

    The orientation is the same at all of them if the robot has six joints or more.

    q : variables at the first place, shape (k, joints) [rad or m]; one gives the orientation
    places : in the measuring frame, shape (5, 3) [m]; room : where poses may lie
    """
    R = predicted(robot, unmeasured(q))[1]
    rows, limits = 6 if robot.n >= 6 else 3, room.ranges(robot)
    solutions, good = [q], np.ones(len(q), dtype=bool)
    for place in places[1:]:

        def off(q: Array, which: Array, place: Array = place) -> tuple[Array, Array]:
            """Return pose errors (k, 6) [m, rad] and their Jacobians (k, 6, joints).

            q : trial variables, shape (k, joints); which : index of each one's orientation; place :
                wanted position, shape (3,) [m]. Robots with fewer than six joints have 3 errors.
            """
            p, now = predicted(robot, unmeasured(np.concatenate([q, *(q + 1e-6 * e for e in np.eye(robot.n))])))
            turned = R[np.tile(which, robot.n + 1)]
            turn = 0.5 * np.cross(turned.transpose(0, 2, 1), now.transpose(0, 2, 1)).sum(axis=1)
            r = np.hstack([place - p, -turn])[:, :rows].reshape(robot.n + 1, len(q), rows)
            return r[0], (r[0] - r[1:]).transpose(1, 2, 0) / 1e-6

        now = solve_joints(off, solutions[0], 30, 0.3, limits=limits, coupled=robot.coupled, damping=1e-8)
        good &= (np.abs(off(now, np.arange(len(now)))[0]).max(axis=1) < 1e-6) & room.allows(robot, now)
        solutions.append(now)
    some = np.flatnonzero(good)
    if not len(some):
        return None
    every = np.stack(solutions)[:, some]
    return np.asarray(every[:, int(np.argmin(np.ptp(every, axis=0).max(axis=1)))])


def words_of_plan(robot: Robot, table: pd.DataFrame, centre: Array, side: float) -> list[Words]:
    """Return sentences for the operator of a planned test: size, place and conditions.

    table : of the planned visits; centre, side : of the cube in the base frame [m]
    """
    x, y, z = (f"{1e3 * v:.0f}" for v in centre)
    return [
        Words(
            f"A test of {robot.name} by ISO 9283:1998: {len(table)} visits of five poses in a "
            f"cube of {1e3 * side:.0f} mm about ({x}, {y}, {z}) mm in the base frame.",
            "verdict",
        ),
        Words(
            "Command cx_mm, cy_mm, cz_mm in one orientation, at rated load and 100 % of the rated "
            "speed, after the warm-up that the maker states; the readings are those of the model "
            "in one orientation: put in those of the controller where it reaches the poses "
            "otherwise. Visits of `directions` come from three paths that are perpendicular to "
            "each other; a group of `drift` follows every ten minutes for 8 hours. Fill in x_mm, "
            "y_mm, z_mm in the frame in which the robot was calibrated."
        ),
    ]


def _test_table(robot: Robot, q: Array, command: Array) -> pd.DataFrame:
    """Return the table of all visits in the order of the standard, its measured columns empty.

    P5 to P1 in each cycle; P1, P2 and P4 from three paths; P1 for 8 h.

    q : joint variables of the poses, shape (5, joints) [rad or m]; the table has their readings
    command : positions in the base frame, shape (5, 3) [m]
    """
    rows: list[tuple[str, int, int, int, int]] = []
    rows += [("accuracy", p, c, 0, 0) for c in range(1, STANDARD_CYCLES + 1) for p in (5, 4, 3, 2, 1)]
    rows += [("directions", p, c, h, 0) for p in (1, 2, 4) for c in range(1, STANDARD_CYCLES + 1) for h in (1, 2, 3)]
    # Drift over eight hours: a group of ten visits every ten minutes.
    rows += [("drift", 1, c, 0, g) for g in range(49) for c in range(1, 11)]
    table = pd.DataFrame(rows, columns=["test", "pose", "cycle", "path", "group"])
    at = table["pose"].to_numpy() - 1
    for (key, factor), own in zip(robot.reading_units.items(), robot.readings_of(q[at]).T, strict=True):
        table[key] = (own / factor).round(5)
    for i, axis in enumerate("xyz"):
        table[f"c{axis}_mm"] = (1e3 * command[at, i]).round(4)
    for axis in "xyz":
        table[f"{axis}_mm"] = ""
    return table


@dataclass(frozen=True)
class PoseFigures:
    """The figures of one pose.

    pose : 1 to 5
    n : number of visits
    AP : pose accuracy, distance of the mean position from the command [m]
    parts : components of that distance in the base frame, measured minus command, shape (3,) [m]
    RP : pose repeatability, mean distance from the mean position plus three sigma [m]
    """

    pose: int = field(metadata=WRITTEN)
    n: int = field(metadata=WRITTEN)
    AP: float = field(metadata=IN_MM)
    parts: tuple[float, float, float] = field(metadata=IN_MM)
    RP: float = field(metadata=IN_MM)


@dataclass(frozen=True, eq=False)
class Iso9283(Result):
    """The figures of a test table by the standard, and those of the calibration at the same visits.

    robot : name of the robot
    accuracy : AP and RP of each pose
    directions : vAP by pose [m], of poses that were approached on two paths or more
    drift : dAP and dRP [m]; None without a pose that was visited in the group 0 and a later one
    model : rms error of the calibrated model at the mean positions [m], None without joint readings
    promised : rms error that the calibration states [m], None without one
    notes : doubts about the table, in words
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("poses"),
        Key("dAP", lambda test: test.drift and test.drift[0], "mm"),
        Key("dRP", lambda test: test.drift and test.drift[1], "mm"),
    )

    robot: str = field(metadata=WRITTEN)
    accuracy: tuple[PoseFigures, ...]
    directions: Mapping[int, float]
    drift: tuple[float, float] | None = None
    model: float | None = field(default=None, metadata=written("model_rms", "mm"))
    promised: float | None = field(default=None, metadata=written("promised_rms", "mm"))
    notes: tuple[str, ...] = field(default=(), metadata=WRITTEN)

    @property
    def worst(self) -> tuple[float, float]:
        """Return the greatest AP and the greatest RP [m]."""
        return max(f.AP for f in self.accuracy), max(f.RP for f in self.accuracy)

    @property
    def poses(self) -> list[dict[str, float | None]]:
        """Return the figures of each pose as plain data, with its variation over the approaches."""
        vAP = {pose: 1e3 * metres for pose, metres in self.directions.items()}
        return [{**plain(f), "vAP_mm": vAP.get(f.pose)} for f in self.accuracy]

    report: ClassVar[str] = "iso9283.j2"

    def table(self) -> Table:
        """Return a table of AP, its components, RP and vAP [mm], one row for each pose."""
        rows = []
        for f in self.accuracy:
            parts = (f"{1e3 * v:+.4f}" for v in f.parts)
            direction = mm(self.directions[f.pose]) if f.pose in self.directions else "-"
            rows.append((f"P{f.pose}", str(f.n), mm(f.AP), *parts, mm(f.RP), direction))
        head = ("pose", "n", "AP [mm]", "APx", "APy", "APz", "RP [mm]", "vAP [mm]")
        return Table("ISO 9283:1998", head, rows, frozenset(range(1, 8)))


def evaluated_table(path: Path, robot: Robot, promised: float | None = None) -> Iso9283:
    """Return the figures AP, RP, vAP, dAP and dRP of a measured test table.

    robot : calibrated robot, whose base frame is that of the commands
    promised : rms error of its calibration [m] Without a column `test` all visits are of accuracy.
    Raises InputError: another missing column, no finite number, a test without visits.
    """
    columns = Columns.of_file(read_table(path))
    measured, command = columns.vector(""), columns.vector("c")
    local = (measured - robot.base.T[:3, 3]) @ robot.base.T[:3, :3]
    pose = columns.column("pose").astype(int)
    names = [str(word).strip().lower() for word in columns.table.get("test", pd.Series(["accuracy"] * len(pose)))]
    # Words of the column `test`.
    test_names = ("accuracy", "directions", "drift")
    if wrong := sorted(set(names) - set(test_names)):
        raise InputError(f"{columns.source}: column 'test': {wrong[0]!r}; allowed: {', '.join(test_names)}")
    test = np.array(names)
    if not (test == "accuracy").any():
        raise InputError(f"{columns.source}: no visit of the test 'accuracy', which AP and RP are of")
    accuracy = _by_pose(pose, local, command, test == "accuracy")
    directions: dict[int, float] = {}
    for k in np.unique(pose[test == "directions"]):
        own = (test == "directions") & (pose == k)
        path_ = columns.column("path")
        means = [local[own & (path_ == h)].mean(axis=0) for h in np.unique(path_[own])]
        if len(means) > 1:
            directions[int(k)] = max(float(np.linalg.norm(a - b)) for a, b in combinations(means, 2))
    drift = None
    if (test == "drift").any():
        group = columns.column("group")
        groups = np.unique(group[test == "drift"])
        first, *later = (_by_pose(pose, local, command, (test == "drift") & (group == g)) for g in groups)
        then = {f.pose: f for f in first}
        off = [(abs(then[f.pose].AP - f.AP), abs(then[f.pose].RP - f.RP)) for g in later for f in g if f.pose in then]
        drift = (max(AP for AP, _ in off), max(RP for _, RP in off)) if off else None
    few = [f"P{f.pose}" for f in accuracy if f.n < STANDARD_CYCLES]
    notes = [f"fewer visits than the {STANDARD_CYCLES} of the standard at {', '.join(few)}"] if few else []
    if np.median([f.AP for f in accuracy]) > 0.05 * robot.reach:
        notes.append(
            "AP is as great as if the instrument stood elsewhere: positions are taken to the base "
            "frame by the base of the robot file; measure with the instrument where it stood, or "
            "calibrate from there"
        )
    model = _model_error(robot, columns, test == "accuracy", measured, accuracy)
    return Iso9283(robot.name, accuracy, directions, drift, model, promised, tuple(notes))


def _by_pose(pose: Array, p: Array, command: Array, own: Array) -> tuple[PoseFigures, ...]:
    """Return AP and RP of each pose over the visits that the mask `own` selects.

    pose : number of each visit's pose, shape (n,); p, command : measured and commanded positions in
        the base frame, shape (n, 3) [m]
    """
    figures = []
    for k in np.unique(pose[own]):
        visits = p[own & (pose == k)]
        # RP needs a standard deviation, so at least two visits.
        if len(visits) < 2:
            raise InputError(f"pose {k}: {len(visits)} visit; RP needs 2 or more, the standard {STANDARD_CYCLES}")
        mean = visits.mean(axis=0)
        length = np.linalg.norm(visits - mean, axis=1)
        x, y, z = map(float, mean - command[own & (pose == k)].mean(axis=0))
        RP = float(length.mean() + 3 * length.std(ddof=1))
        AP = float(np.linalg.norm([x, y, z]))
        figures.append(PoseFigures(int(k), len(visits), AP, (x, y, z), RP))
    return tuple(figures)


def _model_error(
    robot: Robot, columns: Columns, own: Array, measured: Array, accuracy: Sequence[PoseFigures]
) -> float | None:
    """Return the rms error of the calibrated model at the mean positions of the poses [m].

    None where the table has no joint readings.

    own : mask of the visits that count, shape (n,); measured : positions in the measuring frame,
        shape (n, 3) [m]
    """
    if any(key not in columns.table for key in robot.reading_units):
        return None
    q = robot.variables_of(columns.joints([j.kind for j in robot.joints])[own])
    p = expected(robot, q, {}, "position").position
    assert p is not None
    pose = columns.column("pose")[own]
    off = [np.linalg.norm((measured[own] - p)[pose == f.pose].mean(axis=0)) for f in accuracy]
    return float(np.sqrt(np.mean(np.square(off))))

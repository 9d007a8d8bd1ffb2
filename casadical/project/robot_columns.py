"""Interpretation of a table by the nominal robot: ambiguous headings, targets, coupled joints."""

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product

import numpy as np

from casadical.core.basics import Array, ConvergenceError, InputError
from casadical.identification.accuracy import errors as position_errors
from casadical.identification.accuracy import predicted
from casadical.identification.arm_or_camera import evidence_of
from casadical.identification.identification import identify
from casadical.identification.placement import place_frames
from casadical.identification.plausibility import frame_error, orientation_error
from casadical.identification.sessions import sessions_in
from casadical.measurements.camera_noise import Camera
from casadical.measurements.columns import ORIENTATION, Columns, Source
from casadical.measurements.derived_columns import TIME_COLUMN
from casadical.measurements.headings import Understanding, layout, orientations_in_order, points, understand
from casadical.measurements.measurements import Measurements
from casadical.measurements.raw_table import RawTable
from casadical.measurements.reading import from_columns
from casadical.robot.robot import Robot

# Largest error of the nominal robot (see `_total`; of orientation alone in rad) with which the
# meaning of an ambiguous heading is accepted without a question.
MAX_ORIENTATION_ERROR_RAD = np.deg2rad(5.0)
# Minimum ratio of the error with every other meaning of a heading to that with the best one, with
# which the best one is accepted without a question.
MIN_ERROR_RATIO_TO_OTHERS = 4.0
# Maximum number of interpretations of a table, none of which fits the robot, with which slips are
# searched for; each takes a second.
MAX_CHOICES_WITH_SLIPS = 8


def understood(raw: RawTable, robot: Robot, given: Mapping[str, Source], kind: str | None = None) -> Understanding:
    """Return what headings mean (see `understand`), ambiguities resolved by the nominal robot.

    given : casadical's column name -> declared source
    kind : kind of measurement, None where it is not declared
    """
    placed = any(re.fullmatch("[xyz]_mm?|distance_mm?", name) for name in given)
    question = None if raw.form.header_line or placed else layout(raw, robot.joints)
    if question:
        meaning = _by_model(raw, robot, given, Understanding((), (question,)))
        usual = understand(raw, robot.joints, given, kind=kind)
        if not meaning.questions or not usual.columns:
            return meaning if meaning.questions else _with_orientation(raw, robot, meaning, kind)
    meaning = _by_model(raw, robot, given, understand(raw, robot.joints, given, kind=kind))
    return _without_other_frame(raw, robot, given, _measured_instead(raw, robot, given, meaning))


def _measured_instead(raw: RawTable, robot: Robot, given: Mapping[str, Source], found: Understanding) -> Understanding:
    """Return the meaning with measured coordinates in place of computed ones, if the table has both.

    given : casadical's column name -> declared source; found : meaning of all columns
    """
    computed_ones = [c for c in found.columns if re.fullmatch("[xyz]_mm?", c.ours)]
    question = points(raw, [c.source.name for c in computed_ones]) if computed_ones and not found.questions else None
    if question is None:
        return found
    with suppress(InputError, np.linalg.LinAlgError):
        if not computed(robot, _measurements_of(raw, robot, {**found.sources, **given})):
            return found
        others = replace(found, columns=tuple(c for c in found.columns if c not in computed_ones))
        tried = _by_model(raw, robot, given, replace(others, questions=(question,)))
        if not tried.questions:
            return tried
    return found


def _with_orientation(raw: RawTable, robot: Robot, found: Understanding, kind: str | None) -> Understanding:
    """Return the meaning of a table without headings, with an orientation if one fits the robot.

    found : meaning of readings and positions
    """
    if kind == "position" or "R00" in found.sources:
        return found
    used = {name for source in found.sources.values() for name in (source.name, *source.add)}
    more = _by_model(raw, robot, {}, replace(found, questions=tuple(orientations_in_order(raw, used))))
    return replace(more, questions=())


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


def _without_other_frame(
    raw: RawTable, robot: Robot, given: Mapping[str, Source], found: Understanding
) -> Understanding:
    """Return the meaning of columns without orientations that were not measured with positions.

    Such orientations are in another frame than the positions, or the controller's own, computed by
    the nominal model.

    given : casadical's column name -> declared source; found : meaning of all columns
    """
    turned = [c for c in found.columns if re.fullmatch(ORIENTATION, c.ours)]
    if not turned or found.questions:
        return found
    # Orientations that agree with the nominal model within this [rad] were computed as well.
    computed_orientation_tolerance_rad = 2e-5
    with suppress(InputError, np.linalg.LinAlgError):
        m = _measurements_of(raw, robot, {**found.sources, **given})
        if m.orientation is not None and (
            frame_error(robot, m)
            or (_orientation_error(robot, m) < computed_orientation_tolerance_rad and not computed(robot, m))
        ):
            return replace(found, columns=tuple(c for c in found.columns if c not in turned))
    return found


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
    if "corners" in m.extra and camera and inverted is None:
        inverted = camera == "in hand"  # what was seen is the target in the camera
    # With fewer poses it is not judged whether they are inverted.
    if inverted is None and len(m) >= 5:
        here, there = (_pose_error(robot, poses) for poses in (m, m.inverse()))
        inverted = MIN_ERROR_RATIO_TO_OTHERS * there < here
        undecided = there < MIN_ERROR_RATIO_TO_OTHERS * here and not inverted
        inverted = camera == "in hand" if undecided and camera else inverted
    m = m.inverse() if inverted else m
    if "corners" in m.extra:
        camera = "in hand" if m.inverted else "to base"
    return _synchronised(replace(m, camera=camera or _camera_of(m, robot)), robot)


def _synchronised(m: Measurements, robot: Robot) -> Measurements:
    """Return poses that a camera saw in motion with the joint readings at the images' times.

    The offset of both clocks, within 0.3 s, is the one with which base and tool fit best. The
    measurements are returned unchanged where rows are more than 0.2 s apart or too few, or where no
    offset is clearly better than none.
    """
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
    free = replace(robot, base=replace(robot.base, unknown="pose"), tool=replace(robot.tool, unknown="position"))

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


def _pose_error(robot: Robot, m: Measurements) -> float:
    """Return the dimensionless error of poses by a robot with base and tool fitted.

    It is the median orientation error [rad] plus the median position error divided by the reach.
    """
    base, tool = (replace(frame, unknown="pose") for frame in (robot.base, robot.tool))
    turn = orientation_error(replace(robot, base=base, tool=tool), m)
    return turn + placed_by(robot, m)[1] / robot.reach


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
    base, tool = (replace(frame, unknown="pose") for frame in (robot.base, robot.tool))
    # More poses than 80 are not needed.
    some = replace(m, camera="", noise=None)[np.unique(np.linspace(0, len(m) - 1, min(len(m), 80)).astype(int))]
    try:
        found = identify(replace(robot, base=base, tool=tool), some, method="KM", loss="huber")
        likely = {camera: evidence_of(found, camera) for camera in off}
    except (InputError, ConvergenceError, np.linalg.LinAlgError):
        return by_angle
    best, other = sorted(likely, key=lambda camera: -likely[camera][0])
    lateral, depth, _, _ = likely[best][1].ratios
    # The origin of a board, its corner, may be further off the axis than its middle.
    if likely[best][0] > likely[other][0] + 5 and depth > lateral and off[best] < np.deg2rad(60.0):
        return best  # by chance with a probability below 1 %
    return by_angle if by_angle == best else ""


def _by_model(raw: RawTable, robot: Robot, given: Mapping[str, Source], found: Understanding) -> Understanding:
    """Return the meaning of columns with the questions answered by the nominal robot, if it can.

    Every interpretation of the table, which is one choice of each question, is judged by its error:
    that of the robot, its frames placed to fit. A choice is taken where the error is small and that
    of all interpretations with another choice at least MIN_ERROR_RATIO_TO_OTHERS times as large.
    Where not, the choices of questions with a topic are ordered, the best fit first.

    given : casadical's column name -> declared source; found : meaning with the open questions
    """
    questions = found.questions
    if not questions or math.prod(len(q.choices) for q in questions) > 2000:
        return found
    errors: dict[tuple[str, ...], tuple[float, float]] = {}
    readings: dict[tuple[str, ...], Measurements] = {}
    copied: set[tuple[str, ...]] = set()
    for choices in product(*(q.choices for q in questions)):
        tried = found
        for question, choice in zip(questions, choices, strict=True):
            tried = tried.answered(question, choice)
        sources = {**tried.sources, **given}
        if len({s.name for s in sources.values()}) < len(sources):  # no column has two meanings
            continue
        with suppress(InputError, np.linalg.LinAlgError):
            m = _measurements_of(raw, robot, sources)
            if m.position is not None and len(m) >= 6:  # 18 numbers for the 9 unknown ones of base and tool
                turn = 0.0 if m.orientation is None else _orientation_error(robot, m)
                errors[choices], readings[choices] = (placed_by(robot, m)[1], turn), m
                copied |= {choices} if computed(robot, m, rounded=True) else set()
    answers: dict[str, tuple[str, str]] = {}
    order = sorted(errors, key=lambda c: _total(robot, errors[c]))
    if 0 < len(errors) <= MAX_CHOICES_WITH_SLIPS and _total(robot, errors[order[0]]) > MAX_ORIENTATION_ERROR_RAD:
        errors |= {choices: error for choices, m in readings.items() if (error := _error_without_slips(robot, m))}
        order = sorted(errors, key=lambda c: _total(robot, errors[c]))
    for k, question in enumerate(questions):
        lengths = [c for c in question.choices if len(question.choices[c]) == 1]
        if question.about == "observation" and lengths and copied:
            answers[question.text] = lengths[0], "the coordinates are computed, as the nominal robot has them"
            continue
        # Coordinates that a controller computed fit best, but were not measured.
        if question.about == "observation" and len({c[k] for c in errors}) > len({c[k] for c in copied}):
            order = [c for c in order if c[k] not in {c[k] for c in copied}]
        if not order:
            continue
        best, others = order[0], [c for c in order if c[k] != order[0][k]]
        if len(errors) < len(question.choices) and not others and len(question.choices) > 1:
            continue
        least, second = (_total(robot, errors[c]) if c else np.inf for c in (best, others[0] if others else None))
        bound = MAX_ORIENTATION_ERROR_RAD if others or question.about == "layout" else 0.02
        if least < bound and MIN_ERROR_RATIO_TO_OTHERS * least < second:
            answers[question.text] = (
                best[k],
                _why(
                    "comparison: " if question.about == "layout" else f"{best[k]}: ",
                    errors[best],
                    errors[others[0]] if others else None,
                ),
            )
    for question in questions:
        if question.text in answers:
            found = found.answered(question, *answers[question.text])
    if not order:
        return found
    asked = []
    for question in found.questions:
        k = questions.index(question)
        ranked = dict.fromkeys([*(c[k] for c in order), *question.choices])
        # A layout has too many choices to be asked: the best are.
        some = [*ranked][: 5 if question.about == "layout" else None]
        asked.append(replace(question, choices={c: question.choices[c] for c in some}) if question.about else question)
    return replace(found, questions=tuple(asked))


def _error_without_slips(robot: Robot, m: Measurements) -> tuple[float, float] | None:
    """Return median errors [m, rad] with the slips that explain m undone; None without such."""
    from casadical.project.check.slips import search_slips

    found = search_slips(robot, m)
    return (found.best.error, found.best.turn) if found and found.explains else None


def _total(robot: Robot, error: tuple[float, float]) -> float:
    """Return the position error divided by the reach, plus the orientation error, dimensionless.

    error : median error of positions [m] and of orientations [rad]
    """
    return error[0] / robot.reach + error[1]


def _why(choice: str, error: tuple[float, float], other: tuple[float, float] | None) -> str:
    """Return why a choice is taken, by errors [m, rad] of the best and next interpretation.

    choice : beginning of the text
    """
    turned = error[1] and other is not None and other[1]
    unit, k, factor = ("deg", 1, 180 / np.pi) if turned else ("mm", 0, 1e3)
    rest = f", else {factor * other[k]:.2g}" if other else ""
    off = factor * error[k]
    return f"{choice}{off if off > 1e-6 else 0:.2g} {unit} from the robot{rest}"


def _measurements_of(raw: RawTable, robot: Robot, sources: Mapping[str, Source]) -> Measurements:
    """Return the measurements of a table's complete rows, read with these column sources.

    sources : casadical's column name -> its source
    """
    columns = with_coupled(Columns.of_file(raw).mapped(sources), robot)
    return as_poses(from_columns(columns.without(columns.lost_rows, ""), [j.kind for j in robot.joints]), robot)


def _orientation_error(robot: Robot, m: Measurements) -> float:
    """Return the median orientation error [rad] of the nominal robot, its tool rotated to fit."""
    return orientation_error(replace(robot, tool=replace(robot.tool, unknown="pose")), m)


def computed(robot: Robot, m: Measurements, rounded: bool = False) -> bool:
    """Return whether positions equal the nominal robot's within rounding, so are not measured.

    Base and tool may differ. False for fewer than six poses.

    rounded : whether the rounding of the readings counts, too, by which the positions of a robot
        that was measured coarsely may agree by chance
    """
    if m.position is None or len(m) < 6:
        return False
    digits = next((k for k in range(3, 9) if np.abs(m.position - m.position.round(k)).max() < 1e-12), 9)
    # Positions that agree with the nominal model within this [m], or within their last digit, were
    # computed by a controller and not measured.
    computed_position_tolerance = 2e-6
    placed, error = placed_by(robot, m)
    tolerance = max(computed_position_tolerance, 10.0**-digits)
    if rounded:
        steps = np.array([_last_digit(q) for q in m.q.T])
        moved = replace(m, q=m.q + steps * np.random.default_rng(0).uniform(-0.5, 0.5, m.q.shape))
        off = predicted(placed, moved)[0] - predicted(placed, m)[0]
        # Both the logged readings and those that the frames are fitted to are rounded.
        tolerance += 1.5 * float(np.median(np.linalg.norm(off, axis=1)))
    return error < tolerance


def _last_digit(q: Array) -> float:
    """Return the unit of the last decimal [rad or m] of a joint's readings; 0 if none fits.

    q : readings, shape (n,) [rad or m], written in deg, rad, mm or m
    """
    for digits in range(5):
        for unit in (np.pi / 180, 1.0, 1e-3):
            if np.abs(q / unit - (q / unit).round(digits)).max() < 1e-9:
                return float(unit * 10.0**-digits)
    return 0.0


def placed_by(robot: Robot, m: Measurements) -> tuple[Robot, float]:
    """Return the robot with base and tool position fitted, and its median position error [m]."""
    free = replace(robot, base=replace(robot.base, unknown="pose"), tool=replace(robot.tool, unknown="position"))
    placed = place_frames(free, m.positions_alone())
    return placed, float(np.median(position_errors(placed, m.positions_alone())))


def with_target_positions(m: Measurements, robot: Robot) -> Measurements:
    """Return the measurements, whose targets (column `tool`) must be targets of the robot file.

    Where the robot has a single target, a column `tool` that names one alone is removed, whatever
    the name. Raises InputError where the column names a target that the robot file does not have.
    """
    measured = names_in(m)
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


def names_in(m: Measurements) -> list[str]:
    """Return the names of the measured targets, in the order in which they appear."""
    return [name.removeprefix("tool_") for name in m.conditions if name.startswith("tool_")]


def some_rows(rows: Sequence[object]) -> str:
    """Return the first eight rows, separated by commas, with dots where there are more."""
    return ", ".join(map(str, rows[:8])) + (" ..." if len(rows) > 8 else "")


def refuse_nameless(m: Measurements, robot: Robot) -> None:
    """Check that a table names its target, if the robot has several. Raises InputError."""
    if robot.targets and not names_in(m):
        target_names = ", ".join([robot.tool_name, *(t.name for t in robot.targets)])
        raise InputError(
            f"{m.source}: the robot file has several targets, {target_names}, and the table does "
            "not say which one was measured: add a column 'tool' with one of these names in each "
            "row, or list the rows in `tools` of problem.toml (docs/problem-folder.md)"
        )


def unfitted(sets: Mapping[str, Sequence[Measurements]]) -> list[str]:
    """Return a sentence for each target or session that the set identify lacks, with a remedy.

    No fitted pose then determines its point, or its base and tool.

    sets : set -> its measurements
    """
    fitted = {name for m in sets.get("identify", ()) for name in names_in(m) if m.conditions[f"tool_{name}"].any()}
    faults = []
    for name, parts in sets.items():
        for m in parts:
            for target in names_in(m):
                rows = m.row[m.conditions[f"tool_{target}"] > 0]
                if target not in fitted and len(rows):
                    listed = some_rows(rows.tolist())
                    faults.append(
                        f"{m.source}: target {target!r} was measured in row {listed} only, of the "
                        f"set {name!r}; no pose that is fitted tells where it is: measure it at "
                        f"three poses or more, or leave the rows out (leave_out = [{listed}] in "
                        "problem.toml)"
                    )
    inside = set(sessions_in(sets.get("identify", ())))
    for name, parts in sets.items():
        for session in sorted(set(sessions_in(parts)) - inside):
            faults.append(
                f"session {session!r} has poses of the set {name!r} only; none that is fitted "
                "tells where its base and tool are: put some of them into the set 'identify'"
            )
    return faults


def unmeasured(sets: Mapping[str, Sequence[Measurements]], robot: Robot) -> list[str]:
    """Return the targets of the robot file that no row names."""
    seen = {name for parts in sets.values() for m in parts for name in names_in(m)}
    return [name for name in (robot.tool_name, *(t.name for t in robot.targets)) if name and name not in seen]


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
            _refuse_coupled_reading(columns, robot, i, int(np.argmax(off)), q, made)
    if robot.counts_otherwise and {*read, *coupled} == {*robot.numbers}:
        table = table.drop(columns=[c for c in table if re.fullmatch(r"q\d+_(deg|rad|mm|m)", str(c))])
        names = [f"q{i}_{unit}" for i, unit in enumerate(robot.units, 1)]
        table = table.assign(**dict(zip(names, robot.variables_of(made).T, strict=True)))
    return replace(columns, table=table)


def _refuse_coupled_reading(columns: Columns, robot: Robot, i: int, row: int, q: Array, made: Array) -> None:
    """Raise the InputError for a coupled or locked joint whose reading contradicts the robot file.

    i : number of the joint; row : index of the row
    q, made : logged and computed readings, shape (n, joints) [rad or m]
    """
    factor, unit = (180 / np.pi, "deg") if robot.joints[i - 1].kind == "revolute" else (1e3, "mm")
    coupling = robot.joints[i - 1].coupling
    what = "follows other joints and would be" if coupling and coupling.follows else "is locked"
    read, said = (f"{factor * v[row, i - 1]:.6g} {unit}" for v in (q, made))
    raise InputError(
        f"{columns.at(row)}, column q{i}: {read}, and by the robot file joint {i} {what} at "
        f"{said}: no pose can be computed from both. Leave `follows` and `at_{unit}` out of its "
        f"row if it moves by itself; else leave the column q{i} out"
    )

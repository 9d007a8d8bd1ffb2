"""Recognition of a table: the proposed meanings of its columns are scored by the nominal robot.

What the table's headings and its order propose (`casadical.measurements.proposals`) is read, base
and tool are placed to fit, and the error that is left decides, as far as it can.
"""

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import product

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.identification.accuracy import predicted
from casadical.identification.plausibility import frame_error, orientation_error
from casadical.measurements.columns import ORIENTATION, Columns, Source
from casadical.measurements.measurements import Measurements
from casadical.measurements.proposals import Understanding, points, understand
from casadical.measurements.raw_table import RawTable
from casadical.measurements.reading import from_columns
from casadical.project.robot_columns import MIN_ERROR_RATIO_TO_OTHERS, of_tool, placed_by, with_coupled
from casadical.robot.robot import Robot

# Largest error of the nominal robot (see `_total`; of orientation alone in rad) with which the
# meaning of an ambiguous heading is accepted without a question.
MAX_ORIENTATION_ERROR_RAD = np.deg2rad(5.0)


def understood(raw: RawTable, robot: Robot, given: Mapping[str, Source], kind: str | None = None) -> Understanding:
    """Return what headings mean (see `understand`), ambiguities resolved by the nominal robot.

    given : casadical's column name -> declared source
    kind : kind of measurement, None where it is not declared
    """
    found = _by_model(raw, robot, given, understand(raw, robot.joints, given, kind=kind)).in_usual_order
    if not (raw.form.header_line or found.questions):  # the columns that are left may be an orientation
        more = understand(raw, robot.joints, {**found.sources, **given}, kind=kind)
        whole = Understanding((*found.columns, *more.columns), more.questions)
        found = replace(_by_model(raw, robot, given, whole), questions=())
    # Orientations in another frame than the positions, or computed by the robot, are left out.
    found = _measured_instead(raw, robot, given, found)
    turned = [c for c in found.columns if re.fullmatch(ORIENTATION, c.ours)]
    if not turned or found.questions:
        return found
    # Orientations that agree with the nominal model within this [rad] were computed as well.
    computed_orientation_tolerance_rad = 2e-5
    with suppress(InputError, np.linalg.LinAlgError):
        m = _measurements_of(raw, robot, {**found.sources, **given})
        free = robot.with_unknown(tool="pose")
        if m.orientation is not None and (
            frame_error(robot, m)
            or (orientation_error(free, m) < computed_orientation_tolerance_rad and not computed(robot, m))
        ):
            return replace(found, columns=tuple(c for c in found.columns if c not in turned))
    return found


def _measured_instead(raw: RawTable, robot: Robot, given: Mapping[str, Source], found: Understanding) -> Understanding:
    """Return the meaning with measured coordinates, not computed ones, if the table has both."""
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


def _by_model(raw: RawTable, robot: Robot, given: Mapping[str, Source], found: Understanding) -> Understanding:
    """Return the meaning of columns with the questions answered by the nominal robot, if it can.

    Every interpretation of the table, which is one choice of each question, is judged by its error:
    that of the robot, its frames placed to fit. A choice is taken where the error is small and that
    of all interpretations with another choice at least MIN_ERROR_RATIO_TO_OTHERS times as large.
    Where not, the choices of questions with a topic are ordered, the best fit first.
    """
    questions = found.questions
    if not questions or math.prod(len(q.choices) for q in questions) > 2000:
        return found
    errors: dict[tuple[str, ...], tuple[float, float]] = {}
    readings: dict[tuple[str, ...], Measurements] = {}
    copied: set[tuple[str, ...]] = set()
    for choices in product(*(q.choices for q in questions)):
        chosen = (c for q, choice in zip(questions, choices, strict=True) for c in q.choices[choice])
        sources = {**{c.ours: c.source for c in (*found.columns, *chosen)}, **given}
        if len({s.name for s in sources.values()}) < len(sources):  # no column has two meanings
            continue
        with suppress(InputError, np.linalg.LinAlgError):
            m = _measurements_of(raw, robot, sources)
            if m.position is not None and len(m) >= 6:  # 18 numbers for the 9 unknown ones of base and tool
                turn = 0.0 if m.orientation is None else orientation_error(robot.with_unknown(tool="pose"), m)
                errors[choices], readings[choices] = (placed_by(robot, m)[1], turn), m
                copied |= {choices} if computed(robot, m, rounded=True) else set()
    order, bound = sorted(errors, key=lambda c: _total(robot, errors[c])), MAX_ORIENTATION_ERROR_RAD
    # Slips are searched for in up to eight interpretations; each takes a second.
    if 0 < len(errors) <= 8 and _total(robot, errors[order[0]]) > bound:
        from casadical.project.check.slips import search_slips

        for choices, m in readings.items():
            slips = search_slips(robot, m)
            if slips and slips.explains:
                errors[choices] = slips.best.error, slips.best.turn
        order = sorted(errors, key=lambda c: _total(robot, errors[c]))
    for k, question in enumerate(questions):
        lengths = [c for c in question.choices if len(question.choices[c]) == 1]
        if question.about == "observation" and lengths and copied:
            why = "the coordinates are computed, as the nominal robot has them"
            found = found.answered(question, lengths[0], why)
            continue
        layout = question.about in ("layout", "order")
        # Coordinates that a controller computed fit best, but were not measured.
        real = [c for c in order if c not in copied]
        if real and (question.about == "observation" or (layout and _total(robot, errors[real[0]]) < bound)):
            order = real
        if not order:
            continue
        best, other = order[0], next((c for c in order if c[k] != order[0][k]), None)
        # Without headings, choices that cannot be read use a column twice: they are refuted.
        unread = len(errors) < len(question.choices) and other is None and not layout
        least, second = (_total(robot, errors[c]) if c else np.inf for c in (best, other))
        allowed = bound if other or layout else 0.02
        if (
            (len(question.choices) == 1 or not unread)
            and least < allowed
            and MIN_ERROR_RATIO_TO_OTHERS * least < second
        ):
            behind = errors[other] if other else None
            turned = errors[best][1] and behind is not None and behind[1]
            unit, which, factor = ("deg", 1, 180 / np.pi) if turned else ("mm", 0, 1e3)
            rest = f", else {factor * behind[which]:.2g}" if behind else ""
            off = factor * errors[best][which]
            why = f"{'comparison' if layout else best[k]}: {off if off > 1e-6 else 0:.2g} {unit}"
            why += f" from the robot{rest}"
            found = found.answered(question, best[k], why)
        elif question.about:
            ranked = dict.fromkeys([*(c[k] for c in order), *question.choices])
            # A layout has too many choices to be asked: the best are.
            some = {c: question.choices[c] for c in [*ranked][: 5 if layout else None]}
            asked = (replace(q, choices=some) if q is question else q for q in found.questions)
            found = replace(found, questions=tuple(asked))
    return found


def _total(robot: Robot, error: tuple[float, float]) -> float:
    """Return the position error divided by the reach, plus the orientation error, dimensionless.

    error : median error of positions [m] and of orientations [rad]
    """
    return error[0] / robot.reach + error[1]


def _measurements_of(raw: RawTable, robot: Robot, sources: Mapping[str, Source]) -> Measurements:
    """Return the measurements of a table's complete rows, read with these column sources."""
    columns = with_coupled(Columns.of_file(raw).mapped(sources), robot)
    return of_tool(from_columns(columns.without(columns.lost_rows, ""), [j.kind for j in robot.joints]), robot)


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

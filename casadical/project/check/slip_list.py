"""Slips in words: what may be wrong with a table, or with one reading that the others contradict.

A table is judged with base and tool free, so that swapped axes, or two reversed ones, are no slip
of it. One reading is judged by base, tool and robot as the other readings determine them: it may
have these slips and others.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, permutations
from typing import Any

import numpy as np

from casadical.core.basics import Array
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import FIELDS, Measurements
from casadical.project.check.slip_fit import Fit, Hypothesis
from casadical.robot.robot import Robot

# Offsets that a joint's zero is tried with [rad]: none, and those by which it often is wrong.
QUARTER_TURNS = tuple(np.deg2rad(v) for v in (0.0, 90.0, -90.0, 180.0))


def single_slips(robot: Robot, others: int) -> Iterator[Fit]:
    """Yield every single slip of a table, as a fit with infinite (unknown) error.

    others : number of other robots that the file may have meant
    """
    none = Hypothesis.none(robot.n)
    yield from (Fit(none, np.inf, (scale,) * 3) for scale in (1e3, 1e-3, 25.4))
    yield Fit(none, np.inf, mirrored=True)
    turning = [j.kind == "revolute" for j in robot.joints]
    yield from (Fit(h, np.inf) for h in set(further_slips(none, turning, (0,), 1 + others)) if h.slips == 1)


def undone(fit: Fit, m: Measurements) -> Measurements:
    """Return the measurements with the slips of a fit undone in readings and positions.

    They must have positions; the rows of the robot, and shifts of rows, are not changed.
    """
    assert m.position is not None
    turns = np.array([*fit.scale]) * [1, -1 if fit.mirrored else 1, 1]
    return replace(m, q=fit.hypothesis.readings(m.q), position=m.position * turns)


def inner(turning: Sequence[bool]) -> list[int]:
    """Return the indices (from 0) of the revolute joints except the first and the last joint.

    The zeros of those two cannot be distinguished from base and tool.

    turning : whether each joint is revolute
    """
    return [i for i in range(1, len(turning) - 1) if turning[i]]


def further_slips(h: Hypothesis, turning: Sequence[bool], shifts: Sequence[int], rows: int) -> Iterator[Hypothesis]:
    """Yield every hypothesis that differs from `h` by one slip of readings, or by the robot's rows.

    turning : whether each joint is revolute
    shifts : shifts of rows that are tried
    rows : number of robots that may be meant
    """
    n = len(turning)
    yield from (h._replace(shift=shift) for shift in shifts if shift != h.shift)
    yield from (h._replace(rows=k) for k in range(rows) if k != h.rows)
    for factor in (1.0, 180 / np.pi, np.pi / 180):
        yield h._replace(factor=tuple(factor if t else 1.0 for t in turning))
    for i in range(n):
        for sign in (1, -1):
            for zero in QUARTER_TURNS if i in inner(turning) else (0.0,):
                if (sign, zero) != (h.sign[i], h.zero[i]):
                    yield h.at("sign", i, sign).at("zero", i, zero)
        if turning[i]:
            for factor in (1.0, 180 / np.pi):
                if factor != h.factor[i]:
                    yield h.at("factor", i, factor)
        if i and turning[i] and turning[i - 1]:
            yield from (h.at("add", i, a) for a in (-1, 0, 1) if a != h.add[i])
        for k in range(i + 1, n):
            if turning[i] == turning[k]:
                yield h.at("source", i, h.source[k]).at("source", k, h.source[i])


def in_words(fit: Fit, robot: Robot, standard: bool = False) -> list[str]:
    """Return a clause on each slip of a fit: what is wrong and how it is corrected.

    standard : whether the rows of the robot file are of the standard DH convention
    """
    return [*_clauses(fit, robot, standard)]


# Why a mirrored frame is doubtful although it explains the positions.
MIRROR_WARNING = (
    "no instrument has a left-handed frame: y was written with another sign, or joints count the "
    "other way, which positions do not distinguish; look which way joint 1 turns before a program "
    "is corrected by it"
)

# The warning where lengths were measured, which a mirrored robot fits as well.
LENGTHS_MIRROR_WARNING = (
    "Lengths fit the mirror image of a robot as well: look which way joint 1 turns before a program is corrected by it"
)


def _clauses(fit: Fit, robot: Robot, standard: bool) -> Iterator[str]:
    """Yield a clause on each slip of readings, of positions (unit, handedness), and of DH rows."""
    h = fit.hypothesis
    for i, k in enumerate(h.source):
        if k > i:
            yield f"columns q{i + 1} and q{k + 1} are swapped"
    factors = {f for f in h.factor if f != 1.0}
    whole = len(factors) == 1 and sum(f != 1.0 for f in h.factor) > 2
    for i, f in enumerate(h.factor):
        names = ("radians", "degrees") if f > 1 else ("degrees", "radians")
        if whole and f != 1.0:
            meant = [k for k, factor in enumerate(h.factor, 1) if factor != 1.0]
            all_of_them = meant == [*robot.revolute]
            which = "the joint readings are" if all_of_them else f"{', '.join(f'q{k}' for k in meant)} are"
            yield f"{which} {names[0]} under names of {names[1]}"
            break
        if f != 1.0:
            yield f"q{i + 1} alone holds {names[0]} under a name of {names[1]}"
    for i, (sign, zero, add) in enumerate(zip(h.sign, h.zero, h.add, strict=True), 1):
        if sign < 0:
            yield f"joint {i} counts the other way (turn the sign of q{i})"
        if zero:
            degrees = float(np.rad2deg(zero))
            yield f"the zero of joint {i} is {abs(degrees):.4g} deg off (add {degrees:.4g} to q{i}_deg)"
        if add < 0:
            yield f"q{i} counts from the horizontal, not from link {i - 1} (subtract q{i - 1})"
        if add > 0:
            yield f"q{i} is counted the other way against link {i - 1} (add q{i - 1})"
    if h.shift:
        after = "after" if h.shift > 0 else "before"
        yield f"the readings stand {abs(h.shift)} row {after} their positions"
    scaled = [(c, s) for c, s in zip("xyz", fit.scale, strict=True) if s != 1.0]
    if other := other_lengths(fit, robot):
        yield f"the lengths in the robot file are in another unit (times {other:.6g})"
    elif len(scaled) == 3 and len({s for _, s in scaled}) == 1:
        s = scaled[0][1]
        units = {1e3: "metres", 25.4: "inches", 10.0: "centimetres"}
        named = f"{units[s]} under names of millimetres" if s in units else "in another unit"
        yield f"the positions are {named} (times {s:.6g})"
    else:
        yield from (f"{c} alone is in another unit (times {s:.6g})" for c, s in scaled)
    if fit.mirrored:
        yield "the measuring frame is left-handed (turn the sign of y)"
    if fit.hypothesis.rows:
        said = ("standard", "modified") if standard else ("modified", "standard")
        yield f"the DH rows are of the {said[1]} convention, not {said[0]} (convention in the robot file)"
    for name, i, departure in fit.hypothesis.lengths:
        value = getattr(robot.joints[i], name)
        length = meant_length(value, departure) / (other_lengths(fit, robot) or 1.0)
        row = i if (standard != bool(fit.hypothesis.rows)) and name == "a" else i + 1  # the file's row
        yield f"{name} of row {row} is {1e3 * length:.1f} mm, not {1e3 * value:.4g} mm"


def other_lengths(fit: Fit, robot: Robot) -> float:
    """Return the factor that corrects the robot's lengths, if they are in another unit; else 0.

    That is assumed where it gives the robot a usual size, and all positions have the inverse
    factor.
    """
    s = fit.scale[0]
    if set(fit.scale) != {s} or s == 1.0 or 0.1 < robot.reach < 20:
        return 0.0
    return 1 / s if 0.1 < robot.reach / s < 20 else 0.0


def error_in_mm(fit: Fit, robot: Robot) -> str:
    """Return the error of a fit as text [mm], corrected where the robot is in another unit."""
    return f"{1e3 * fit.error * (other_lengths(fit, robot) or 1.0):.3g} mm"


def meant_length(value: float, departure: float) -> float:
    """Return the length that is meant [m] where a robot file's differs from the data.

    It is the value times 1000 or 1/1000 where the departure agrees with that within 5 %, else the
    value plus the departure.

    value : of the robot file [m]; departure : correction by the data [m]
    """
    for unit in (1e3, 1e-3):
        if value and abs((value + departure) / (unit * value) - 1) < 0.05:
            return unit * value
    return value + departure


# Function of measured poses that returns residuals of their lengths from predictions, shape
# (n, lengths) [m], and their squared Mahalanobis distances ("surprise"), shape (n,).
Misses = Callable[[Measurements], tuple[Array, Array]]


def slips_of_reading(robot: Robot, m: Measurements, k: int, misses: Misses, limit: float, labels: Sequence[str]) -> str:
    """Return a sentence on up to three slips, each of which undone makes pose k of m plausible.

    Where there are none, the sentence states other causes.

    robot : robot as the other poses determine it
    misses : function of poses that compares them with predictions by the others, see `Misses`
    limit : largest squared Mahalanobis distance of a plausible pose
    labels : labels of points that the other poses refer to
    """
    listed: list[tuple[str, dict[str, Any]]] = [*_of_observed(m, k), *_of_names(m, k, labels), *_of_joints(robot, m, k)]
    found = misses(_with_changes(m, k, [changed for _, changed in listed]))[1]
    if "orientation" in m.arrays:
        words = "its position is plausible, its orientation is not: the target turned, or its angles are others"
        listed.append((words, {}))
        found = np.append(found, misses(replace(m[[k]], kind="position", orientation=None))[1])
    good = [listed[i][0] for i in np.argsort(found.round(9), kind="stable") if found[i] <= limit]
    if unmoved := [words for words in good if words.startswith("neither robot")]:
        return str(unmoved[0])
    if good:
        return "; or ".join(good[:3])
    if find_kind(m.kind).lengths == 3 and (elsewhere := _joints_not_at_reading(robot, m, k, misses, limit)):
        return "; or ".join(elsewhere[:3])
    more = "no single slip explains it: is the target seated, the beam free, the robot at rest?"
    if m.kind == "position" and (away := float(np.linalg.norm(misses(m[[k]])[0]))) < 0.6:
        more = f"another target, {1e3 * away:.4g} mm from the usual one? Or it is not seated, or the beam is not free"
    return f"{more}; measure it again"


def _with_changes(m: Measurements, k: int, changes: Sequence[Mapping[str, Any]]) -> Measurements:
    """Return pose k of m once for each change, as measurements with as many poses."""
    some = replace(m[np.full(len(changes), k)], separations=())
    given = {"q": some.q, **some.arrays, **some.conditions}
    made = {}
    for name in {name for change in changes for name in change}:
        values = made[name] = given[name].copy()
        for i, change in enumerate(changes):
            values[i] = change.get(name, values[i])
    fields: dict[str, Any] = {name: made[name] for name in made if name in ("q", *FIELDS)}
    extra = {name: made.get(name, values) for name, values in some.extra.items()}
    conditions = {name: made.get(name, values) for name, values in some.conditions.items()}
    return replace(some, extra=extra, conditions=conditions, **fields)


def _of_observed(m: Measurements, k: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield possible slips of what was observed at pose k, each in words and as its undoing.

    The latter is name of an array -> corrected value. They are swapped axes, signs and units; of
    full poses also the inverse.
    """
    vectors_and_lengths: tuple[str, ...] = ("position", "shift", "distance", "reading")
    name = next((n for n in vectors_and_lengths if n in m.arrays), None)
    if name is None:
        return
    y = m.arrays[name][k]
    units = {1e3: "m", 1e-3: "mm", 25.4: "inches", 1 / 25.4: "mm under a name of inches", 10.0: "cm"}
    yield from ((f"its {name} is in {unit}", {name: y * factor}) for factor, unit in units.items())
    if name == "reading":
        yield "the sign of its reading is wrong", {name: -y}
    if np.shape(y) != (3,):
        return
    for order in permutations(range(3)):
        if order != (0, 1, 2):
            said = ", ".join(f"{'xyz'[i]} holds {'xyz'[order.index(i)]}" for i in range(3) if order[i] != i)
            yield f"its axes are swapped: {said}", {name: y[list(order)]}
    for axes in (each for size in (1, 2, 3) for each in combinations(range(3), size)):
        turned = y * np.where(np.isin(range(3), axes), -1, 1)
        yield f"the sign of {' and '.join('xyz'[i] for i in axes)} is wrong", {name: turned}
    if (turn := next((n for n in ("orientation", "turn") if n in m.arrays), None)) is not None:
        R = m.arrays[turn][k]
        other = "the fixed frame as the tool sees it" if name == "position" else "the other pose as this one sees it"
        yield f"it is the inverse pose: of {other}", {name: -R.T @ y, turn: R.T}
        yield f"its orientation is the inverse: of {other}", {turn: R.T}


def _of_names(m: Measurements, k: int, others: Sequence[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield possible slips of names at pose k of m, each in words and as its undoing.

    They are another target, session, touched point or anchor; the undoing is name -> corrected
    value.
    """
    for kind, word in (("tool_", "target"), ("session_", "session")):
        names = [name for name in m.conditions if name.startswith(kind)]
        for other in (name for name in names if not m.conditions[name][k]):
            flags = {name: float(name == other) for name in names}
            yield f"it is of the {word} {other.removeprefix(kind)}", flags
    if m.target is not None:
        ends = np.unique(m.target, axis=0)
        for end in ends[np.linalg.norm(ends - m.target[k], axis=1) > 4e-3]:
            yield f"its distance is to {', '.join(f'{1e3 * c:.0f}' for c in end)} mm", {"target": end}
    elif labels := list(find_kind(m.kind).point_names(m.arrays)):
        yield from ((f"it is of {name}, not of {labels[k]}", {"label": name}) for name in others if name != labels[k])


def _of_joints(robot: Robot, m: Measurements, k: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield possible slips of the joints at pose k of m, each in words and as its undoing.

    A robot that did not move is among them; the undoing is name -> corrected value.
    """
    for fit in single_slips(robot, 0):
        if fit.hypothesis.slips:
            yield "; ".join(in_words(fit, robot)), {"q": fit.hypothesis.readings(m.q[[k]])[0]}
    measured = [values for name, values in m.arrays.items() if name not in ("label", "target")]
    if k and np.abs(m.q[k] - m.q[k - 1]).max() > 4e-3 and any((each[k] != each[k - 1]).any() for each in measured):
        yield "neither robot nor target moved: the position is that of the reading before", {"q": m.q[k - 1]}


def _joints_not_at_reading(robot: Robot, m: Measurements, k: int, misses: Misses, limit: float) -> list[str]:
    """Return a sentence on each joint whose true position may have differed from q at pose k of m.

    With this one joint moved, the pose is plausible; the most plausible comes first. Gauss-
    Newton steps begin at the best of 121 positions in the joint's range, cut to +-2 pi [rad or m].
    """
    n, read = robot.n, m.q[k]
    lower, upper = np.maximum(robot.limits[0], -2 * np.pi), np.minimum(robot.limits[1], 2 * np.pi)

    def missed(stood: Array) -> tuple[Array, Array]:
        """Return residuals (n, places, observed lengths) [m] and surprise (n, places).

        stood : trial positions, shape (n, places) [rad or m]: row j is of joint j alone
        """
        q = np.tile(read, (*stood.shape, 1))
        q[np.arange(n), :, np.arange(n)] = stood
        off, square = misses(_with_changes(m, k, [{"q": each} for each in q.reshape(-1, n)]))
        return off.reshape(*stood.shape, -1), square.reshape(stood.shape)

    places = np.linspace(lower, upper, 121).T
    away = np.nan_to_num(np.linalg.norm(missed(places)[0], axis=2), nan=np.inf)
    at = places[np.arange(n), away.round(9).argmin(axis=1)]
    for _ in range(6):
        off = missed(np.stack([at, at + 1e-6], axis=1))[0]
        slope = (off[:, 1] - off[:, 0]) / 1e-6
        step = -(slope * off[:, 0]).sum(axis=1) / np.maximum((slope**2).sum(axis=1), 1e-12)
        at = at + np.nan_to_num(np.clip(step, -0.1, 0.1))
    square = missed(at[:, None])[1][:, 0]
    within = (at > lower - 0.02) & (at < upper + 0.02) & (np.abs(at - read) > 1e-3)
    words = []
    for i in (i for i in np.argsort(square.round(9), kind="stable") if square[i] <= limit and within[i]):
        unit, factor = ("deg", 180 / np.pi) if robot.joints[i].kind == "revolute" else ("mm", 1e3)
        where = f"joint {i + 1} stood at {at[i] * factor:.2f}, not {read[i] * factor:.2f} {unit}"
        words.append(f"{where}: it did not arrive, or its number is wrong")
    return words

"""Which slip a single reading looks like that the others contradict: what, undone, makes it plausible.

Slips of the whole table are those of `project.check`; here the others of the table say where the robot is.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np

from casadical.core.basics import Array
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import FIELDS, Measurements
from casadical.pose_selection.information import by_joints
from casadical.project.live.estimate import Estimate, labels_of

# Factors of another unit, and its name.
UNITS = ((1e3, "m"), (1e-3, "mm"), (25.4, "inches"), (1 / 25.4, "mm under a name of inches"), (10.0, "cm"))
# Places of a joint that are tried, and steps to the best one.
PLACES, STEPS = 121, 6
# A joint is where it was, or at its reading's negative, within so much [rad or m].
SAME = 4e-3
# Farther off the flange than this no target is [m].
FARTHEST = 0.6
# A target stands apart from the usual one by more than this many sigmas of its place.
LIKE = 0.25
MOST = 3


@dataclass(frozen=True, eq=False)
class Slip:
    """What would make a reading plausible. words : in a sentence; kind : one word; shift : of the target [m]."""

    kind: str
    words: str
    surprise: float
    shift: Array | None = None


def slips_of(found: Estimate, m: Measurements, k: int, before: Array | None = None) -> list[Slip]:
    """What the k-th reading looks like, the most probable first; before : shift of an earlier target, (3,) [m]."""
    one = m[[k]]
    all_exact = (*_of_names(found, m, k), *_of_observed(found, m, k), *_of_readings(found, m, k))
    exact = [s for s in all_exact if s.surprise <= found.limit]
    exact = sorted(exact, key=lambda s: s.surprise)[:MOST]
    if any(s.kind == "unmoved" for s in exact):
        return [s for s in exact if s.kind == "unmoved"]
    if (place := _place(found, one)) is None:  # any joint explains a single number
        return exact
    joints = [] if exact else [s for s in _of_joints(found, one, m, k, place) if s.surprise <= found.limit]
    target = [] if one.other is not None else _of_target(found, one, before, place)
    if before is not None and target and "again" in target[0].words:
        return [*target, *exact]
    return [*exact, *sorted(joints, key=lambda s: s.surprise)[:MOST]] or target


def _place(found: Estimate, one: Measurements) -> Array | None:
    """Where a reading says that the point is, shape (3,) [m]; None of one that does not say it."""
    if one.position is not None:
        return np.asarray(one.position[0])
    if one.kind == "contact":
        return found.points.get(labels_of(one)[0])
    if one.other is not None and "shift" in one.extra:
        p, R = predicted(found.robot, replace(one, q=one.other))
        return np.asarray(p[0] + R[0] @ one.extra["shift"][0])
    return None


def _several(m: Measurements, k: int, n: int, **changed: Array) -> Measurements:
    """The k-th reading n times, with some arrays changed."""
    some = m[np.full(n, k)]
    fields = {name: values for name, values in changed.items() if name in ("q", *FIELDS)}
    others = {name: values for name, values in changed.items() if name not in fields}
    return replace(some, separations=(), extra={**some.extra, **others}, **fields)  # type: ignore[arg-type]


def _of_names(found: Estimate, m: Measurements, k: int) -> Iterator[Slip]:
    """Another target of the robot file, or session, than the column says."""
    for kind in ("tool_", "session_"):
        names = [name for name in m.conditions if name.startswith(kind)]
        for other in (name for name in names if not m.conditions[name][k]):
            flags = {name: np.array([float(name == other)]) for name in names}
            logged = {**m[[k]].conditions, **flags}
            words = f"it is of the {'target' if kind == 'tool_' else 'session'} {other.removeprefix(kind)}"
            one = replace(m[[k]], conditions=logged, separations=())
            yield Slip("target", words, float(found.misses(one)[1][0]))


def _of_observed(found: Estimate, m: Measurements, k: int) -> Iterator[Slip]:
    """What the instrument said: axes, signs, another unit, an orientation of another convention, another place."""
    if (vector := next((name for name in ("position", "shift") if name in m.arrays), None)) is not None:
        yield from _of_vector(found, m, k, vector)
        return
    made: list[tuple[str, str, dict[str, Array | str]]] = []
    for name, word in (("distance", "distance"), ("reading", "reading")):
        if name in m.arrays:
            value = m.arrays[name][k]
            made += [("unit", f"its {word} is in {unit}", {name: value * factor}) for factor, unit in UNITS]
            made += [("sign", "the sign of its reading is wrong", {name: -value})] if name == "reading" else []
    if m.target is not None:
        others = np.unique(m.target, axis=0)
        for place in others[np.linalg.norm(others - m.target[k], axis=1) > SAME]:
            words = ", ".join(f"{1e3 * c:.0f}" for c in place)
            made.append(("target", f"its distance is to {words} mm", {"target": place}))
    if labels := labels_of(m):
        made += [("target", f"it is of {b}, not of {labels[k]}", {"label": b}) for b in found.points if b != labels[k]]
    for kind, words, changed in made:
        some = _several(m, k, 1, **{name: np.array([value]) for name, value in changed.items()})
        yield Slip(kind, words, float(found.misses(some)[1][0]))


def _of_vector(found: Estimate, m: Measurements, k: int, name: str) -> Iterator[Slip]:
    """Coordinates swapped, with another sign, or in another unit; of a full pose also its orientation."""
    made, y = [], m.arrays[name][k]
    for order in permutations(range(3)):
        if order != (0, 1, 2):
            said = ", ".join(f"{'xyz'[i]} holds {'xyz'[order.index(i)]}" for i in range(3) if order[i] != i)
            made.append(("axes", f"its axes are swapped: {said}", y[list(order)]))
    for axes in ((0,), (1,), (2,), (0, 1), (0, 2), (1, 2), (0, 1, 2)):
        turned = y * np.where(np.isin(range(3), axes), -1, 1)
        made.append(("sign", f"the sign of {' and '.join('xyz'[i] for i in axes)} is wrong", turned))
    made += [("unit", f"its {name} is in {unit}", y * factor) for factor, unit in UNITS]
    some = _several(m, k, len(made), **{name: np.array([vector for *_, vector in made])})
    for (kind, words, _), value in zip(made, found.misses(some)[1], strict=True):
        yield Slip(kind, words, float(value))
    if (turn := next((n for n in ("orientation", "turn") if n in m.arrays), None)) is None:
        return
    R = m.arrays[turn][k]
    inverse = _several(m, k, 2, **{name: np.array([-R.T @ y, y]), turn: np.array([R.T, R.T])})
    whole, alone = (float(v) for v in found.misses(inverse)[1])
    other = "of the fixed frame as the tool sees it" if name == "position" else "of the other pose as this one sees it"
    yield Slip("inverse", f"it is the inverse pose: {other}", whole)
    yield Slip("inverse", f"its orientation is the inverse: {other}", alone)
    if name == "position" and min(whole, alone) > found.limit:
        without = replace(m[[k]], kind="position", orientation=None)
        words = "its position is plausible, its orientation is not: the target turned, or its angles are others"
        yield Slip("orientation", words, float(found.misses(without)[1][0]))


def _of_readings(found: Estimate, m: Measurements, k: int) -> Iterator[Slip]:
    """The robot that did not move, readings in radians, two joints swapped."""
    q, made = m.q[k], []
    measured = [values for name, values in m.arrays.items() if name not in ("label", "target")]
    if k and np.abs(m.q[k] - m.q[k - 1]).max() > SAME and any((each[k] != each[k - 1]).any() for each in measured):
        same = "neither robot nor target moved: the position is that of the reading before"
        made.append(("unmoved", same, m.q[k - 1]))
    revolute = np.array([j.kind == "revolute" for j in found.robot.joints])
    made.append(("unit", "its joints are radians, read as degrees", np.where(revolute, np.rad2deg(q), q)))
    made.append(("unit", "its joints are degrees, read as radians", np.where(revolute, np.deg2rad(q), q)))
    for i, j in combinations(range(len(q)), 2):
        swapped = q.copy()
        swapped[[i, j]] = q[[j, i]]
        made.append(("joints", f"joints {i + 1} and {j + 1} are swapped", swapped))
    values = found.misses(_several(m, k, len(made), q=np.array([each for *_, each in made])))[1]
    yield from (Slip(kind, words, float(v)) for (kind, words, _), v in zip(made, values, strict=True))


def _of_joints(found: Estimate, one: Measurements, m: Measurements, k: int, y: Array) -> Iterator[Slip]:
    """One joint that stood elsewhere than its reading says: where it fits best, over its range."""
    lower, upper = found.robot.limits
    n = found.robot.n
    q = np.repeat(np.repeat(one.q, PLACES, axis=0)[None], n, axis=0)
    for i in range(n):
        q[i, :, i] = np.linspace(max(lower[i], -2 * np.pi), min(upper[i], 2 * np.pi), PLACES)
    p, _ = predicted(found.robot, _at(one, q.reshape(-1, n)))
    away = np.linalg.norm(p - y, axis=1).reshape(n, PLACES)  # not a number where a four-bar cannot close
    best = np.nan_to_num(away, nan=np.inf).round(9).argmin(axis=1)  # of places a turn apart the first
    at = q[np.arange(n), best]
    for _ in range(STEPS):
        some = _at(one, at)
        d = y - predicted(found.robot, some)[0]
        J = by_joints(found.robot, some)[np.arange(n), :, np.arange(n)]
        square = np.maximum((J**2).sum(axis=1), 1e-12)
        step = np.clip((J * d).sum(axis=1) / square, -0.1, 0.1)
        at[np.arange(n), np.arange(n)] += np.nan_to_num(step)
    values = found.misses(_at(one, at))[1]
    for i in range(n):
        turning, read = found.robot.joints[i].kind == "revolute", one.q[0, i]
        turns = (-2 * np.pi, 0.0, 2 * np.pi) if turning else (0.0,)
        places = [at[i, i] + turn for turn in turns if lower[i] - 0.02 <= at[i, i] + turn <= upper[i] + 0.02]
        stood = min(places, key=lambda place, read=read: abs(place - read), default=read)  # type: ignore[misc]
        if abs(stood - read) > SAME / 4:
            kind, words = _joint_words(turning, i, stood, read, m.q[k - 1, i] if k else None)
            yield Slip(kind, words, float(values[i]))


def _joint_words(turning: bool, i: int, stood: float, read: float, before: float | None) -> tuple[str, str]:
    unit, factor = ("deg", 180 / np.pi) if turning else ("mm", 1e3)
    off = np.arctan2(np.sin(stood + read), np.cos(stood + read)) if turning else stood + read
    if negative := abs(off) < SAME:
        stood = -read
    where = f"joint {i + 1} stood at {stood * factor:.2f}, not {read * factor:.2f} {unit}"
    if negative:
        return "joint sign", f"{where}: its sign is wrong"
    if before is not None and abs(stood - before) < SAME:
        return "joint", f"{where}: it did not arrive, it is where the reading before left it"
    if before is not None and read != before and 0 < (share := (stood - before) / (read - before)) < 1:
        return "joint", f"{where}: it did not arrive ({100 * share:.0f} % of its way)"
    return "joint", f"{where}: it did not arrive, or its number is wrong"


def _of_target(found: Estimate, one: Measurements, before: Array | None, y: Array) -> list[Slip]:
    """Another point on the flange: its shift from the usual one, in the flange's frame."""
    p, R = predicted(found.robot, one)
    turn = R[0] @ found.robot.tool.T[:3, :3].T
    shift = turn.T @ (y - p[0])
    length = float(np.linalg.norm(shift))
    if length > FARTHEST:
        return []
    alike = before is not None and np.linalg.norm(shift - before) < max(LIKE * length, 4 * found.sigma)
    words = f"another target, {1e3 * length:.4g} mm from the usual one"
    words += ", as the doubtful reading before it again" if alike else " (or the target is not seated, or moved)"
    return [Slip("target", words, 0.0, shift)]


def _at(one: Measurements, q: Array) -> Measurements:
    """The conditions of one reading at other readings q, shape (n, joints)."""
    some = one[np.zeros(len(q), dtype=int)]
    return replace(some, q=q)

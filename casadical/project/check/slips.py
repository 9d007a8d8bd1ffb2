"""Slips of a table, several at once: a beam search over what may be wrong, on the fast fit of `slip_fit`.

A further slip must halve the error at least, so that of two explanations the simpler one comes first. What calibration
finds itself (zeros and lengths that are off by little) is no slip.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.arrays import Array
from casadical.measurements.measurements import Measurements
from casadical.project.check.slip_fit import Fit, Hypothesis, SlipFit
from casadical.robot.robot import Robot

POSES = 60
MOST_SLIPS = 4
# States that are kept of all, and of each combination of shift and convention; of which so many are placed.
BEAM, OF_EACH, PLACED = 400, 80, 12
QUARTERS = tuple(np.deg2rad(v) for v in (0.0, 90.0, -90.0, 180.0))
FREE = tuple(np.deg2rad(v) for v in range(-150, 180, 30) if v % 90)
# Of the reach: errors below it are the nominal model's own; departures of a length below it are calibration's.
OWN, LENGTH = 0.001, 0.02
# Zeros that are off by less are calibration's [rad].
ZERO = np.deg2rad(4.0)
# Share of the error that an explanation may leave.
EXPLAINS = 0.25
# Readings outside of the joints' ranges cost as much as half a slip; a few are bad rows.
OUTSIDE, FEW = 0.35, 0.05
# In which several wrong lengths are found together.
ROUNDS = 8
# What a further slip must at least reduce the error by.
WORTH = 2.0


@dataclass(frozen=True, eq=False)
class Slips:
    """The best explanation and its rivals, with the errors [m] before and after."""

    before: Fit
    best: Fit
    rivals: tuple[Fit, ...]

    @property
    def explains(self) -> bool:
        """Whether the best explanation leaves far less than the table as it stands."""
        return self.best.slips > 0 and self.best.error < EXPLAINS * self.before.error


def search_slips(robot: Robot, m: Measurements, others: Sequence[Robot] = ()) -> Slips | None:
    """What is wrong with a table, if anything is; others : the robot with its rows read otherwise.

    None for robots with loops and for data without positions.
    """
    if m.position is None or robot.loops or m.q.shape[1] != robot.n or len(m) < 15:
        return None
    # Whole stretches of rows, so that shifted ones still belong together.
    some = slice(0, POSES) if len(m) > POSES else slice(None)
    order = np.argsort(m.row)[some]
    rows = [robot.joints, *(o.joints for o in others if not o.loops)]
    fit = SlipFit(m.q[order], m.position[order], rows, robot.reach)
    # Shifts need rows that follow each other in the file.
    shifts = (0, 1, -1) if np.all(np.diff(m.row[order]) >= 1) else (0,)
    found = _search(fit, robot, shifts)
    before = fit.placed(Hypothesis.none(robot.n))
    ranked = sorted(found, key=lambda f: _cost(f, robot) + OUTSIDE * _outside(f.hypothesis, robot, fit.q))
    best = ranked[0]
    rivals = [f for f in ranked[1:] if f.error < 0.5 * before.error and f.slips <= MOST_SLIPS + 1]
    return Slips(before, best, tuple(rivals[:2]))


def _cost(f: Fit, robot: Robot) -> float:
    return float(np.log(max(f.error, OWN * robot.reach)) + np.log(WORTH) * f.slips)


def _outside(h: Hypothesis, robot: Robot, q: Array) -> bool:
    """Whether the readings would leave the joints' ranges."""
    lower, upper = np.array([(j.lower, j.upper) for j in robot.joints]).T
    meant = h.readings(q)
    return bool(((meant < lower - 0.01) | (meant > upper + 0.01)).any(axis=1).mean() > FEW)


def _search(fit: SlipFit, robot: Robot, shifts: Sequence[int]) -> list[Fit]:
    """The states that were best on each level, with base and tool placed."""
    none = Hypothesis.none(robot.n)
    turning = [j.kind == "revolute" for j in robot.joints]
    level = [none]
    seen, found = set(level), {none: fit.placed(none)}
    share, lengths = fit.scores(level)
    for depth in range(MOST_SLIPS + 1):
        kept = _kept(level, share)
        for k in kept[:PLACED]:
            h = _refined(fit, level[k])
            found.setdefault(h, fit.placed(h))
        least = min(f.error for f in found.values())
        if depth == MOST_SLIPS or least < 2 * OWN * robot.reach:
            break
        following = []
        for k in kept:
            for h in (
                *_moves(level[k], turning, shifts, len(fit.rows)),
                *_length_moves(level[k], lengths[k], robot),
            ):
                if h not in seen and h.slips <= MOST_SLIPS:
                    seen.add(h)
                    following.append(h)
        if not following:
            break
        level = following
        share, lengths = fit.scores(level)
    return list(found.values())


def _kept(level: Sequence[Hypothesis], share: Array) -> list[int]:
    order = [int(k) for k in np.argsort(share)]
    kept, of_each = order[:BEAM], dict[tuple[int, int], int]()
    for k in order:
        key = (level[k].shift, level[k].rows)
        of_each[key] = of_each.get(key, 0) + 1
        if of_each[key] <= OF_EACH and k not in kept:
            kept.append(k)
    return kept


def _moves(h: Hypothesis, turning: Sequence[bool], shifts: Sequence[int], rows: int) -> Iterator[Hypothesis]:
    n = len(turning)
    yield from (replace(h, shift=shift) for shift in shifts if shift != h.shift)
    yield from (replace(h, rows=k) for k in range(rows) if k != h.rows)
    for factor in (1.0, 180 / np.pi, np.pi / 180):
        yield replace(h, factor=tuple(factor if t else 1.0 for t in turning))
    for i in range(n):
        inner = turning[i] and 0 < i < n - 1  # zeros of the first and last joint are those of base and tool
        for sign in (1, -1):
            for zero in (*QUARTERS, *FREE) if inner else (0.0,):
                if (sign, zero) != (h.sign[i], h.zero[i]) and (sign == h.sign[i] or zero not in FREE):
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


def _length_moves(h: Hypothesis, lengths: Array, robot: Robot) -> Iterator[Hypothesis]:
    """The lengths whose departure explains most."""
    n = robot.n
    order = np.argsort(lengths[:, 0])[:3]
    for k in order:
        rest, departure = lengths[k]
        name, i = ("a", int(k)) if k < n else ("d", int(k) - n)
        known = any((name, i) == (other, j) for other, j, _ in h.lengths)
        if rest < 0.9 and abs(departure) > LENGTH * robot.reach and not known:
            yield replace(h, lengths=(*h.lengths, (name, i, float(departure))))


def _refined(fit: SlipFit, h: Hypothesis) -> Hypothesis:
    """Free zeros and lengths as they fit best together."""
    free = [i for i, z in enumerate(h.zero) if z and not any(np.isclose(z, q) for q in QUARTERS)]
    if not free and not h.lengths:
        return h
    step = np.deg2rad(15.0)
    while free and step > np.deg2rad(0.05):
        tried = [h, *(h.at("zero", i, h.zero[i] + s * step) for i in free for s in (-1, 1))]
        best = tried[int(np.argmin(fit.scores(tried)[0]))]
        h, step = (best, step) if best is not h else (h, step / 2)
    n = len(h.zero)
    for _ in range(ROUNDS * (len(h.lengths) > 0)):
        for k, (name, i, departure) in enumerate(h.lengths):  # one after the other: they depend on each other
            size = float(fit.scores([h])[1][0, i + (name == "d") * n, 1])
            h = replace(h, lengths=(*h.lengths[:k], (name, i, departure + size), *h.lengths[k + 1 :]))
    for i in free:
        if abs(h.zero[i]) < ZERO:
            h = h.at("zero", i, 0.0)
    return h

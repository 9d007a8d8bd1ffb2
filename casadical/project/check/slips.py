"""Slips of a table, several at once: a beam search over what may be wrong, on the fast fit of `slip_fit`.

A further slip must halve the error at least, so that of two explanations the simpler one comes first. What calibration
finds itself (zeros and lengths that are off by little) is no slip.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from casadical.core.basics import Array, Show, silent
from casadical.core.statistics import ranked
from casadical.measurements.measurements import Measurements
from casadical.project.check.slip_fit import Fit, Hypothesis, LengthFit, SlipFit
from casadical.project.check.slip_list import QUARTERS, inner, moves
from casadical.robot.robot import Robot

MOST_SLIPS = 4
# Of the reach: errors below it are the nominal model's own; departures of a length below it are calibration's.
OWN = 0.001
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
        return self.best.slips > 0 and self.best.error < 0.25 * self.before.error


def search_slips(robot: Robot, m: Measurements, others: Sequence[Robot] = (), show: Show = silent) -> Slips | None:
    """What is wrong with a table; None where it is not known (see `slip_fit`). others : with rows read otherwise"""
    order = np.argsort(m.row)
    # Whole stretches of rows, so that shifted ones still belong together.
    fit = slip_fit(robot, m[order[:60]], others)
    if fit is None:
        return None
    # Shifts need rows that follow each other in the file.
    shifts = (0, 1, -1) if np.all(np.diff(m.row[order]) >= 1) and m.position is not None else (0,)
    fits = _search(fit, robot, shifts, show)
    before = fit.placed(Hypothesis.none(robot.n), as_given=True)
    errors = np.log([max(f.error, OWN * robot.reach) for f in fits])
    # Orientations that differ by more than 0.1 rad speak against an explanation, as much as a slip.
    slips = [f.cost + (f.turn > 0.1) for f in fits]
    # Readings outside of the joints' ranges cost as much as half a slip.
    costs = errors + np.log(WORTH) * np.array(slips) + [0.35 * outside(f.hypothesis, robot, fit.q) for f in fits]
    first, *behind = ranked(-costs)
    best = fits[first]
    near = [fits[k] for k in behind if fits[k].slips and costs[k] < costs[first] + np.log(WORTH)]
    # What leaves the same is the same robot, or its mirror image: no pose would distinguish them.
    rivals = [f for f in near if abs(f.error - best.error) > 1e-6 * best.error]
    return Slips(before, best, tuple(rivals[:2]))


def slip_fit(robot: Robot, m: Measurements, others: Sequence[Robot] = ()) -> SlipFit | None:
    """The fast fit to positions, or to lengths to a few places; None of other kinds, of loops, and of too few rows."""
    rows = [robot.joints, *(o.joints for o in others if not o.loops)]
    if robot.loops or m.q.shape[1] != robot.n or len(m) < 15:
        return None
    if m.position is not None:
        return SlipFit(m.q, m.position, rows, robot.reach, m.orientation)
    if m.kind != "distance" or m.distance is None:
        return None
    ends = m.label if m.target is None else m.target
    which = np.zeros(len(m)) if ends is None else np.unique(ends, axis=0, return_inverse=True)[1].ravel()
    few = np.bincount(which.astype(int)).min() < 6
    return None if few else LengthFit(m.q, np.column_stack([m.distance, which]), rows, robot.reach)


def outside(h: Hypothesis, robot: Robot, q: Array) -> bool:
    lower, upper = robot.limits
    meant = h.readings(q)
    # A few rows outside of the ranges are bad rows.
    return bool(((meant < lower - 0.01) | (meant > upper + 0.01)).any(axis=1).mean() > 0.05)


def _search(fit: SlipFit, robot: Robot, shifts: Sequence[int], show: Show) -> list[Fit]:
    """The states that were best on each level, with base and tool placed."""
    none = Hypothesis.none(robot.n)
    turning = [j.kind == "revolute" for j in robot.joints]
    # A reading may be in radians whose column moves as little as that.
    move = np.ptp(fit.q, axis=0)
    turn = np.deg2rad(2 * np.pi)
    little = (move > np.deg2rad(0.3)) & (move < turn) & (np.median(move) > turn) & turning
    level = [none, *(none.at("factor", int(i), 180 / np.pi) for i in np.flatnonzero(little))]
    seen, fits = set(level), {none: fit.placed(none)}
    share = fit.shares(level)
    for depth in range(MOST_SLIPS + 1):
        show(f"slips, search {depth + 1} of {MOST_SLIPS + 1}")
        kept = _kept(level, share, fit.beam)
        for k in kept[:20]:
            h = _refined(fit, level[k])
            fits.setdefault(h, fit.placed(h))
        least = min(f.error for f in fits.values())
        if depth == MOST_SLIPS or least < 2 * OWN * robot.reach:
            break
        parents = [level[k] for k in kept]
        first = [] if depth else _turned(parents, len(fit.rows))
        moves = dict.fromkeys((*first, *_all_moves(fit, parents, robot, turning, shifts)))
        level = [h for h in moves if h not in seen and h.cost <= MOST_SLIPS]
        seen.update(level)
        if not level:
            break
        share = fit.shares(level)
    return list(fits.values())


def _turned(starts: Sequence[Hypothesis], rows: int) -> Iterator[Hypothesis]:
    """Every choice of joints that count the other way; and with the third one's reading coupled to the second."""
    for h in starts:
        for sign, k in product(product((1, -1), repeat=len(h.sign)), range(rows)):
            turned = h._replace(sign=sign, rows=k)
            yield from (turned.at("add", 2, add) for add in (0, 1, -1)) if len(sign) > 2 else (turned,)


def _all_moves(
    fit: SlipFit, parents: Sequence[Hypothesis], robot: Robot, turning: Sequence[bool], shifts: Sequence[int]
) -> Iterator[Hypothesis]:
    lengths = fit.departures(parents)
    for h, of_each in zip(parents, lengths, strict=True):
        yield from moves(h, turning, shifts, len(fit.rows))
        yield from _length_moves(h, of_each, robot)
    for i in inner(turning):
        for sign in (1, -1):
            turned = [h.at("sign", i, sign * h.sign[i]) for h in parents]
            for h, more in zip(turned, fit.zeros(turned, i), strict=True):
                yield h.at("zero", i, _zero(h.zero[i] + more))


def _zero(angle: float) -> float:
    """An angle from -180 to 180 deg, or the multiple of 90 deg that it is close to."""
    away = [abs(np.arctan2(np.sin(angle - v), np.cos(angle - v))) for v in QUARTERS]
    nearest = int(np.argmin(away))
    # Zeros that are off by less are calibration's.
    if away[nearest] < np.deg2rad(4.0):
        return float(QUARTERS[nearest])
    return round(float(np.arctan2(np.sin(angle), np.cos(angle))), 4)


def _kept(level: Sequence[Hypothesis], share: Array, beam: int) -> list[int]:
    order = ranked(np.negative(share))
    kept, of_each = order[:beam], dict[tuple[int, int], int]()
    for k in order:
        key = (level[k].shift, level[k].rows)
        of_each[key] = of_each.get(key, 0) + 1
        if of_each[key] <= min(120, beam) and k not in kept:
            kept.append(k)
    return kept


def _length_moves(h: Hypothesis, lengths: Array, robot: Robot) -> Iterator[Hypothesis]:
    """The lengths whose departure explains most."""
    n = robot.n
    order = ranked(-lengths[:, 0])[:3]
    for k in order:
        rest, departure = lengths[k]
        name, i = ("a", k) if k < n else ("d", k - n)
        known = any((name, i) == (other, j) for other, j, _ in h.lengths)
        # A length that departs by less of the reach is calibration's.
        if rest < 0.9 and abs(departure) > 0.02 * robot.reach and not known:
            yield h._replace(lengths=(*h.lengths, (name, i, float(departure))))


def _refined(fit: SlipFit, h: Hypothesis) -> Hypothesis:
    n = len(h.zero)
    free = [i for i, z in enumerate(h.zero) if z and z not in QUARTERS]
    for _ in range(8 * (len(free) + len(h.lengths) > 0)):  # one after the other: they depend on each other
        before = h
        for i in free:
            h = h.at("zero", i, _zero(h.zero[i] + float(fit.zeros([h], i)[0])))
        for k, (name, i, departure) in enumerate(h.lengths):
            size = float(fit.departures([h])[0, i + (name == "d") * n, 1])
            h = h._replace(lengths=(*h.lengths[:k], (name, i, departure + size), *h.lengths[k + 1 :]))
        if h.zero == before.zero and not h.lengths:
            break
    return h

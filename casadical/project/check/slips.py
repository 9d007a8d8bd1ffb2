"""Slips of a table, several at once: a beam search over hypotheses, on the fast fit of `slip_fit`.

One more slip must at least halve the error, so that of two explanations the simpler one comes
first. Small errors of zeros and lengths, which the calibration finds itself, are no slips.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from casadical.core.basics import Array, Show, silent
from casadical.core.statistics import ranked
from casadical.measurements.measurements import Measurements
from casadical.project.check.slip_fit import Fit, Hypothesis, LengthFit, SlipFit
from casadical.project.check.slip_list import QUARTER_TURNS, further_slips, inner
from casadical.robot.robot import Robot

# Median error, as a share of the reach, below which explanations are not distinguished by their
# errors; the search ends at twice this error.
NOMINAL_ERROR_OF_REACH = 0.001
# Minimum factor by which an additional slip must reduce the error to be accepted. Explanations of a
# table whose errors, so penalised, differ by less than this factor are rivals.
MIN_ERROR_REDUCTION = 2.0


@dataclass(frozen=True, eq=False)
class Slips:
    """The best explanation of a table by slips, and its rivals; their errors are in [m].

    before : fit of the table as it is
    best : best fit
    rivals : at most two other fits that are nearly as good
    """

    before: Fit
    best: Fit
    rivals: tuple[Fit, ...]

    @property
    def explains(self) -> bool:
        """Return whether the best fit has slips, and less than a quarter of the error before."""
        return self.best.slips > 0 and self.best.error < 0.25 * self.before.error


def search_slips(robot: Robot, m: Measurements, others: Sequence[Robot] = (), show: Show = silent) -> Slips | None:
    """Return the slips that best explain a table; None where it cannot be fitted (see `slip_fit`).

    robot : nominal robot
    others : robots that the file may have meant
    show : called with each line of progress
    """
    order = np.argsort(m.row)
    # The first 60 rows, not a selection of all, so that shifted rows still correspond.
    fit = slip_fit(robot, m[order[:60]], others)
    if fit is None:
        return None
    # Shifts need rows that follow each other in the file.
    shifts = _likely_shifts(fit, robot) if np.all(np.diff(m.row[order]) >= 1) and m.position is not None else (0,)
    fits = _search(fit, robot, shifts, show)
    before = fit.placed(Hypothesis.none(robot.n), as_given=True)
    errors = np.log([max(f.error, NOMINAL_ERROR_OF_REACH * robot.reach) for f in fits])
    # Orientations that differ by more than 0.1 rad count as one more slip.
    slips = [f.cost + (f.turn > 0.1) for f in fits]
    # Readings outside of the joint ranges count as half a slip.
    costs = (
        errors
        + np.log(MIN_ERROR_REDUCTION) * np.array(slips)
        + [0.35 * outside(f.hypothesis, robot, fit.q) for f in fits]
    )
    first, *behind = ranked(-costs)
    best = fits[first]
    near = [fits[k] for k in behind if fits[k].slips and costs[k] < costs[first] + np.log(MIN_ERROR_REDUCTION)]
    # Explanations with equal errors are one robot, or its mirror image: no pose distinguishes them.
    rivals = [f for f in near if abs(f.error - best.error) > 1e-6 * best.error]
    return Slips(before, best, tuple(rivals[:2]))


def slip_fit(robot: Robot, m: Measurements, others: Sequence[Robot] = ()) -> SlipFit | None:
    """Return the fast fit of slips to a table of positions, or of distances to a few points.

    None for other kinds, for robots with loops, and for too few rows.

    others : robots that the file may have meant
    """
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
    """Return whether a hypothesis h puts more than 5 % of the rows out of the joint ranges.

    q : readings of the table, shape (n, joints) [rad or m]
    """
    lower, upper = robot.limits
    meant = h.readings(q)
    # A few rows outside of the ranges are outliers.
    return bool(((meant < lower - 0.01) | (meant > upper + 0.01)).any(axis=1).mean() > 0.05)


def _likely_shifts(fit: SlipFit, robot: Robot) -> tuple[int, ...]:
    """Return the shift of rows with which readings predict positions; 0, 1 and -1 where unclear.

    A position is a trigonometric polynomial of the angles, whatever their signs, zeros and order.
    Kernel ridge regression on such polynomials shows the shift before other slips are found.
    """
    joints = zip(robot.joints, fit.q.T, strict=True)
    period = np.array([2 * np.pi if joint.kind == "revolute" else 4 * np.ptp(q) + 1e-9 for joint, q in joints])
    error = {}
    for shift in (0, 1, -1):
        q, y = fit.aligned(shift)
        kernel = np.prod(1 + 0.5 * np.cos(2 * np.pi / period * (q[:, None] - q)), axis=2) / 1.5 ** len(period)
        weights = np.linalg.inv(kernel + 0.1 * np.eye(len(q)))
        # Errors of leave-one-out predictions, in closed form.
        error[shift] = float(np.mean((weights @ (y - y.mean(axis=0)) / np.diag(weights)[:, None]) ** 2))
    best, second, _ = sorted(error, key=lambda shift: error[shift])
    return (best,) if error[best] < 0.8 * error[second] else tuple(error)


def _search(fit: SlipFit, robot: Robot, shifts: Sequence[int], show: Show) -> list[Fit]:
    """Return the fits of the best hypotheses of each number of slips, base and tool fitted."""
    none = Hypothesis.none(robot.n)._replace(shift=shifts[0])
    turning = [j.kind == "revolute" for j in robot.joints]
    # A column whose range is this small compared with the others may be in radians.
    move = np.ptp(fit.q, axis=0)
    turn = np.deg2rad(2 * np.pi)
    little = (move > np.deg2rad(0.3)) & (move < turn) & (np.median(move) > turn) & turning
    level = [none, *(none.at("factor", int(i), 180 / np.pi) for i in np.flatnonzero(little))]
    seen, fits = set(level), {h: fit.placed(h) for h in (Hypothesis.none(robot.n), none)}
    share = fit.shares(level)
    # More slips of one table at once are not searched for; that of a heavy arm is two of a hypothesis.
    max_slips = 4
    for depth in range(max_slips + 1):
        show(f"slips, search {depth + 1} of {max_slips + 1}")
        # The best hypotheses of all, and the 120 best of each shift and robot.
        order = ranked(np.negative(share))
        selected, of_each = order[: fit.beam], dict[tuple[int, int], int]()
        for k in order:
            key = (level[k].shift, level[k].rows)
            of_each[key] = of_each.get(key, 0) + 1
            if of_each[key] <= min(120, fit.beam) and k not in selected:
                selected.append(k)
        for k in selected[:20]:
            h = _refined(fit, level[k])
            fits.setdefault(h, fit.placed(h))
        least = min(f.error for f in fits.values())
        if depth == max_slips or least < 2 * NOMINAL_ERROR_OF_REACH * robot.reach:
            break
        parents = [level[k] for k in selected]
        first = [] if depth else _reversed_joints(parents, len(fit.rows))
        moves = dict.fromkeys((*first, *_all_moves(fit, parents, robot, turning, shifts)))
        level = [h for h in moves if h not in seen and h.cost <= max_slips + 1]
        seen.update(level)
        if not level:
            break
        share = fit.shares(level)
    return list(fits.values())


def _reversed_joints(starts: Sequence[Hypothesis], rows: int) -> Iterator[Hypothesis]:
    """Yield every choice of joints with reversed sign, for each start and each robot.

    The third joint's reading is also coupled to the second's, as parallelogram arms have it.
    """
    for h in starts:
        for sign, k in product(product((1, -1), repeat=len(h.sign)), range(rows)):
            turned = h._replace(sign=sign, rows=k)
            yield from (turned.at("add", 2, add) for add in (0, 1, -1)) if len(sign) > 2 else (turned,)


def _all_moves(
    fit: SlipFit, parents: Sequence[Hypothesis], robot: Robot, turning: Sequence[bool], shifts: Sequence[int]
) -> Iterator[Hypothesis]:
    """Yield all hypotheses that differ from these by one slip of readings, rows, lengths or zeros.

    turning : whether each joint is revolute; shifts : shifts of rows that are tried
    """
    lengths = fit.departures(parents)
    for h, of_each in zip(parents, lengths, strict=True):
        yield from further_slips(h, turning, shifts, len(fit.rows))
        yield from _length_moves(h, of_each, robot)
    for i in inner(turning):
        for sign in (1, -1):
            turned = [h.at("sign", i, sign * h.sign[i]) for h in parents]
            for h, more in zip(turned, fit.zeros(turned, i), strict=True):
                yield h.at("zero", i, _rounded_zero(h.zero[i] + more))


def _rounded_zero(angle: float) -> float:
    """Return the angle [rad] within +- pi, or the multiple of pi/2 if that is closer than 4 deg."""
    away = [abs(np.arctan2(np.sin(angle - v), np.cos(angle - v))) for v in QUARTER_TURNS]
    nearest = int(np.argmin(away))
    # Smaller errors of zeros are found by the calibration.
    if away[nearest] < np.deg2rad(4.0):
        return float(QUARTER_TURNS[nearest])
    return round(float(np.arctan2(np.sin(angle), np.cos(angle))), 4)


def _length_moves(h: Hypothesis, lengths: Array, robot: Robot) -> Iterator[Hypothesis]:
    """Yield the hypothesis with one more wrong link length, for each of the three best ones.

    Omitted are lengths that explain less than 10 %, are off by less than 2 % of the reach, or are
    in the hypothesis already.

    lengths : effect of freeing each length, shape (2 joints, 2), as of `SlipFit.departures`
    """
    n = robot.n
    order = ranked(-lengths[:, 0])[:3]
    for k in order:
        rest, departure = lengths[k]
        name, i = ("a", k) if k < n else ("d", k - n)
        is_listed = any((name, i) == (other, j) for other, j, _ in h.lengths)
        # Smaller errors of lengths are found by the calibration.
        if rest < 0.9 and abs(departure) > 0.02 * robot.reach and not is_listed:
            yield h._replace(lengths=(*h.lengths, (name, i, float(departure))))


def _refined(fit: SlipFit, h: Hypothesis) -> Hypothesis:
    """Return the hypothesis with its link lengths, and zeros that are no quarter turns, refined.

    They are fitted in turns, as they depend on each other.
    """
    n = len(h.zero)
    free = [i for i, z in enumerate(h.zero) if z and z not in QUARTER_TURNS]
    for _ in range(8 * (len(free) + len(h.lengths) > 0)):  # in turns, as they depend on each other
        before = h
        for i in free:
            h = h.at("zero", i, _rounded_zero(h.zero[i] + float(fit.zeros([h], i)[0])))
        for k, (name, i, departure) in enumerate(h.lengths):
            size = float(fit.departures([h])[0, i + (name == "d") * n, 1])
            h = h._replace(lengths=(*h.lengths[:k], (name, i, departure + size), *h.lengths[k + 1 :]))
        if h.zero == before.zero and not h.lengths:
            break
    return h

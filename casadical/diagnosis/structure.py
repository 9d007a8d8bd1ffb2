"""Whether what is left of a campaign is noise: does it follow anything that is known of the poses?

Residuals, white by the noise that was found, are regressed on functions of a driver (the angle of a joint, sums of
two, order in time, place, orientation, the sense of the last motion) along a direction (an axis of base or tool, about
the base's vertical, the motion of a joint). No driver is a candidate cause, and no prior says how large an error is:
each share is judged against what it is by chance among all that are tried (F test, Bonferroni), with the degrees of
freedom that the scatter of the squares says (Satterthwaite 1946), so that heavy tails and a single noisy direction
count for as much as they are. Close poses are compared, too: in joint space, where they were measured, and one after
the other.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from math import lgamma, log
from typing import ClassVar

import numpy as np
from scipy.special import gammaincc, log_ndtr

from casadical.core.basics import Array
from casadical.core.linear_gaussian.model import axes_of_base
from casadical.core.statistics import first_of_best
from casadical.core.telling.plain import WRITTEN, Key, written
from casadical.diagnosis.cross_validation import fitted_without
from casadical.diagnosis.evidence import REPEATABILITY, joint_noise
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.noise_evidence import Form
from casadical.identification.accuracy import predicted
from casadical.measurements.derived_columns import MIN_WAY_M, derive, last_sense
from casadical.measurements.measurements import Measurements, Noise
from casadical.robot.robot import Robot

# What is left follows a driver, and outliers a joint, if chance alone does it so rarely, among all that are tried.
CHANCE = 1e-3
# Poses that are looked at, spread over the campaign; where noise follows itself, so many of the first.
MOST_POSES, MOST_FOLLOWING = 600, 4000
# Sines of an angle up to these cycles a turn together; beyond, of a joint's own angle, each for itself up to the last.
TOGETHER, LAST_LINE = 3, 140.0
# Squares scatter like those of noise if their degrees of freedom are this share of the numbers at least; and noise is
# alike in all directions if chance alone makes them differ as much so often.
LIKE_NOISE, ISOTROPIC = 0.6, 1e-4
# Poses that are compared with all others in one go.
AT_ONCE = 512
# Of poses one after the other.
BEFORE = "the pose before"


@dataclass(frozen=True)
class Structure:
    """What is left follows a driver.

    along : the direction of the error; over : the driver; share : of the square of what is left
    log_chance : logarithm of how probable so large a share is in noise, among all that were tried
    line : cycles a turn of a sine of a joint's own angle along this joint, and the joint
    """

    derived: ClassVar[tuple[Key, ...]] = (Key("log10_chance", lambda found: found.log_chance / log(10), digits=1),)

    along: str = field(metadata=WRITTEN)
    over: str = field(metadata=WRITTEN)
    share: float = field(metadata=written(digits=4))
    log_chance: float
    line: tuple[int, float] | None = None


@dataclass(frozen=True)
class Remainder:
    """What is known of the remainder of a model: structures, the surest first; whether it looks like noise besides."""

    structures: tuple[Structure, ...]
    like_noise: bool


def remainder_of(case: Case, columns: Array, noise: Noise, form: Form | None = None) -> Remainder:
    """What is left beside columns of causes, shape (k,), at a noise of a form."""
    return _White(case, columns, noise, form or Form()).judged()


def lines_of(case: Case, columns: Array, noise: Noise, form: Form) -> tuple[tuple[int, float], ...]:
    """Joint and cycles a turn of the surest line of each joint in the same remainder, among all that is tried there."""
    return _White(case, columns, noise, form).lines()


def joint_of_outliers(case: Case, columns: Array, noise: Noise) -> int | None:
    """The joint along whose motion the poses left out err, as one that is wrong in few places makes them; else None.

    columns : of the causes, shape (k,). Of points that are wrong each for itself the cosine to any direction is uniform
    from -1 to 1; of each joint Fisher's sum of logarithms, Bonferroni.
    """
    out = ~case.kept
    if out.sum() < 2 or case.vectors is None:
        return None
    left, motions = fitted_without(case.whole, columns, noise, out)[out, :3], case.whole.Jq[out, :3]
    lengths = np.linalg.norm(left, axis=1)[:, None] * np.linalg.norm(motions, axis=1)
    cosine = np.abs(np.einsum("ki,kij->kj", left, motions)) / np.maximum(lengths, 1e-300)
    total = -np.log(np.clip(1 - cosine, 1e-300, 1.0)).sum(axis=0)
    best = first_of_best(total)
    # A sum of k logarithms has a gamma distribution of shape k.
    chance = len(total) * float(gammaincc(len(left), total[best]))
    return best + 1 if chance < CHANCE else None


# Drivers with their functions; and along a direction, those of as many functions each, with the cycles of lines.
_Functions = tuple[tuple[str, Array], ...]
_Group = tuple[str, Array, _Functions, Mapping[str, tuple[int, float]]]


class _White:
    """White residuals of some poses in the order of measuring, and what makes functions of the poses alike."""

    def __init__(self, case: Case, columns: Array, noise: Noise, form: Form) -> None:
        self.case = case
        m, _ = derive(case.m, ["progress", *(f"approach{j}" for j in case.robot.numbers)])
        kept = np.flatnonzero(case.kept)
        self._order = order = np.argsort(m.conditions["progress"][kept], kind="stable")
        n, most = len(order), min(len(order), MOST_FOLLOWING if form.stays else MOST_POSES)
        # Noise that follows itself is white only where poses follow each other.
        self.pick = np.arange(most) if form.stays else np.linspace(0, n - 1, most).round().astype(int)
        self._form = form if form.times is None else replace(form, times=form.times[self.pick])
        self._m, self.at = m[kept[order]], kept[order[self.pick]]
        self.e = e = case.evidence.at(order[self.pick])
        repeat = joint_noise(self._form.repeatability(e.Jq))
        self._W = repeat.whitening({REPEATABILITY: noise.repeatability / noise.sigma}).W / noise.sigma
        # What a fit with priors takes.
        whole = e.with_base(columns)
        A = self.rows(whole.J) * noise.sigma
        Q, _ = axes_of_base(A, noise.sigma / whole.prior)
        self._Q = Q[: len(A)]
        self._taken = float((self._Q**2).sum())
        self.y = self._beside(self.rows(e.r[:, :, None]))[:, 0]
        self.squares = (self.y.reshape(len(e.r), -1) ** 2).sum(axis=1)

    def rows(self, X: Array) -> Array:
        """Numbers at the poses, shape (n, numbers, k), as white rows, shape (n numbers, k)."""
        white = self._W @ self._form.serial(len(X)).whiten(X)
        return np.asarray(white.reshape(-1, X.shape[2]))

    def _beside(self, rows: Array) -> Array:
        """White rows less what the fit takes of them, shape (rows, k)."""
        return np.asarray(rows - self._Q @ (self._Q.T @ rows))

    @cached_property
    def freedom(self) -> float:
        """Degrees of freedom of what is left, by the scatter of its squares over the poses."""
        n, numbers = len(self.squares), self.e.count
        scatter = n * float((self.squares**2).sum()) / float(self.squares.sum()) ** 2 - 1
        return min(2 * n / max(scatter, 1e-9), numbers) * (1 - self._taken / max(numbers, 1))

    def judged(self) -> Remainder:
        if not self._is_left:
            return Remainder((), like_noise=True)
        tests = [*(s for group in self._groups() for s in self._followed(*group)), *self._close()]
        sure = _sure(tests, len(tests))
        each = {s.line[0] if s.line else s.over: s for s in reversed(sure)}  # of a joint's lines the surest
        tails = self.freedom >= LIKE_NOISE * (self.e.count - self._taken)
        # Drivers that are said.
        return Remainder(tuple([*reversed(each.values())][:3]), tails and self._isotropic())

    def lines(self) -> tuple[tuple[int, float], ...]:
        """The surest line of each joint, among all that are tried."""
        if not self._is_left:
            return ()
        groups = [*self._groups()]
        tried = sum(len(some) for _, _, some, _ in groups) + len([*self._close()])  # as where all is judged
        lines = [(a, v, tuple(f for f in some if f[0] in cycles), cycles) for a, v, some, cycles in groups]
        sure = _sure([s for group in lines if group[2] for s in self._followed(*group)], tried)
        return tuple({s.line[0]: s.line for s in reversed(sure) if s.line}.values())

    @property
    def _is_left(self) -> bool:
        """Whether anything is left to be judged."""
        return self.e.count - self._taken >= 2 and bool(self.squares.sum() > 0)

    @cached_property
    def _places(self) -> Array:
        """Where the points of all kept poses are, in the order of measuring, shape (kept, 3) [m].

        As the model has them, and of what is touched several times the mean: neither order nor nearness is the noise's.
        """
        p, alike = predicted(self.case.robot, self._m)[0], self.case.evidence.alike
        if alike is None or any(m.label is None for m in self.case.observations.sets):
            return p
        _, which = np.unique(alike[self._order], return_inverse=True)
        return np.asarray(np.stack([np.bincount(which, c) for c in p.T], axis=1) / np.bincount(which)[:, None])[which]

    def _groups(self) -> Iterator[_Group]:
        """Drivers of as many functions each along every direction."""
        functions = _by_width((name, g[self.pick]) for name, g in _of_poses(self.case.robot, self._m, self._places))
        for along, v in self._directions():
            own, cycles = dict(functions), dict[str, tuple[int, float]]()
            if hit := re.fullmatch(r"joint (\d+)", along):
                lines, cycles = _lines(self.case.m.q[self.at, int(hit[1]) - 1], int(hit[1]))
                own |= {2: (*own.get(2, ()), *lines)} if lines else {}
            for some in own.values():
                yield along, v, some, cycles

    def _followed(
        self, along: str, v: Array, some: _Functions, cycles: Mapping[str, tuple[int, float]]
    ) -> Iterator[Structure]:
        """Drivers of as many functions each along a direction."""
        width = some[0][1].shape[1]
        G = np.stack([g for _, g in some], axis=1)
        F = self._beside(self.rows(v[:, :, None] * G.reshape(len(v), 1, -1)))
        F = F.reshape(len(F), len(some), width).transpose(1, 0, 2)
        for (over, _), (share, k) in zip(some, self._shares(F), strict=True):
            yield Structure(along, over, share, log_chance_of(share, k, self.freedom), cycles.get(over))

    def _shares(self, F: Array) -> Iterator[tuple[float, int]]:
        """Of each group of columns, shape (groups, rows, width), the share that they explain and their rank."""
        normal, right = F.transpose(0, 2, 1) @ F, np.einsum("gri,r->gi", F, self.y)
        scale = np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 1e-300))
        value, vector = np.linalg.eigh(normal / scale[:, :, None] / scale[:, None])
        turned = np.einsum("gij,gi->gj", vector, right / scale)
        # Directions of which a share of this is linear in others move nothing more.
        seen = value > 1e-6
        part = np.where(seen, turned**2 / np.where(seen, value, 1.0), 0.0).sum(axis=1) / float(self.squares.sum())
        return zip(part.tolist(), seen.sum(axis=1).tolist(), strict=True)

    def _close(self) -> Iterator[Structure]:
        """Whether close poses err alike: in joint space, where they were measured, and one after the other."""
        y = self.y.reshape(len(self.squares), -1)
        q = np.concatenate([np.sin(self.case.m.q[self.at]), np.cos(self.case.m.q[self.at])], axis=1)
        pairs = {
            "poses that are near in joint space": _pairs(_nearest(q)),
            BEFORE: np.column_stack([np.arange(len(y) - 1), np.arange(1, len(y))]),
        }
        if self.case.vectors is not None:
            pairs["poses whose points are near"] = _pairs(_nearest(self._places[self.pick]))
        for over, both in pairs.items():
            alike = float((y[both[:, 0]] * y[both[:, 1]]).sum() / (y[both] ** 2).sum() * 2)
            z = alike * np.sqrt(len(both) * self.freedom / len(y))
            yield Structure("any direction", over, max(alike, 0.0), float(log_ndtr(-z)))

    def _directions(self) -> Iterator[tuple[str, Array]]:
        """Of an error at the poses, with their names, shape (n, numbers)."""
        for name, axes in self._frames.items():
            yield from zip(name.split(", "), axes.transpose(2, 0, 1), strict=True)
        for j in range(self.e.Jq.shape[2]):
            yield f"joint {j + 1}", self.e.Jq[:, :, j]

    @cached_property
    def _frames(self) -> Mapping[str, Array]:
        """Axes as columns, shape (n, numbers, 3), of positions; of other kinds of measurement none."""
        if self.case.vectors is None:
            return {}
        p, n = self.case.positions[self.at], len(self.at)
        R = predicted(self.case.robot, self.case.m[self.at])[1]
        frames = {
            "x, y, z": np.tile(np.eye(3), (n, 1, 1)),
            "the tool's x, the tool's y, the tool's z": R,
            "radius, azimuth, height": about_vertical(p),
        }
        more = self.e.r.shape[1] - 3
        return {name: np.concatenate([F, np.zeros((n, more, 3))], axis=1) for name, F in frames.items()}

    def _isotropic(self) -> bool:
        """Whether noise is alike along the axes of every frame (Mauchly's test of sphericity)."""
        n = len(self.squares)
        y = self.y.reshape(n, -1)[:, :3]
        if y.shape[1] < 3 or not self._frames or self._form.stays:
            return True
        chances = []
        for axes in self._frames.values():
            turned = np.einsum("nij,ni->nj", axes[:, :3], y)
            value = np.linalg.eigvalsh(turned.T @ turned / n)
            square = -(n - 1 - 17 / 18) * float(np.log(max(value.prod(), 1e-300) / value.mean() ** 3))
            # Six even degrees of freedom for five.
            chances.append(-square / 2 + np.log1p(square / 2 + square**2 / 8))
        return bool(min(chances) > log(ISOTROPIC / len(chances)))


def _nearest(q: Array) -> Array:
    """The number of the row nearest to each row, shape (n,), some at a time; of equally near ones the first."""
    square, nearest = (q**2).sum(axis=1), np.empty(len(q), dtype=np.int64)
    for first in range(0, len(q), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        apart = square[some, None] + square - 2 * q[some] @ q.T
        apart[np.arange(len(apart)), first + np.arange(len(apart))] = np.inf
        # Decimals of a squared distance: of poses on a grid many are equally near, within rounding.
        nearest[some] = apart.round(9).argmin(axis=1)
    return nearest


def _pairs(nearest: Array) -> Array:
    """Each row with the one nearest to it, each pair once, shape (pairs, 2)."""
    return np.unique(np.sort(np.column_stack([np.arange(len(nearest)), nearest]), axis=1), axis=0)


def _sure(found: Sequence[Structure], tried: int) -> list[Structure]:
    """Those that chance does not make among so many that are tried, the surest first."""
    among = [replace(s, log_chance=s.log_chance + log(tried)) for s in found]
    return sorted((s for s in among if s.log_chance < log(CHANCE)), key=lambda s: s.log_chance)


def about_vertical(p: Array) -> Array:
    """Axes at points as columns: away from the vertical, around it, up; shape (n, 3, 3)."""
    a = np.arctan2(p[:, 1], p[:, 0])
    zero, one = np.zeros(len(a)), np.ones(len(a))
    axes = [[np.cos(a), -np.sin(a), zero], [np.sin(a), np.cos(a), zero], [zero, zero, one]]
    return np.asarray(np.array(axes).transpose(2, 0, 1))


def log_chance_of(share: float, width: int, freedom: float) -> float:
    """Logarithm of the chance that as many columns explain such a share of noise, of so many degrees of freedom.

    An odd number of columns counts as one more: the share has a beta distribution, whose tail is a finite sum then.
    The sum is of logarithms because scipy's tail underflows below 1e-308.
    """
    half, rest = (width + 1) // 2, (freedom - width) / 2
    if rest <= 0 or not half:
        return 0.0
    share = min(max(share, 0.0), 1 - 1e-12)
    terms = [i * np.log(max(share, 1e-300)) + lgamma(rest + i) - lgamma(rest) - lgamma(i + 1) for i in range(half)]
    return min(0.0, rest * float(np.log1p(-share)) + float(np.logaddexp.reduce(terms)))


def _of_poses(robot: Robot, m: Measurements, p: Array) -> Iterator[tuple[str, Array]]:
    """Every driver's name and functions of it, shape (n, functions).

    m : in the order of measuring; p : of the points, shape (n, 3) [m]
    """
    q, n = m.q, m.q.shape[1]
    for j in range(n):
        yield f"q{j + 1}", sines(q[:, j], range(1, TOGETHER + 1))
    for i, j in combinations(range(n), 2):
        yield f"q{i + 1} + q{j + 1}", sines(q[:, i] + q[:, j], range(1, TOGETHER + 1))
        yield f"q{i + 1} - q{j + 1}", sines(q[:, i] - q[:, j], range(1, TOGETHER + 1))
    R, about = predicted(robot, m)[1], about_vertical(p)
    yield "time", _cosines(m.conditions["progress"])
    places = {"radius": np.hypot(p[:, 0], p[:, 1]), "azimuth": np.arctan2(p[:, 1], p[:, 0]), "height": p[:, 2]}
    for name, values in places.items():
        way = np.diff(values, prepend=values[0])
        way = ((way + np.pi) % (2 * np.pi) - np.pi) * places["radius"] if name == "azimuth" else way
        yield f"the {name}", _cosines(values)
        yield f"the sense of the last change of {name}", last_sense(way, MIN_WAY_M)[:, None]
    for j in range(n):
        yield f"approach{j + 1}", m.conditions[f"approach{j + 1}"][:, None]
    for k, axis in enumerate("xyz"):
        for other, direction in (("x", 0), ("y", 1), ("z", 2)):
            yield f"the tool's {axis} against {other}", _cosines(R[:, direction, k])
        for other, direction in (("the radius", 0), ("the azimuth", 1)):
            yield f"the tool's {axis} against {other}", _cosines((R[:, :, k] * about[:, :, direction]).sum(axis=1))


def _by_width(functions: Iterable[tuple[str, Array]]) -> dict[int, tuple[tuple[str, Array], ...]]:
    """Drivers by their number of functions; without those that are alike at all poses."""
    groups: dict[int, list[tuple[str, Array]]] = {}
    for name, g in functions:
        if len(g) and np.ptp(g, axis=0).max() > 0:
            groups.setdefault(g.shape[1], []).append((name, g))
    return {width: tuple(some) for width, some in groups.items()}


def _lines(angle: Array, joint: int) -> tuple[tuple[tuple[str, Array], ...], dict[str, tuple[int, float]]]:
    """Sines of a joint's own angle, one by one, as close as its readings distinguish them; which they are."""
    step = max(0.5, np.pi / max(float(np.ptp(angle)), 1e-3))
    cycles = np.arange(TOGETHER + step, LAST_LINE, step)
    names = {f"q{joint} at {f:.4g} cycles a turn": (joint, float(f)) for f in cycles}
    return tuple((name, sines(angle, [f])) for name, (_, f) in names.items()), names


def sines(angle: Array, cycles: range | list[float]) -> Array:
    """Sine and cosine of each number of cycles a turn in turn, shape (n, 2 cycles)."""
    return np.stack([f(h * angle) for h in cycles for f in (np.sin, np.cos)], axis=1)


def _cosines(values: Array) -> Array:
    """Of the rank of the values, from zero to one."""
    rank = (np.argsort(np.argsort(values, kind="stable")) + 0.5) / len(values)
    # The first four cosines of the rank of what is no angle.
    return np.stack([np.cos(np.pi * k * rank) for k in range(1, 5)], axis=1)

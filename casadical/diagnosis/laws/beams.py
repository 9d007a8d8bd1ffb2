"""Laws of the beam of an instrument, and of the head that turns it. Where it stands is a setting like others.

Some places around the robot are tried, and moved once a law is among the best. Waves over the range that are short
beside the spread of the poses need far more places: what is left is multiplied with all of them at once, as if nothing
of a wave were in the base model, and those with the greatest products are judged.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import best_of, first_of_best, ranked
from casadical.diagnosis.laws.forms import FORMS, SLOW, WAVE, Driver, Form
from casadical.diagnosis.laws.problem import Problem, Rough, Seam, Tried, log_mean, scaled
from casadical.diagnosis.linearisation import POINT, Linearisation
from casadical.effects.formula import NUMERIC, parse
from casadical.effects.formula_effect import HEAD, TOWARDS, Law, head_column
from casadical.robot.robot import Robot

# Where an instrument stands in the measuring frame [m], or which way its target looks in the flange's.
Point: TypeAlias = tuple[float, float, float]
# Where instruments stand: so many directions around the robot, at these distances from it, in reaches.
DIRECTIONS, DISTANCES = 8, (1.5, 2.5, 4.0)
# A step in those of other settings: a station's angle about the robot [rad], a share of its distance; a target's angle.
TURN, FARTHER, LOOK = 3.0, 6.0, 9.0
# Waves over the range, by their cycles a turn [1/m]: with these bounds, of so many between two that are tried.
BANDS, APART = (2.0, 4.0, 8.0, SLOW), 0.25
# Places for them: distances in reaches, and angles above the horizon [rad].
FAR, LOW, HIGH = (1.0, 1.6, 3.0), -0.15, 0.6
# A phase runs by so much over the spread of the poses from one direction to the next [rad].
PHASE = 2.0
# Products of so many numbers are made at a time; so many places are judged.
AT_A_TIME, JUDGED = 500_000, 24

# Drivers of what an instrument measures along and across its beam, each with its kind.
_OF_BEAM: Mapping[str, Mapping[str, str]] = {
    "beam": {
        "r": "range",
        "azimuth": "azimuth",
        "incidence": "incidence",
        "head": "linear",
        "head*incidence": "linear",
    },
    "across": {"head": "linear", "head*r": "linear"},
}


def stations(robot: Robot) -> list[Point]:
    """Where instruments may stand around the robot, and the frame's origin [m]."""
    middle, reach = robot.base.T[:3, 3], robot.reach
    places = [np.zeros(3)]
    for far in DISTANCES:
        for turn in 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
            places.append(middle + reach * np.array([far * np.cos(turn), far * np.sin(turn), 0.5]))
    return [_rounded(at) for at in places]


def _rounded(at: Array) -> Point:
    x, y, z = (round(float(v), 3) for v in at)
    return x, y, z


def by_the_beam(problem: Problem, linear: Linearisation, robot: Robot) -> Iterator[Rough]:
    """Laws of the beam and of the head that turns it, of an instrument whose station is a setting like others."""
    places = stations(robot)
    turns = all(head_column(at) in linear.conditions for at in places)
    for seam, drivers in _OF_BEAM.items():
        for text, kind in drivers.items() if turns else ((t, k) for t, k in drivers.items() if HEAD not in t):
            beam = Beam(linear, robot.base.T[:3, 3], seam, Driver(text, kind, "head" if kind == "linear" else kind))
            for form in FORMS[kind]:
                rough = [beam.tried(problem, form, places)]
                if (text, form) == ("r", WAVE):
                    rough += beam.short_waves(problem, robot.reach)
                yield best_of(rough, lambda r: r.mean, logs=True)


@dataclass(frozen=True, eq=False)
class Beam:
    """Along it, or across it, an instrument errs by a driver. seam : see `SEAMS`; middle : of the robot's foot [m]"""

    linear: Linearisation
    middle: Array
    seam: str
    driver: Driver

    def at(self, station: Point, towards: Point = TOWARDS) -> tuple[Seam, Array]:
        """The place where an instrument at a station acts, and the driver's values there, shape (n,).

        towards : which way the target looks, in the flange's frame

        The same as `Linearisation.columns` of a law, which composes the formula of each station for itself.
        """
        beam, frame = self.linear.seen[:, :3] - station, self.linear.seen[:, -12:-3].reshape(-1, 3, 3)
        r = np.sqrt((beam**2).sum(axis=1) + 1e-12)
        way = beam / r[:, None]
        met = np.einsum("ni,nji,j->n", way, frame, towards)
        known = {"r": r, "azimuth": np.arctan2(beam[:, 1], beam[:, 0]), "incidence": met}
        if HEAD in self.driver.text:
            known[HEAD] = self.linear.conditions[head_column(station)]
        if self.seam == "across":
            aside = np.column_stack([-beam[:, 1], beam[:, 0], np.zeros(len(beam))])
            way = aside / np.sqrt((aside**2).sum(axis=1) + 1e-12)[:, None]
        (x,) = parse(self.driver.text).values(known, NUMERIC)
        law = Law(None, self.seam, "a", station=station, towards=towards)
        return Seam(law, self._by_point @ way[:, :, None]), np.asarray(x)

    @property
    def _by_point(self) -> Array:
        """Derivative by the measured point, of all readings at a pose, shape (n, 3, 3)."""
        S, readings = self.linear.S, 1 + self.linear.further
        return np.asarray(S[:, :, -POINT * readings :].reshape(*S.shape[:2], readings, POINT).sum(axis=2))

    def nearby(self, law: Law, step: float) -> list[tuple[Seam, Array]]:
        """A station moved by a step to each side, up and down, farther and nearer; a target turned by one."""
        out = np.asarray(law.station) - self.middle
        flat, angle = max(float(np.hypot(out[0], out[1])), 1e-6), TURN * step
        aside = np.array([-out[1], out[0], 0.0])
        above = np.array([-out[0] * out[2], -out[1] * out[2], flat**2]) / flat
        moves = [sign * move for move in (angle * aside, angle * above, FARTHER * step * out) for sign in (-1, 1)]
        near = [self.at(_rounded(law.station + move), law.towards) for move in moves]
        if "incidence" in self.driver.text:
            turned = [law.towards + sign * LOOK * step * axis for axis in np.eye(3) for sign in (-1, 1)]
            near += [self.at(law.station, _rounded(way / np.linalg.norm(way))) for way in turned]
        return near

    def tried(self, problem: Problem, form: Form, places: Sequence[Point], settings: int = 0) -> Rough:
        """Laws of one form at all stations together. settings : how many were looked at, by default these"""
        ways = list(map(_rounded, np.eye(3))) if "incidence" in self.driver.text else [TOWARDS]
        beams, x = zip(*(self.at(*at) for at in itertools.product(places, ways)), strict=True)
        laws = Tried(beams, self.driver, form, x, nearby=None if HEAD in self.driver.text else self.nearby)
        functions = [scaled(form.values(v, s)) for v, s in zip(x, laws.settings, strict=True)]
        columns = [b.columns[..., None] * f.transpose(1, 0, 2)[:, None] for b, f in zip(beams, functions, strict=True)]
        gains = problem.gains_of(beams[0].size * np.concatenate(columns, axis=3))
        each = np.split(gains, np.cumsum([len(s) for s in laws.settings])[:-1])
        k = first_of_best([g.max() for g in each], logs=True)
        best = first_of_best(each[k], logs=True)
        mean = float(log_mean(gains) - np.log(max(settings, len(gains))))
        return Rough(laws, k, laws.settings[k][best], float(each[k][best]), mean)

    def short_waves(self, problem: Problem, reach: float) -> list[Rough]:
        """The best wave over the range that is short beside the spread of the poses, from many more stations."""
        point = self.linear.seen[:, :3]
        pull = np.einsum("nij,ni->nj", self._by_point, problem.pulled)
        spread = float(np.sqrt(((point - point.mean(axis=0)) ** 2).sum(axis=1).mean()))
        size, place, settings = np.zeros(0), np.zeros((0, 3)), 0
        for low, high in itertools.pairwise(BANDS):
            if (step := PHASE / (high * spread)) > 2 * np.pi / DIRECTIONS:
                continue
            places, waves = self.middle + reach * _directions(step), np.arange(low, high, APART)
            settings += len(places) * len(waves)
            for first in range(0, len(places), max(AT_A_TIME // len(point), 1)):
                some = places[first : first + max(AT_A_TIME // len(point), 1)]
                size, place = np.append(size, _greatest(point - some[:, None], pull, waves)), np.append(place, some, 0)
                best = ranked(size)[:JUDGED]
                size, place = size[best], place[best]
        if not settings:
            return []
        return [self.tried(problem, WAVE, [_rounded(at) for at in place], settings)]


def _greatest(beams: Array, pull: Array, waves: Array) -> Array:
    """The greatest product of what is left with any of some waves over each beam's length, shape (places,).

    beams : shape (places, n, 3) [m]; pull : see `Problem.pulled`; waves : APART, shape (k,) [1/m]
    """
    r = np.sqrt((beams**2).sum(axis=2))
    product = (beams * pull).sum(axis=2) / r * np.exp(1j * waves[0] * r)
    turn, greatest = np.exp(1j * APART * r), np.zeros(len(r))
    for _ in waves:
        greatest = np.maximum(greatest, np.abs(product.sum(axis=1)))
        product *= turn
    return np.asarray(greatest)


def _directions(step: float) -> Array:
    """Points about the middle at all distances, a step apart [rad], shape (places, 3) in reaches."""
    every = np.meshgrid(FAR, np.arange(LOW, HIGH, step), np.arange(0, 2 * np.pi, step), indexing="ij")
    far, up, turn = (a.ravel() for a in every)
    points = np.column_stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)])
    return np.asarray(far[:, None] * points)

"""Laws of the beam of an instrument, and of the head that turns it. Where it stands is a setting like others.

Some places around the robot are tried, and moved once a law is among the best. Waves over the range that are short
beside the spread of the poses need far more places: what is left is multiplied with all of them at once, as if nothing
of a wave were in the base model, and those with the greatest products are judged.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import WHOLE_AXIS
from casadical.core.statistics import best_of, first_of_best, ranked
from casadical.diagnosis.laws.forms import FORMS, SLOW, WAVE, Driver, Form
from casadical.diagnosis.laws.problem import Problem, Rough, Seam, Tried, log_mean, scaled
from casadical.diagnosis.linearisation import POINT_VARIABLES, Linearisation
from casadical.effects.formula import NUMERIC_FUNCTIONS, parse
from casadical.effects.formula_effect import DEFAULT_TARGET_DIRECTION, HEAD_NAME, Law, head_column
from casadical.robot.robot import Robot

# Where an instrument stands in the measuring frame [m], or which way its target looks in the flange's.
Point: TypeAlias = tuple[float, float, float]
# Where instruments stand: so many directions around the robot, at these distances from it, in reaches.
DIRECTIONS, DISTANCES = 8, (1.5, 2.5, 4.0)
# A step in those of other settings: a station's angle about the robot [rad], a share of its distance; a target's angle.
TURN, FARTHER, LOOK = 3.0, 6.0, 9.0
# Waves over the range by their radians a metre: bands, each with places of its own, and the step between two waves.
BANDS, APART = (2.0, 4.0, 8.0, SLOW), 0.25
# Places for them: distances in reaches, and angles above the horizon [rad].
FAR, LOW, HIGH = (1.0, 1.6, 3.0), -0.15, 0.6
# Products of so many numbers are made at a time; so many places are judged.
AT_A_TIME, JUDGED = 500_000, 24
# Places are looked for by so many poses, spread over all. A band that needs more products (some seconds) is left out.
LOOKED_AT, MOST_PRODUCTS = 200, 2e8
# Ways that a target may look, to both sides: along the flange's axes, between two, and between all three.
_HALF = [(x, y, z) for x in (1, 0, -1) for y in (1, 0, -1) for z in (1, 0, -1) if (x, y, z) > (0, 0, 0)]

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
        for text, kind in drivers.items() if turns else ((t, k) for t, k in drivers.items() if HEAD_NAME not in t):
            beam = Beam(
                linear, robot.base.T[:3, 3], robot.reach, seam, Driver(text, kind, "head" if kind == "linear" else kind)
            )
            there = beam.at_all(places)
            for form in FORMS[kind]:
                rough = [beam.tried(problem, form, there)]
                if (text, form) == ("r", WAVE):
                    rough += beam.short_waves(problem)
                yield best_of(rough, lambda r: r.mean, logs=True)


@dataclass(frozen=True, eq=False)
class Beam:
    """Along it, or across it, an instrument errs by a driver.

    middle, reach : the robot's foot and how far it reaches [m]; seam : see `SEAMS`
    """

    linear: Linearisation
    middle: Array
    reach: float
    seam: str
    driver: Driver

    def at(self, station: Point, towards: Point = DEFAULT_TARGET_DIRECTION) -> tuple[Seam, Array]:
        """The place where an instrument at a station acts, and the driver's values there, shape (n,).

        towards : which way the target looks, in the flange's frame

        The same as `Linearisation.columns` of a law, which composes the formula of each station for itself.
        """
        beam, frame = self.linear.seen[:, :3] - station, self.linear.seen[:, -12:-3].reshape(-1, 3, 3)
        r = np.sqrt((beam**2).sum(axis=1) + 1e-12)
        way = beam / r[:, None]
        met = np.einsum("ni,nji,j->n", way, frame, towards)
        known = {"r": r, "azimuth": np.arctan2(beam[:, 1], beam[:, 0]), "incidence": met}
        if HEAD_NAME in self.driver.text:
            known[HEAD_NAME] = self.linear.conditions[head_column(station)]
        if self.seam == "across":
            aside = np.column_stack([-beam[:, 1], beam[:, 0], np.zeros(len(beam))])
            way = aside / np.sqrt((aside**2).sum(axis=1) + 1e-12)[:, None]
        (x,) = parse(self.driver.text).values(known, NUMERIC_FUNCTIONS)
        law = Law(None, self.seam, "a", station=station, towards=towards)
        return Seam(law, self._by_point @ way[:, :, None]), np.asarray(x)

    @property
    def _by_point(self) -> Array:
        """Derivative by the measured point, of all readings at a pose, shape (n, 3, 3)."""
        S, readings = self.linear.S, 1 + self.linear.further
        return np.asarray(
            S[:, :, -POINT_VARIABLES * readings :].reshape(*S.shape[:2], readings, POINT_VARIABLES).sum(axis=2)
        )

    def nearby(self, law: Law, step: float) -> list[tuple[Seam, Array]]:
        """A station moved by a step to each side, up and down, farther and nearer; a target turned by one."""
        out = np.asarray(law.station) - self.middle
        far = max(float(np.linalg.norm(out)), self.reach)
        # At the foot, or straight above it, the way out is any.
        way = out / np.linalg.norm(out) if out.any() else np.eye(3)[0]
        # Less of a way out of the foot that is level is none.
        aside = np.cross(np.eye(3)[2] if np.hypot(way[0], way[1]) > 0.1 else np.eye(3)[0], way)
        aside /= np.linalg.norm(aside)
        moves = (TURN * far * aside, TURN * far * np.cross(way, aside), FARTHER * far * way)
        places = [_rounded(law.station + sign * step * move) for move in moves for sign in (-1, 1)]
        near = [self.at(place, law.towards) for place in places]
        if "incidence" in self.driver.text:
            turned = [law.towards + sign * LOOK * step * axis for axis in np.eye(3) for sign in (-1, 1)]
            near += [self.at(law.station, _rounded(way / np.linalg.norm(way))) for way in turned]
        return near

    def at_all(self, places: Sequence[Point]) -> list[tuple[Seam, Array]]:
        """The places at all stations, and of a target that looks any way, where that counts."""
        ways = [_rounded(np.array(way) / np.linalg.norm(way)) for way in _HALF]
        every = itertools.product(places, ways if "incidence" in self.driver.text else [DEFAULT_TARGET_DIRECTION])
        return [self.at(*at) for at in every]

    def laws(self, form: Form, there: Sequence[tuple[Seam, Array]]) -> Tried:
        """Those of one form at some places together."""
        beams, x = zip(*there, strict=True)
        return Tried(beams, self.driver, form, x, nearby=None if HEAD_NAME in self.driver.text else self.nearby)

    def tried(self, problem: Problem, form: Form, there: Sequence[tuple[Seam, Array]], settings: int = 0) -> Rough:
        """The same, judged. settings : how many were looked at, by default these"""
        laws = self.laws(form, there)
        functions = [scaled(form.values(v, s)) for v, s in zip(laws.x, laws.settings, strict=True)]
        units = [place.columns for place in laws.seams]
        columns = [u[..., None] * f.transpose(1, 0, 2)[:, None] for u, f in zip(units, functions, strict=True)]
        gains = problem.gains_of(laws.seams[0].size * np.concatenate(columns, axis=3))
        each = np.split(gains, np.cumsum([len(s) for s in laws.settings])[:-1])
        k = first_of_best([g.max() for g in each], logs=True)
        best = first_of_best(each[k], logs=True)
        mean = float(log_mean(gains) - np.log(max(settings, len(gains))))
        return Rough(laws, k, laws.settings[k][best], float(each[k][best]), mean)

    def short_waves(self, problem: Problem) -> list[Rough]:
        """The best wave over the range that is short beside the spread of the poses, from many more stations."""
        places, settings = self._places(problem)
        if not settings:
            return []
        found = self.tried(problem, WAVE, self.at_all(places), settings)
        return [replace(found, tried=replace(found.tried, again=self._again))]

    def _again(self, problem: Problem, poses: Array) -> Tried:
        """Laws of short waves from places that some poses alone say; problem : of these."""
        return self.laws(WAVE, self.at_all(self._places(problem, poses)[0]))

    def _places(self, problem: Problem, poses: Array | slice = WHOLE_AXIS) -> tuple[list[Point], int]:
        """Of the greatest products of short waves with what is left at some poses; and how many were made."""
        point, pull = self.linear.seen[poses, :3], np.einsum("nij,ni->nj", self._by_point[poses], problem.pulled)
        spread = float(np.sqrt(((point - point.mean(axis=0)) ** 2).sum(axis=1).mean()))
        some = np.linspace(0, len(point) - 1, min(len(point), LOOKED_AT)).round().astype(int)
        point, pull = point[some], pull[some]
        size, place, settings = np.zeros(0), np.zeros((0, 3)), 0
        for low, high in itertools.pairwise(BANDS):
            # A phase runs by so much over the spread of the poses from one direction to the next
            # [rad].
            if (step := 2.0 / (high * spread)) > 2 * np.pi / DIRECTIONS:
                continue
            places, waves = self.middle + self.reach * _directions(step), np.arange(low, high, APART)
            if len(places) * len(waves) * len(point) > MOST_PRODUCTS:
                break
            settings += len(places) * len(waves)
            for part in np.array_split(places, 1 + len(places) * len(point) // AT_A_TIME):
                size = np.append(size, _greatest(point - part[:, None], pull, waves))
                place = np.append(place, part, axis=0)
                best = ranked(size)[:JUDGED]
                size, place = size[best], place[best]
        return [_rounded(at) for at in place], settings


def _greatest(beams: Array, pull: Array, waves: Array) -> Array:
    """The greatest product of what is left with any of some waves over each beam's length, shape (places,).

    beams : shape (places, n, 3) [m]; pull : see `Problem.pulled`; waves : APART, shape (k,) [1/m]
    """
    r = np.sqrt((beams**2).sum(axis=2)) + 1e-6
    product = (beams * pull).sum(axis=2) / r * np.exp(1j * waves[0] * r)
    turn, greatest = np.exp(1j * APART * r), np.zeros(len(r))
    for _ in waves:
        greatest = np.maximum(greatest, np.abs(product.sum(axis=1)))
        product *= turn
    return np.asarray(greatest)


def _directions(step: float) -> Array:
    """Points about the middle at all distances, a step apart [rad], shape (places, 3) in reaches."""
    ups = np.linspace(LOW, HIGH, 1 + int(np.ceil((HIGH - LOW) / step)))
    every = np.meshgrid(FAR, ups, np.arange(0, 2 * np.pi, step), indexing="ij")
    far, up, turn = (a.ravel() for a in every)
    points = np.column_stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)])
    return np.asarray(far[:, None] * points)

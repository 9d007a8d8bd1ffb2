"""Laws of an instrument's beam and of its rotating head; the instrument's station is a setting.

Some stations around the robot are tried, and moved once a law is among the best. Waves over the
range that are short compared with the spread of the poses need many more stations: the products of
the residual with all of these waves are computed without the projection by the base model, and the
stations with the largest products are evaluated.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import WHOLE_AXIS
from casadical.core.statistics import best_of, first_of_best, ranked
from casadical.diagnosis.laws.forms import FORMS, FORMS_BY_KIND, Driver, Form
from casadical.diagnosis.laws.problem import InsertionPoint, Problem, ScreenedLaw, TriedLaws, log_mean, scaled
from casadical.diagnosis.linearisation import POINT_VARIABLES, Linearisation
from casadical.diagnosis.settings import SETTINGS
from casadical.effects.formula import NUMERIC_FUNCTIONS, parse
from casadical.effects.formula_effect import DEFAULT_TARGET_DIRECTION, HEAD_NAME, Law, head_column
from casadical.robot.robot import Robot

# Position of an instrument in the measuring frame [m], or direction of its target in the flange
# frame.
Point: TypeAlias = tuple[float, float, float]
# Number of horizontal directions around the robot's base in which stations of an instrument are
# searched.
STATION_DIRECTIONS = 8
# Spacing of the wave numbers of short waves: range errors periodic with 2 rad/m or more.
WAVE_SPACING_RAD_PER_M = 0.25
# Directions in which a target may face, in the flange frame, not normalised, one of each pair of
# opposites: along an axis, between two axes, and between all three.
_TARGET_DIRECTIONS = [(x, y, z) for x in (1, 0, -1) for y in (1, 0, -1) for z in (1, 0, -1) if (x, y, z) > (0, 0, 0)]

# Drivers of errors along and across an instrument's beam, by insertion point: kind (see
# `FORMS_BY_KIND`) by formula.
_DRIVERS_BY_SEAM: Mapping[str, Mapping[str, str]] = {
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
    """Return candidate positions of an instrument in the measuring frame [m].

    They are its origin and points around the robot's base at three distances.
    """
    middle, reach = robot.base.T[:3, 3], robot.reach
    places = [np.zeros(3)]
    # Horizontal distances of the stations from the robot's base, divided by its reach.
    for far in (1.5, 2.5, 4.0):
        for turn in 2 * np.pi * np.arange(STATION_DIRECTIONS) / STATION_DIRECTIONS:
            places.append(middle + reach * np.array([far * np.cos(turn), far * np.sin(turn), 0.5]))
    return [_rounded(at) for at in places]


def _rounded(at: Array) -> Point:
    """Return a point or direction with coordinates rounded to three decimals."""
    x, y, z = (round(float(v), 3) for v in at)
    return x, y, z


def by_the_beam(problem: Problem, linear: Linearisation, robot: Robot) -> Iterator[ScreenedLaw]:
    """Yield the best law by screened evidence of each driver and form of an instrument's beam.

    Drivers of the head's rotation are included if its columns exist for all stations.
    """
    places = stations(robot)
    turns = all(head_column(at) in linear.conditions for at in places)
    for seam, drivers in _DRIVERS_BY_SEAM.items():
        for text, kind in drivers.items() if turns else ((t, k) for t, k in drivers.items() if HEAD_NAME not in t):
            beam = Beam(
                linear, robot.base.T[:3, 3], robot.reach, seam, Driver(text, kind, "head" if kind == "linear" else kind)
            )
            there = beam.at_all(places)
            for form in FORMS_BY_KIND[kind]:
                rough = [beam.tried(problem, form, there)]
                if (text, form.name) == ("r", "wave"):
                    rough += beam.short_waves(problem)
                yield best_of(rough, lambda r: r.mean, logs=True)


@dataclass(frozen=True, eq=False)
class Beam:
    """Errors of an instrument along or across its beam by one driver.

    linear : the robot linearised at the poses
    middle, reach : position of the robot's base in the measuring frame, and its reach [m]
    seam : insertion point, "beam" or "across"; driver : quantity on which the errors depend
    """

    linear: Linearisation
    middle: Array
    reach: float
    seam: str
    driver: Driver

    def at(self, station: Point, towards: Point = DEFAULT_TARGET_DIRECTION) -> tuple[InsertionPoint, Array]:
        """Return the insertion point of an instrument at a station, and the driver's values, (n,).

        The columns equal those of `Linearisation.columns`, which compiles a formula for each
        station.
        station : its position in the measuring frame [m]
        towards : direction in which the target faces, in the flange frame
        """
        beam, frame = self.linear.seen[:, :3] - station, self.linear.seen[:, -12:-3].reshape(-1, 3, 3)
        r = np.sqrt((beam**2).sum(axis=1) + 1e-12)
        way = beam / r[:, None]
        met = np.einsum("ni,nji,j->n", way, frame, towards)
        values = {"r": r, "azimuth": np.arctan2(beam[:, 1], beam[:, 0]), "incidence": met}
        if HEAD_NAME in self.driver.text:
            values[HEAD_NAME] = self.linear.conditions[head_column(station)]
        if self.seam == "across":
            aside = np.column_stack([-beam[:, 1], beam[:, 0], np.zeros(len(beam))])
            way = aside / np.sqrt((aside**2).sum(axis=1) + 1e-12)[:, None]
        (x,) = parse(self.driver.text).values(values, NUMERIC_FUNCTIONS)
        law = Law(None, self.seam, "a", station=station, towards=towards)
        return InsertionPoint(law, self._by_point @ way[:, :, None]), np.asarray(x)

    @property
    def _by_point(self) -> Array:
        """Return the derivatives of each pose's numbers by the measured point, shape (n, 3, 3)."""
        S, readings = self.linear.S, 1 + self.linear.further
        return np.asarray(
            S[:, :, -POINT_VARIABLES * readings :].reshape(*S.shape[:2], readings, POINT_VARIABLES).sum(axis=2)
        )

    def nearby(self, law: Law, step: float) -> list[tuple[InsertionPoint, Array]]:
        """Return the places near a law's: its station moved by a step, or its target rotated.

        Each is an insertion point with the driver's values, shape (n,). step : dimensionless
        """
        out = np.asarray(law.station) - self.middle
        far = max(float(np.linalg.norm(out)), self.reach)
        # At the base the outward direction is arbitrary.
        way = out / np.linalg.norm(out) if out.any() else np.eye(3)[0]
        # For a nearly vertical outward direction the side direction is arbitrary, too.
        aside = np.cross(np.eye(3)[2] if np.hypot(way[0], way[1]) > 0.1 else np.eye(3)[0], way)
        aside /= np.linalg.norm(aside)
        # For a unit step of a refinement a station turns about the robot by 3 rad, or moves by six times its
        # distance, and a target turns by 9 rad.
        moves = (3.0 * far * aside, 3.0 * far * np.cross(way, aside), 6.0 * far * way)
        places = [_rounded(law.station + sign * step * move) for move in moves for sign in (-1, 1)]
        near = [self.at(place, law.towards) for place in places]
        if "incidence" in self.driver.text:
            directions = [law.towards + sign * 9.0 * step * axis for axis in np.eye(3) for sign in (-1, 1)]
            near += [self.at(law.station, _rounded(way / np.linalg.norm(way))) for way in directions]
        return near

    def at_all(self, places: Sequence[Point]) -> list[tuple[InsertionPoint, Array]]:
        """Return the insertion points and driver's values (n,) of all stations [m].

        There is one for each target direction if the driver depends on it.
        """
        ways = [_rounded(np.array(way) / np.linalg.norm(way)) for way in _TARGET_DIRECTIONS]
        every = itertools.product(places, ways if "incidence" in self.driver.text else [DEFAULT_TARGET_DIRECTION])
        return [self.at(*at) for at in every]

    def laws(self, form: Form, there: Sequence[tuple[InsertionPoint, Array]]) -> TriedLaws:
        """Return the laws of one form at several places.

        there : places with the driver's values, as of `at_all`
        """
        beams, x = zip(*there, strict=True)
        return TriedLaws(beams, self.driver, form, x, nearby=None if HEAD_NAME in self.driver.text else self.nearby)

    def tried(
        self, problem: Problem, form: Form, there: Sequence[tuple[InsertionPoint, Array]], settings: int = 0
    ) -> ScreenedLaw:
        """Return the best law of one form at several places by screened evidence.

        there : places with the driver's values, as of `at_all`
        settings : number of settings from which those of the laws were selected, over which the
            evidence is averaged; by default the number of laws
        """
        laws = self.laws(form, there)
        functions = [scaled(form.values(v, s)) for v, s in zip(laws.x, laws.settings, strict=True)]
        units = [place.columns for place in laws.seams]
        columns = [u[..., None] * f.transpose(1, 0, 2)[:, None] for u, f in zip(units, functions, strict=True)]
        gains = problem.gains_of(laws.seams[0].size * np.concatenate(columns, axis=3))
        each = np.split(gains, np.cumsum([len(s) for s in laws.settings])[:-1])
        k = first_of_best([g.max() for g in each], logs=True)
        best = first_of_best(each[k], logs=True)
        mean = float(log_mean(gains) - np.log(max(settings, len(gains))))
        return ScreenedLaw(laws, k, laws.settings[k][best], float(each[k][best]), mean)

    def short_waves(self, problem: Problem) -> list[ScreenedLaw]:
        """Return the best wave over the range of 2 rad/m or more, from many more stations.

        The list has one item, or none if the stations would be too many.
        """
        places, settings = self._places(problem)
        if not settings:
            return []
        found = self.tried(problem, FORMS["wave"], self.at_all(places), settings)

        def again(problem: Problem, poses: Array) -> TriedLaws:
            """Return the laws of short waves from stations found on some poses of the problem."""
            return self.laws(FORMS["wave"], self.at_all(self._places(problem, poses)[0]))

        return [replace(found, tried=replace(found.tried, again=again))]

    def _places(self, problem: Problem, poses: Array | slice = WHOLE_AXIS) -> tuple[list[Point], int]:
        """Return the stations [m] whose short waves have the largest products with the residual.

        The second item is the number of pairs of a station and a wave number that were searched.
        poses : indices of the problem's poses among those of the linearisation
        """
        point, weights = (
            self.linear.seen[poses, :3],
            np.einsum("nij,ni->nj", self._by_point[poses], problem.residual_weights),
        )
        spread = float(np.sqrt(((point - point.mean(axis=0)) ** 2).sum(axis=1).mean()))
        # Stations for short waves are searched on 200 poses, spread over all.
        some = np.linspace(0, len(point) - 1, min(len(point), 200)).round().astype(int)
        point, weights = point[some], weights[some]
        size, place, settings = np.zeros(0), np.zeros((0, 3)), 0
        # Each band of short waves over the range [rad/m] has its own stations.
        for low, high in itertools.pairwise((2.0, 4.0, 8.0, SETTINGS.max_slow_cycles)):
            # Between neighbouring directions the phase changes by up to 2 rad over the spread of
            # poses.
            if (step := 2.0 / (high * spread)) > 2 * np.pi / STATION_DIRECTIONS:
                continue
            places, waves = self.middle + self.reach * _directions(step), np.arange(low, high, WAVE_SPACING_RAD_PER_M)
            # A band of short waves that needs more products than this (some seconds) is skipped.
            if len(places) * len(waves) * len(point) > 2e8:
                break
            settings += len(places) * len(waves)
            # The number of products that are computed at a time bounds memory.
            for part in np.array_split(places, 1 + len(places) * len(point) // 500_000):
                size = np.append(size, _greatest(point - part[:, None], weights, waves))
                place = np.append(place, part, axis=0)
                best = ranked(size)[:24]
                size, place = size[best], place[best]
        return [_rounded(at) for at in place], settings


def _greatest(beams: Array, weights: Array, waves: Array) -> Array:
    """Return the largest product of the residual with waves over the range, shape (places,).

    beams : vectors from each station to each measured point, shape (places, n, 3) [m]
    weights : see `Problem.residual_weights`
    waves : wave numbers spaced by WAVE_SPACING_RAD_PER_M, shape (k,) [rad/m]
    """
    r = np.sqrt((beams**2).sum(axis=2)) + 1e-6
    product = (beams * weights).sum(axis=2) / r * np.exp(1j * waves[0] * r)
    turn, greatest = np.exp(1j * WAVE_SPACING_RAD_PER_M * r), np.zeros(len(r))
    for _ in waves:
        greatest = np.maximum(greatest, np.abs(product.sum(axis=1)))
        product *= turn
    return np.asarray(greatest)


def _directions(step: float) -> Array:
    """Return points around the origin at three distances, shape (places, 3), in units of the reach.

    step : angle between neighbouring directions [rad]
    """
    low, high = -0.15, 0.6  # elevations above the horizontal [rad]
    ups = np.linspace(low, high, 1 + int(np.ceil((high - low) / step)))
    # Distances of the stations from the robot's base, divided by its reach.
    every = np.meshgrid((1.0, 1.6, 3.0), ups, np.arange(0, 2 * np.pi, step), indexing="ij")
    far, up, turn = (a.ravel() for a in every)
    points = np.column_stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)])
    return np.asarray(far[:, None] * points)

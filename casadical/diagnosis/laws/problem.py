"""A law that is tried at a seam (a place where an error may be added), its evidence beside what is known, its score."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.grid import log_sum
from casadical.diagnosis.evidence import KAPPA_WEIGHTS, Evidence
from casadical.diagnosis.laws.forms import (
    Driver,
    Form,
)
from casadical.diagnosis.laws.screening import Screen, log_mean
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.linearisation import Linearisation
from casadical.effects.formula_effect import SEAMS, Law
from casadical.measurements.measurements import Noise
from casadical.robot.robot import Robot

# Realistic size of a law, one sigma: where a form varies by one.
ANGLE, LENGTH, SHARE = 30e-6, 30e-6, 0.03
# The same in joint logs, in shares of the great torque and rad.
IN_LOGS = {"torque": 0.05, "response": 1e-3}
# Where instruments stand: so many directions around the robot, at these distances from it, in reaches.
DIRECTIONS, DISTANCES = 8, (1.5, 2.5, 4.0)
LETTERS = "abcdefghijklmnopqsuvwxyz"


@dataclass(frozen=True, eq=False)
class Seam:
    """A place; law : with a constant formula there, columns : of its factors, shape (n, 3, d) [m per unit]."""

    law: Law
    columns: Array

    @property
    def size(self) -> float:
        """One sigma of its factors."""
        return IN_LOGS.get(self.law.seam) or {"rad": ANGLE, "m": LENGTH}.get(SEAMS[self.law.seam][1], SHARE)

    def takes(self, driver: Driver) -> bool:
        """Whether a driver may act there: the payload's energy follows logged columns alone."""
        return self.law.seam != "payload" or driver.columns_only

    def with_formula(self, parts: Sequence[str], scales: Sequence[float]) -> Law:
        """The law of these parts, each with factors of its own. scales : how much each part varies."""
        d = SEAMS[self.law.seam][0]
        terms, factors = [], []
        for k, (part, scale) in enumerate(zip(parts, scales, strict=True)):
            names = LETTERS[k * d : (k + 1) * d]
            terms.append((names if d == 1 else f"[{', '.join(names)}]") + f"*{part}")
            factors += [(name, float(f"{self.size / scale:.3g}")) for name in names]
        law = self.law
        return Law(law.joint, law.seam, " + ".join(terms), tuple(factors), law.station, law.count)


def seams_at(robot: Robot) -> list[Law]:
    """Laws with a constant formula at every place that all drivers may act at."""
    vector = (("a", 1e-5), ("b", 1e-5), ("c", 1e-5))
    found = [Law(j, "joint", "a") for j in robot.numbers]
    found += [Law(j, seam, "[a, b, c]", vector) for seam in ("tilt", "shift") for j in robot.numbers]
    # The last link's shift is the tool's, and the foot's is the measuring frame's.
    found = [law for law in found if (law.seam, law.joint) != ("shift", robot.n)]
    found += [Law(None, seam, "[a, b, c]", vector) for seam in ("base tilt", "base shift", "tool shift")]
    return [*found, *([Law(None, "payload", "a", (("a", 0.01),))] if robot.payload else [])]


def stations(robot: Robot) -> list[Law]:
    """Constant laws along the beam of instruments that stand around the robot, and of one at the frame's origin."""
    middle, reach = robot.base.T[:3, 3], robot.reach
    found = [np.zeros(3)]
    for far in DISTANCES:
        for turn in 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
            found.append(middle + reach * np.array([far * np.cos(turn), far * np.sin(turn), 0.5]))
    return [Law(None, "beam", "a", station=_rounded(at)) for at in found]


def _rounded(at: Array) -> tuple[float, float, float]:
    x, y, z = (round(float(v), 3) for v in at)
    return x, y, z


def with_columns(linear: Linearisation, laws: Sequence[Law]) -> list[Seam]:
    """The places with what they do to the measured point."""
    columns = linear.columns(laws)
    edges = np.cumsum([0, *(len(law.sizes()) for law in laws)])
    return [Seam(law, columns[:, :, a:b]) for law, a, b in zip(laws, edges[:-1], edges[1:], strict=True)]


LEAST_SCALE = 1e-3
# Numbers of the rhos at which laws are screened: what is most probable without a law says little of that with it.
SCREENED = (2, 4)
# Nats of a claim: of the score, and above rivals; of laws that are not distinguished.
CLAIMED, ABOVE, ALIKE = 12.0, 3.0, 5.0
MOST_ALIKE = 6


@dataclass(frozen=True, eq=False)
class Tried:
    """One form of one driver at one place, or at several, with all its settings.

    seams : the place; more than one of the beam, whose stations are settings
    x : the driver's values, shape (n,), at each place; form : see `Form`
    """

    seams: tuple[Seam, ...]
    driver: Driver
    form: Form
    x: tuple[Array, ...]

    @cached_property
    def settings(self) -> tuple[Array, ...]:
        """At each place, shape (K, settings)."""
        return tuple(self.form.grid(x) for x in self.x)

    def column(self, seam: int, settings: Array) -> tuple[Law, Array]:
        """The law of these settings, and its columns in units of their sizes, shape (n, 3, w)."""
        place = self.seams[seam]
        values = self.form.values(self.x[seam], settings[None])
        scales = [float(s) for s in scale_of(values)[:, 0]]
        law = place.with_formula(self.form.texts(self.driver.text, settings.tolist()), scales)
        sizes = np.array([size for size, _ in law.sizes().values()])
        if values.ndim > 3:  # of every joint: all factors of the first, then of the next
            each = np.stack([place.columns * v[:, None, :, 0] for v in values], axis=3)
            columns = each.reshape(*each.shape[:2], -1)
        else:
            columns = np.concatenate([place.columns * v[:, None] for v in values], axis=2)
        return law, columns * sizes


@dataclass(frozen=True, eq=False)
class Scored:
    """A law with its most probable settings.

    law : as an effect; tried : what it was selected from; seam, settings : which place and settings of it
    score : see the module; evidence : log evidence of these settings over none
    columns : in units of its sizes, shape (n, 3, w); noise : that it leaves; errors : of the settings, by name
    """

    law: Law
    tried: Tried
    seam: int
    settings: Array
    score: float
    evidence: float
    columns: Array
    noise: Noise
    errors: Array

    @property
    def family(self) -> tuple[str, str]:
        """Place and kind of driver."""
        return self.law.place, self.tried.driver.family


def scale_of(values: Array) -> Array:
    """How much functions vary over poses and joints, shape (parts, K); a constant one, of the base model, a little.

    values : as of `Form.values`
    """
    flat = values.reshape(len(values), -1, values.shape[-1])
    return np.asarray(np.maximum(np.maximum(flat.std(axis=1), 0.1 * np.ptp(flat, axis=1)), LEAST_SCALE))


def scaled(values: Array) -> Array:
    """Functions in units of how much they vary; values : as of `Form.values`."""
    scales = scale_of(values)
    return np.asarray(values / scales.reshape(len(values), *[1] * (values.ndim - 2), -1))


@dataclass(frozen=True, eq=False)
class Round:
    """One comparison of laws with everything else.

    laws : the most probable, the best first; listed, smooth : label and score of the best rivals, refined
    noise : the same of the best form of noise; alias : labels of listed effects whose columns are the best law's
    claimed : whether the best law is claimed
    """

    laws: tuple[Scored, ...]
    listed: tuple[str, float]
    smooth: tuple[str, float]
    noise: tuple[str, float]
    alias: tuple[str, ...]

    @property
    def best(self) -> Scored:
        """The most probable law."""
        return self.laws[0]

    @property
    def alike(self) -> tuple[Scored, ...]:
        """Laws that these data do not tell from the best one."""
        return tuple(s for s in self.laws[1:] if s.score > self.best.score - ALIKE)[:MOST_ALIKE]

    @property
    def claimed(self) -> bool:
        """Whether the best law is claimed."""
        return self.best.score >= CLAIMED and self.best.score >= self.rival[1] + ABOVE and not self.alias

    @property
    def rival(self) -> tuple[str, float]:
        """Label and score of the best of all rivals."""
        return max(self.listed, self.smooth, self.noise, key=lambda found: found[1])


@dataclass(frozen=True, eq=False)
class Problem:
    """What laws are judged on: poses that are no outliers, with what is in the model in the base.

    evidence : without candidates; least : log evidence over none that a law needs to be of interest
    """

    evidence: Evidence
    least: float = 0.0

    @classmethod
    def beside(cls, case: Case, chosen: Array, least: float = 0.0) -> Problem:
        """Of a case; chosen : columns of what is in the model already."""
        base = case.evidence.with_base(chosen)
        return cls(replace(base, E=np.zeros((*base.r.shape, 1)), held=None), least)

    @cached_property
    def log_base(self) -> Array:
        """Log likelihood without a law, shape (rhos, sigmas)."""
        return self.evidence.log_base()

    def grids(self, columns: Sequence[Array]) -> Array:
        """Log likelihood with each law, shape (laws, rhos, sigmas, kappas), sizes weighted."""
        edges = np.cumsum([0, *(c.shape[2] for c in columns)])
        e = replace(self.evidence, E=np.concatenate(columns, axis=2))
        groups = [np.arange(a, b) for a, b in itertools.pairwise(edges)]
        found: Array = e.log_grids(groups) + np.log(KAPPA_WEIGHTS)
        return found

    def evidences(self, columns: Sequence[Array]) -> Array:
        """Exact log evidence over none of each law, shape (laws,)."""
        return self.over_none(self.grids(columns))

    def over_none(self, grids: Array) -> Array:
        """Log evidence over none, shape (laws,); grids : as of `grids`."""
        return np.asarray(log_sum(grids.reshape(len(grids), -1), axis=1) - float(log_sum(self.log_base)))

    @cached_property
    def screens(self) -> list[tuple[float, Screen]]:
        """Screens at the rhos that matter, each with its log share of the evidence without a law."""
        near = list(self.evidence.near)
        by_rho = dict(zip(near, log_sum(self.log_base[near], axis=1), strict=True))
        total = float(log_sum(self.log_base[near]))
        known = [k for k in SCREENED if k in by_rho] or [max(near, key=lambda k: by_rho[k])]
        return [(float(by_rho[k]) - total, Screen.at_rho(self.evidence, k)) for k in known]

    def gains(self, seam: Seam, functions: Array) -> Array:
        """Log evidence of laws at a place, shape (K,); functions : in units of their scales, as of `Form.values`."""
        found = []
        for share, screen in self.screens:
            G, b = screen.products(seam.columns * seam.size, functions)
            found.append(share + screen.gains(G, b, self.least - share))
        return log_mean(np.stack(found))

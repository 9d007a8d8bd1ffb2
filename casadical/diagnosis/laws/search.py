"""Laws at all places by all drivers in all forms, the most probable first, each paying for its size and its search.

The score of a law is its log evidence over none, mean over its settings, less the logarithms of how many forms and how
many places with drivers were tried. Evidence on all settings is that of `screening`; on the best it is exact.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.cross_validation import likely_noise
from casadical.diagnosis.evidence import KAPPA_WEIGHTS, Evidence, log_sum
from casadical.diagnosis.laws.drivers import (
    LARGEST,
    Driver,
    drivers_of,
    own_drivers,
    own_values,
    values_of,
    variables,
    with_columns,
)
from casadical.diagnosis.laws.forms import FINE_WAVE, FORMS, POSES_FOR_FINE, Form, rounded, wave_by
from casadical.diagnosis.laws.screening import Screen, log_mean
from casadical.diagnosis.laws.seams import Seam, seams_at, stations
from casadical.diagnosis.laws.seams import with_columns as at_poses
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.linearisation import Columns, Linearisation
from casadical.effects.formula import parse
from casadical.effects.law import Law
from casadical.measurements.noise import Noise

# Laws whose evidence is computed exactly, and those whose settings are refined.
EXACT, REFINED = 24, 6
LEAST_SCALE = 1e-3
# Numbers of the rhos at which laws are screened: what is most probable without a law says little of that with it.
SCREENED = (2, 4)
# Steps of a refinement, first as shares of the driver's range (of a width: factors), halved when none helps.
FIRST_STEP, HALVINGS, ROUNDS, GAIN = 0.03, 3, 10, 0.1


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
class Problem:
    """What laws are judged on: poses that are no outliers, with what is in the model in the base.

    evidence : without candidates
    """

    evidence: Evidence

    @classmethod
    def of(cls, case: Case, chosen: Array) -> Problem:
        """Of a case; chosen : columns of what is in the model already."""
        base = case.evidence.with_base(chosen)
        return cls(replace(base, E=np.zeros((*base.r.shape, 1)), held=None))

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
        return [(float(by_rho[k]) - total, Screen.of(self.evidence, k)) for k in known]

    def gains(self, seam: Seam, functions: Array) -> Array:
        """Log evidence of laws at a place, shape (K,); functions : in units of their scales, as of `Form.values`."""
        found = []
        for share, screen in self.screens:
            G, b = screen.products(seam.columns * seam.size, functions)
            found.append(share + screen.gains(G, b))
        return log_mean(np.stack(found))


@dataclass(frozen=True, eq=False)
class _Block:
    """Functions of all drivers in forms of so many parts, side by side.

    functions : in units of their scales, as of `Form.values`; edges : where each driver and form begins, and the end
    """

    drivers: tuple[tuple[Driver, Form, Array], ...]
    functions: Array
    edges: Array


def _blocks(drivers: Sequence[tuple[Driver, Array]], forms: dict[str, tuple[Form, ...]]) -> Iterator[_Block]:
    for parts in (1, 2):
        which = [(d, f, x) for d, x in drivers for f in forms[d.kind] if len(f.parts) == parts]
        if not which:
            continue
        values = [f.values(x, f.grid(x)) for _, f, x in which]
        functions = np.concatenate([scaled(v) for v in values], axis=-1)
        yield _Block(tuple(which), functions, np.cumsum([0, *(v.shape[-1] for v in values)]))


def _means(gains: Array, edges: Array) -> Array:
    """Log of the mean over each driver's and form's settings."""
    top = np.maximum.reduceat(gains, edges[:-1])
    counts = np.diff(edges)
    total = np.add.reduceat(np.exp(gains - np.repeat(top, counts)), edges[:-1])
    return np.asarray(top + np.log(total / counts))


@dataclass(frozen=True, eq=False)
class _Rough:
    """A law by its screened evidence: what was tried, which place and settings are best, mean over all of them."""

    tried: Tried
    seam: int
    settings: Array
    best: float
    mean: float


def _of_block(seam: Seam, block: _Block, gains: Array, keep: int) -> list[_Rough]:
    means = _means(gains, block.edges)
    found = []
    for k in np.argsort(-means)[:keep]:
        driver, form, x = block.drivers[k]
        own = gains[block.edges[k] : block.edges[k + 1]]
        best = int(np.argmax(own))
        tried = Tried((seam,), driver, form, (x,))
        found.append(_Rough(tried, 0, form.grid(x)[best], float(own[best]), float(means[k])))
    return found


def _everywhere(problem: Problem, drivers: Sequence[tuple[Driver, Array]], seams: Sequence[Seam]) -> Iterator[_Rough]:
    for block in _blocks(drivers, FORMS):
        for seam in seams:
            some = block
            if seam.law.seam == "payload":
                kept = [d for d in drivers if seam.takes(d[0])]
                own = [b for b in _blocks(kept, FORMS) if len(b.functions) == len(block.functions)]
                if not own:
                    continue
                some = own[0]
            yield from _of_block(seam, some, problem.gains(seam, some.functions), EXACT)


def _fine(problem: Problem, drivers: Sequence[tuple[Driver, Array]], seams: Sequence[Seam]) -> Iterator[_Rough]:
    """Fine waves of each joint over its own angle."""
    if len(problem.evidence.r) < POSES_FOR_FINE:
        return
    own = {d.text: (d, x) for d, x in drivers if d.family == "angle"}
    for seam in seams:
        if seam.law.seam == "joint" and f"q{seam.law.joint}" in own:
            (block,) = _blocks([own[f"q{seam.law.joint}"]], {"angle": (FINE_WAVE,)})
            yield from _of_block(seam, block, problem.gains(seam, block.functions), 1)


def _by_load(problem: Problem, drivers: Sequence[tuple[Driver, Array]], seams: Sequence[Seam]) -> Iterator[_Rough]:
    """Waves of each joint over its own angle whose size follows its load."""
    by_text = {d.text: (d, x) for d, x in drivers}
    for seam in seams:
        names = f"q{seam.law.joint}", f"tau{seam.law.joint}"
        if seam.law.seam in ("joint", "tilt") and all(n in by_text for n in names):
            (driver, x), (_, load) = (by_text[n] for n in names)
            own = replace(driver, family="wave by load")
            (block,) = _blocks([(own, x)], {"angle": (wave_by(names[1], load),)})
            yield from _of_block(seam, block, problem.gains(seam, block.functions), 1)


def _every_joint(problem: Problem, linear: Linearisation, known: Collection[str], seam: Seam) -> Iterator[_Rough]:
    """Laws of all joints at once, each by its own driver with a factor of its own.

    known : names of columns that are there
    """
    drivers = own_drivers()
    of_joint = {n: [f"{n}{j}" for j in linear.robot.numbers] for n in ("q", "tau", "approach", "move")}
    needed = {d: [m for n in parse(d.text).names for m in of_joint.get(n, [n])] for d in drivers}
    drivers = [d for d in drivers if all(n.startswith(("q", "tau")) or n in known for n in needed[d])]
    values = variables(linear, tuple(dict.fromkeys(n for d in drivers for n in needed[d])))
    every = [(d, own_values(linear, values, d)) for d in drivers]
    moving = [(d, x) for d, x in every if x.any() and np.abs(x).max() < LARGEST]  # no load turns an upright axis
    for block in _blocks(moving, FORMS):
        yield from _of_block(seam, block, problem.gains(seam, block.functions), EXACT)


def _along_the_beam(problem: Problem, beams: Sequence[Seam], point: Array) -> Iterator[_Rough]:
    """Laws of the range, whose station is a setting like others."""
    driver = Driver("r", "range", "range")
    x = [np.linalg.norm(point - np.array(b.law.station), axis=1) for b in beams]
    for form in FORMS["range"]:
        gains = []
        for seam, r in zip(beams, x, strict=True):
            (block,) = _blocks([(driver, r)], {"range": (form,)})
            gains.append(problem.gains(seam, block.functions))
        tried = Tried(tuple(beams), driver, form, tuple(x))
        k = int(np.argmax([g.max() for g in gains]))
        best = int(np.argmax(gains[k]))
        whole = np.concatenate(gains)
        mean = float(log_mean(whole) - np.log(len(whole)))
        yield _Rough(tried, k, tried.settings[k][best], float(gains[k][best]), mean)


def _linear(case: Case) -> tuple[Linearisation, list[Driver]]:
    """The robot at the kept poses with the columns of the drivers, and those drivers whose columns were logged."""
    assert isinstance(case.whole.E, Columns)
    m, known = with_columns(case.m, drivers_of(case.given))
    linear = replace(case.whole.E.linear, conditions=dict(m.conditions))
    return linear.at(np.flatnonzero(case.kept)), known


def search_laws(case: Case, chosen: Array, without: frozenset[str] = frozenset()) -> list[Scored]:
    """The most probable laws, the best first; their settings are refined.

    chosen : columns of what is in the model already; without : labels of laws that are in it
    """
    problem = Problem.of(case, chosen)
    linear, known = _linear(case)
    kept, values = values_of(linear, known)
    drivers = list(zip(kept, values.T, strict=True))
    *seams, every = at_poses(linear, [*seams_at(case.given), Law(None, "joints", "a", count=case.given.n)])
    beams = at_poses(linear, stations(case.given))
    rough = [*_everywhere(problem, drivers, seams), *_fine(problem, drivers, seams)]
    rough += _by_load(problem, drivers, seams)
    rough += _every_joint(problem, linear, {n for d in kept for n in parse(d.text).names}, every)
    rough += _along_the_beam(problem, beams, linear.seen[:, :3])
    instances = len(seams) * len(drivers) + 1
    prices = [np.log(instances) + np.log(1 + len(FORMS[r.tried.driver.kind])) for r in rough]
    order = np.argsort([-(r.mean - price) for r, price in zip(rough, prices, strict=True)])
    some = [rough[k] for k in order[:EXACT]]
    made = [r.tried.column(r.seam, r.settings) for r in some]
    grids = problem.grids([columns for _, columns in made])
    exact = problem.over_none(grids)
    scored = [float(e - r.best + r.mean - prices[k]) for e, r, k in zip(exact, some, order, strict=False)]
    found = []
    for rank, k in enumerate(np.argsort([-s for s in scored])):
        if made[k][0].label not in without:
            r, (law, columns) = some[k], made[k]
            errors, noise = np.full(len(r.settings), np.nan), likely_noise(grids[k])
            s = Scored(law, r.tried, r.seam, r.settings, scored[k], float(exact[k]), columns, noise, errors)
            found.append(_refined(problem, s) if rank < REFINED else s)
    return sorted(found, key=lambda s: -s.score)


def _refined(problem: Problem, found: Scored) -> Scored:
    """The law with its settings refined, which raises the score as much as the evidence."""
    if not len(found.settings):
        return found
    settings, better = refined_settings(problem, found.tried, found.seam, found.settings)
    law, columns = found.tried.column(found.seam, settings)
    return replace(
        found,
        law=law,
        settings=settings,
        score=found.score + better - found.evidence,
        evidence=better,
        columns=columns,
        noise=likely_noise(problem.grids([columns])[0]),
        errors=_sigmas(problem, found.tried, found.seam, settings, better),
    )


def _moved(tried: Tried, seam: int, settings: Array, k: int, step: float) -> Array:
    """One setting moved: a width by a factor, a frequency by its share of the range, a position by a share of it."""
    moved, span = settings.copy(), float(np.ptp(tried.x[seam]))
    name = tried.form.settings[k]
    if name == "w" and tried.form.name != "on and off":
        moved[k] *= np.exp(10 * step)
    elif name == "f":
        moved[k] += 10 * step / span
    else:
        moved[k] += step * span
    return rounded(moved)


def refined_settings(
    problem: Problem, tried: Tried, seam: int, settings: Array, poses: Array | slice = slice(None)
) -> tuple[Array, float]:
    """The best settings near these, and their log evidence. poses : of those tried, the problem's."""

    def evidences(trial: Sequence[Array]) -> Array:
        return problem.evidences([tried.column(seam, s)[1][poses] for s in trial])

    if not len(settings):
        return settings, float(evidences([settings])[0])
    evidence = float(evidences([settings])[0])
    step, halved = FIRST_STEP, 0
    for _ in range(ROUNDS):
        near = [_moved(tried, seam, settings, k, s) for k in range(len(settings)) for s in (-step, step)]
        logs = evidences(near)
        best = int(np.argmax(logs))
        if logs[best] > evidence + GAIN:
            settings, evidence = near[best], float(logs[best])
            continue
        step, halved = step / 2, halved + 1
        if halved > HALVINGS:
            break
    return settings, evidence


def _sigmas(problem: Problem, tried: Tried, seam: int, settings: Array, evidence: float) -> Array:
    """One sigma of each setting alone: where the log evidence has fallen by a half, from steps of growing size."""
    found = np.empty(len(settings))
    for k in range(len(settings)):
        steps = np.array([0.003, 0.006, 0.012, 0.025, 0.05, 0.1])
        moved = [_moved(tried, seam, settings, k, s) for s in (*steps, *-steps)]
        logs = problem.evidences([tried.column(seam, n)[1] for n in moved])
        fallen = evidence - np.maximum(logs[: len(steps)], logs[len(steps) :])
        beyond = np.flatnonzero(fallen > 0.5)
        at = int(beyond[0]) if len(beyond) else len(steps) - 1
        found[k] = abs(moved[at][k] - settings[k]) / np.sqrt(max(2 * float(fallen[at]), 1.0))
    return found

"""Laws at all places by all drivers in all forms, the most probable first, each paying for its size and its search.

The score of a law is its log evidence over none, mean over its settings, less the logarithms of how many forms and how
many places with drivers were tried. Evidence on all settings is that of `screening`; on the best it is exact.
Settings of those that are kept are refined by steps of shrinking size.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import first_of_best, ranked
from casadical.diagnosis.cross_validation import likely_noise
from casadical.diagnosis.laws.forms import (
    FINE_WAVE,
    FORMS,
    LARGEST,
    LAST_RESORT,
    POSES_FOR_FINE,
    WARM,
    Driver,
    Form,
    drivers_of,
    own_drivers,
    own_values,
    rounded,
    values_of,
    variables,
    wave_by,
    wave_plus,
    with_columns,
)
from casadical.diagnosis.laws.problem import NEVER, Problem, Scored, Seam, Tried, log_mean, scaled, seams_at, stations
from casadical.diagnosis.laws.problem import with_columns as at_poses
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.linearisation import EffectColumns, Linearisation
from casadical.effects.formula import parse
from casadical.effects.formula_effect import HEAD, Law, head_column
from casadical.measurements.derived_columns import derive
from casadical.robot.robot import Robot

# What a law pays that can follow anything that varied with time, where the driver itself may be there.
TIME_PRICE = 5.0
# Laws whose evidence is computed exactly, and those whose settings are refined.
EXACT, REFINED = 24, 6
# Nats that refined settings gain at most over those that are tried first, beyond what a law pays.
UNREFINED = 10.0


@dataclass(frozen=True, eq=False)
class _Block:
    """Functions of all drivers in forms of so many parts, side by side.

    drivers : each with a form, its values, and the form's settings
    functions : in units of their scales, as of `Form.values`; edges : where each driver and form begins, and the end
    """

    drivers: tuple[tuple[Driver, Form, Array, Array], ...]
    functions: Array
    edges: Array


def _blocks(drivers: Sequence[tuple[Driver, Array]], forms: dict[str, tuple[Form, ...]]) -> Iterator[_Block]:
    for parts in (1, 2):
        which = [(d, f, x, f.grid(x)) for d, x in drivers for f in forms[d.kind] if len(f.parts) == parts]
        if not which:
            continue
        values = [f.values(x, settings) for _, f, x, settings in which]
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
    rough = []
    for k in ranked(means, logs=True)[:keep]:
        driver, form, x, settings = block.drivers[k]
        own = gains[block.edges[k] : block.edges[k + 1]]
        best = first_of_best(own, logs=True)
        tried = Tried((seam,), driver, form, (x,))
        rough.append(_Rough(tried, 0, settings[best], float(own[best]), float(means[k])))
    return rough


def _everywhere(problem: Problem, drivers: Sequence[tuple[Driver, Array]], seams: Sequence[Seam]) -> Iterator[_Rough]:
    for block in _blocks([d for d in drivers if d[0].kind != "weighted"], FORMS):
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


def _joined_waves(problem: Problem, drivers: Sequence[tuple[Driver, Array]], seams: Sequence[Seam]) -> Iterator[_Rough]:
    """Waves of each joint over its own angle whose size follows load, moment or warmth, or whose phase the load does,
    and over sums of its own and a neighbour's angle with unequal weights.
    """
    by_text = {d.text: (d, x) for d, x in drivers}
    weighted = [d for d in drivers if d[0].kind == "weighted"]
    for seam in seams:
        j = seam.law.joint
        if seam.law.seam == "joint":
            for block in _blocks([d for d in weighted if f"q{j}" in parse(d[0].text).names], FORMS):
                yield from _of_block(seam, block, problem.gains(seam, block.functions), EXACT)
        if seam.law.seam not in ("joint", "tilt") or f"q{j}" not in by_text:
            continue
        driver, x = by_text[f"q{j}"]
        forms = [wave_by(n, by_text[n][1]) for n in (f"tau{j}", f"m{j}x", f"m{j}y", WARM) if n in by_text]
        forms += [wave_plus(n, by_text[n][1]) for n in (f"tau{j}",) if n in by_text]
        for form in forms:
            own = replace(driver, family="wave by load" if f"tau{j}" in form.name else form.name)
            (block,) = _blocks([(own, x)], {"angle": (form,)})
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


def _by_the_beam(problem: Problem, linear: Linearisation, robot: Robot) -> Iterator[_Rough]:
    """Laws of the beam and of the head that turns it, of an instrument whose station is a setting like others."""
    places = stations(robot)
    turns = all(head_column(at) in linear.conditions for at in places)
    for seam, drivers in _OF_BEAM.items():
        beams = at_poses(linear, [Law(None, seam, "a", station=at) for at in places])
        for text, kind in drivers.items() if turns else ((t, k) for t, k in drivers.items() if HEAD not in t):
            yield from _at_stations(problem, linear, beams, Driver(text, kind, "head" if kind == "linear" else kind))


def _at_stations(problem: Problem, linear: Linearisation, beams: Sequence[Seam], driver: Driver) -> Iterator[_Rough]:
    """One driver's laws, each of all stations together."""
    of_driver = linear.columns([replace(b.law, formula=f"a*{driver.text}") for b in beams])
    units = [b.columns for b in beams]
    x = [
        (of_driver[:, :, k] * unit[:, :, 0]).sum(axis=1) / (unit[:, :, 0] ** 2).sum(axis=1)
        for k, unit in enumerate(units)
    ]
    for form in FORMS[driver.kind]:
        tried = Tried(tuple(beams), driver, form, tuple(x))
        functions = [scaled(form.values(v, s)) for v, s in zip(x, tried.settings, strict=True)]
        columns = [u[..., None] * f.transpose(1, 0, 2)[:, None] for u, f in zip(units, functions, strict=True)]
        gains = problem.gains_of(beams[0].size * np.concatenate(columns, axis=3))
        each = np.split(gains, np.cumsum([len(s) for s in tried.settings])[:-1])
        k = first_of_best([g.max() for g in each], logs=True)
        best = first_of_best(each[k], logs=True)
        mean = float(log_mean(gains) - np.log(len(gains)))
        yield _Rough(tried, k, tried.settings[k][best], float(each[k][best]), mean)


def _linear(case: Case) -> tuple[Linearisation, list[Driver]]:
    """The robot at the kept poses with the columns of the drivers, and those drivers whose columns were logged."""
    assert isinstance(case.whole.E, EffectColumns)
    m, known = with_columns(case.m, drivers_of(case.given), case.given.loads)
    m, _ = derive(m, map(head_column, stations(case.given)))
    linear = replace(case.whole.E.linear, conditions=dict(m.conditions))
    return linear.at(np.flatnonzero(case.kept)), known


def _last(tried: Tried) -> float:
    """The price of a law that is the last resort."""
    return TIME_PRICE if tried.driver.kind == "time" and tried.form in LAST_RESORT else 0.0


def search_laws(case: Case, chosen: Array, without: frozenset[str] = frozenset(), least: float = 0.0) -> list[Scored]:
    """The most probable laws, the best first; their settings are refined.

    chosen : columns of what is in the model already; without : labels of laws that are in it
    least : score that a law needs to be of interest; others may be left out, all of them, too
    """
    # A score is refined evidence less its price: settings that are not the best yet may be as far below.
    problem = Problem.beside(case, chosen, least - UNREFINED)
    linear, known = _linear(case)
    kept, values = values_of(linear, known)
    drivers = list(zip(kept, values.T, strict=True))
    *seams, every = at_poses(linear, [*seams_at(case.given), Law(None, "joints", "a", count=case.given.n)])
    of_instrument = all(m.position is not None for m in case.observations.sets)  # what touches a robot has no beam
    rough = [*_everywhere(problem, drivers, seams), *_fine(problem, drivers, seams)]
    joined = [*_joined_waves(problem, drivers, seams)]
    rough += joined
    rough += _every_joint(problem, linear, {n for d in kept for n in parse(d.text).names}, every)
    if of_instrument:
        rough += _by_the_beam(problem, linear, case.given)
    instances = len(seams) * len(drivers) + len(joined) + 1
    rough = [r for r in rough if r.mean > NEVER / 2]
    prices = [np.log(instances) + np.log(1 + len(FORMS[r.tried.driver.kind])) + _last(r.tried) for r in rough]
    order = ranked([r.mean - price for r, price in zip(rough, prices, strict=True)], logs=True)
    some = [rough[k] for k in order[:EXACT]]
    if not some:
        return []
    made = [r.tried.column(r.seam, r.settings) for r in some]
    grids = problem.grids([columns for _, columns in made])
    exact = problem.over_none(grids)
    scored = [float(e - r.best + r.mean - prices[k]) for e, r, k in zip(exact, some, order, strict=False)]
    laws = []
    for rank, k in enumerate(ranked(scored, logs=True)):
        if made[k][0].label not in without:
            r, (law, columns) = some[k], made[k]
            errors, noise = np.full(len(r.settings), np.nan), likely_noise(grids[k])
            s = Scored(law, r.tried, r.seam, r.settings, scored[k], float(exact[k]), columns, noise, errors)
            laws.append(refined(problem, s) if rank < REFINED else s)
    return [laws[k] for k in ranked([s.score for s in laws], logs=True)]


# Steps of a refinement, first as shares of the driver's range (of a width: factors), halved when none helps.
FIRST_STEP, HALVINGS, ROUNDS, GAIN = 0.03, 3, 10, 0.1


def refined(problem: Problem, found: Scored) -> Scored:
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
        noise=likely_noise(problem.grids([columns])[0], problem.evidence.sigmas),
        errors=_sigmas(problem, found.tried, found.seam, settings, better),
    )


def _moved(tried: Tried, seam: int, settings: Array, k: int, step: float) -> Array:
    """One setting moved: a width by a factor, a frequency by its share of the range, a position by a share of it."""
    moved, span = settings.copy(), float(np.ptp(tried.x[seam]))
    name = tried.form.settings[k]
    if name == "w" and tried.form.name not in ("on and off", "levels"):
        moved[k] *= np.exp(10 * step)
    elif name == "p":
        moved[k] += 20 * step
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
        best = first_of_best(logs, logs=True)
        if logs[best] > evidence + GAIN:
            settings, evidence = near[best], float(logs[best])
            continue
        step, halved = step / 2, halved + 1
        if halved > HALVINGS:
            break
    return settings, evidence


def _sigmas(problem: Problem, tried: Tried, seam: int, settings: Array, evidence: float) -> Array:
    """One sigma of each setting alone: where the log evidence has fallen by a half, from steps of growing size."""
    sigmas = np.empty(len(settings))
    for k in range(len(settings)):
        steps = np.array([0.003, 0.006, 0.012, 0.025, 0.05, 0.1])
        moved = [_moved(tried, seam, settings, k, s) for s in (*steps, *-steps)]
        logs = problem.evidences([tried.column(seam, n)[1] for n in moved])
        fallen = evidence - np.maximum(logs[: len(steps)], logs[len(steps) :])
        beyond = np.flatnonzero(fallen > 0.5)
        at = int(beyond[0]) if len(beyond) else len(steps) - 1
        sigmas[k] = abs(moved[at][k] - settings[k]) / np.sqrt(max(2 * float(fallen[at]), 1.0))
    return sigmas

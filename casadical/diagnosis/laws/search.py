"""Laws at all places by all drivers in all forms, the most probable first, each paying for its size and its search.

The score of a law is its log evidence over none, mean over its settings, less the logarithms of how many forms and how
many places with drivers were tried. Evidence on all settings is that of `screening`; on the best it is exact.
Settings of those that are kept are refined by steps of shrinking size.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import first_of_best, ranked
from casadical.diagnosis.cross_validation import likely_noise
from casadical.diagnosis.laws.beams import by_the_beam, stations
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
from casadical.diagnosis.laws.problem import NEVER, Problem, Rough, Scored, Seam, Tried, scaled, seams_at
from casadical.diagnosis.laws.problem import with_columns as at_poses
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.linearisation import EffectColumns, Linearisation
from casadical.effects.formula import parse
from casadical.effects.formula_effect import Law, head_column
from casadical.measurements.derived_columns import derive

# Laws whose evidence is computed exactly, those whose settings are refined, and those whose place is moved in any case.
EXACT, REFINED, PLACED = 24, 6, 4
# Nats that refined settings gain at most over those that are tried first, beyond what a law pays; with its place.
UNREFINED, UNPLACED = 10.0, 40.0


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


def _of_block(seam: Seam, block: _Block, gains: Array, keep: int) -> list[Rough]:
    means = _means(gains, block.edges)
    rough = []
    for k in ranked(means, logs=True)[:keep]:
        driver, form, x, settings = block.drivers[k]
        own = gains[block.edges[k] : block.edges[k + 1]]
        best = first_of_best(own, logs=True)
        tried = Tried((seam,), driver, form, (x,))
        rough.append(Rough(tried, 0, settings[best], float(own[best]), float(means[k])))
    return rough


def _everywhere(problem: Problem, drivers: Sequence[tuple[Driver, Array]], seams: Sequence[Seam]) -> Iterator[Rough]:
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


def _fine(problem: Problem, drivers: Sequence[tuple[Driver, Array]], seams: Sequence[Seam]) -> Iterator[Rough]:
    """Fine waves of each joint over its own angle."""
    if len(problem.evidence.r) < POSES_FOR_FINE:
        return
    own = {d.text: (d, x) for d, x in drivers if d.family == "angle"}
    for seam in seams:
        if seam.law.seam == "joint" and f"q{seam.law.joint}" in own:
            (block,) = _blocks([own[f"q{seam.law.joint}"]], {"angle": (FINE_WAVE,)})
            yield from _of_block(seam, block, problem.gains(seam, block.functions), 1)


def _joined_waves(problem: Problem, drivers: Sequence[tuple[Driver, Array]], seams: Sequence[Seam]) -> Iterator[Rough]:
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


def _every_joint(problem: Problem, linear: Linearisation, known: Collection[str], seam: Seam) -> Iterator[Rough]:
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


def _linear(case: Case) -> tuple[Linearisation, list[Driver]]:
    """The robot at the kept poses with the columns of the drivers, and those drivers whose columns were logged."""
    assert isinstance(case.whole.E, EffectColumns)
    m, known = with_columns(case.m, drivers_of(case.given), case.given.loads)
    m, _ = derive(m, map(head_column, stations(case.given)))
    linear = replace(case.whole.E.linear, conditions=dict(m.conditions))
    return linear.at(np.flatnonzero(case.kept)), known


def _last(tried: Tried) -> float:
    """The price of a law that is the last resort."""
    # What a law pays that can follow anything that varied with time, where the driver itself may be
    # there.
    return 5.0 if tried.driver.kind == "time" and tried.form in LAST_RESORT else 0.0


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
        rough += by_the_beam(Problem.beside(case, chosen, least - UNPLACED), linear, case.given)
    instances = len(seams) * len(drivers) + len(joined) + 1
    rough = [r for r in rough if r.mean > NEVER / 2]
    prices = [np.log(instances) + np.log(1 + len(FORMS[r.tried.driver.kind])) + _last(r.tried) for r in rough]
    order = ranked([r.mean - price for r, price in zip(rough, prices, strict=True)], logs=True)
    order = [*order[:EXACT], *[k for k in order[EXACT:] if rough[k].tried.nearby][:PLACED]]
    some = [rough[k] for k in order]
    if not some:
        return []
    made = [r.tried.column(r.seam, r.settings) for r in some]
    grids = problem.grids([columns for _, columns in made])
    exact = problem.over_none(grids)
    scored = [float(e - r.best + r.mean - prices[k]) for e, r, k in zip(exact, some, order, strict=True)]
    best = ranked(scored, logs=True)
    closely = {*best[:REFINED], *[k for k in best if some[k].tried.nearby][:PLACED]}
    laws = []
    for k in best:
        if made[k][0].label not in without:
            r, (law, columns) = some[k], made[k]
            errors, noise = np.full(len(r.settings), np.nan), likely_noise(grids[k])
            s = Scored(law, r.tried, r.seam, r.settings, scored[k], float(exact[k]), columns, noise, errors)
            laws.append(refined(problem, s) if k in closely else s)
    return [laws[k] for k in ranked([s.score for s in laws], logs=True)]


# Steps of a refinement, first as shares of the driver's range (of a width: factors; of an instrument's station: angles
# about the robot), halved when none helps.
FIRST_STEP, HALVINGS, ROUNDS, GAIN = 0.03, 3, 10, 0.1


def refined(problem: Problem, found: Scored) -> Scored:
    """The law with its settings refined, which raises the score as much as the evidence; a place that is moved pays."""
    if not len(found.settings) and not found.tried.nearby:
        return found
    (tried, seam, settings), better = refined_settings(problem, found.tried, found.seam, found.settings)
    law, columns = tried.column(seam, settings)
    more = better - found.evidence
    # Nats that a law pays for a place that is moved: three coordinates and a direction, which gain
    # as much in noise alone.
    return replace(
        found,
        law=law,
        tried=tried,
        seam=seam,
        settings=settings,
        score=found.score + (more if seam == found.seam else max(more - 4.0, 0.0)),
        evidence=better,
        columns=columns,
        noise=likely_noise(problem.grids([columns])[0], problem.evidence.sigmas),
        errors=_sigmas(problem, tried, seam, settings, better),
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


# What a law's settings are: of what was tried the number of the place, and the form's.
Chosen: TypeAlias = tuple[Tried, int, Array]


def refined_settings(
    problem: Problem, tried: Tried, seam: int, settings: Array, poses: Array | slice = slice(None)
) -> tuple[Chosen, float]:
    """The best settings near these, and their log evidence. poses : of those tried, the problem's."""

    def evidences(trial: Sequence[Chosen]) -> Array:
        return problem.evidences([of.column(place, s)[1][poses] for of, place, s in trial])

    best: Chosen = (tried, seam, settings)
    evidence = float(evidences([best])[0])
    step, halved = FIRST_STEP, 0
    # Rounds where a station is moved, too: it has three coordinates.
    for _ in range(30 if tried.nearby else ROUNDS if len(settings) else 0):
        of, place, s = best
        near: list[Chosen] = [(of, place, _moved(of, place, s, k, d)) for k in range(len(s)) for d in (-step, step)]
        near += [(other, len(other.seams) - 1, s) for other in of.beside(place, step)]
        logs = evidences(near)
        first = first_of_best(logs, logs=True)
        if logs[first] > evidence + GAIN:
            best, evidence = near[first], float(logs[first])
            continue
        step, halved = step / 2, halved + 1
        if halved > HALVINGS:
            break
    return best, evidence


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

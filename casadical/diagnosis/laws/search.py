"""Search for laws (expressions of errors) at all places, by all drivers, in all forms.

Laws are ranked by their score: the log evidence over none, the mean over its settings, less the
logarithms of the numbers of forms, and of places with drivers, that were tried. The evidence of all
settings is screened (see `problem.Screen`); that of the best ones is exact. The settings of the
best laws are refined by steps of shrinking size.
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
    DEFAULT_WARMTH,
    FORMS,
    FORMS_BY_KIND,
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
from casadical.diagnosis.laws.problem import (
    NOT_JUDGED_LOG_EVIDENCE,
    InsertionPoint,
    Problem,
    ScoredLaw,
    ScreenedLaw,
    TriedLaws,
    scaled,
    seams_at,
)
from casadical.diagnosis.laws.problem import with_columns as at_poses
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.linearisation import EffectColumns, Linearisation
from casadical.diagnosis.settings import SETTINGS
from casadical.effects.formula import parse
from casadical.effects.formula_effect import Law, head_column
from casadical.measurements.derived_columns import derive


@dataclass(frozen=True, eq=False)
class _Block:
    """Values of the functions of drivers in forms with equal numbers of parts, concatenated.

    drivers : each driver with a form, the driver's values, shape (n,), and the form's settings,
        shape (K, settings)
    functions : values of `Form.values` divided by their scales, all K along the last axis
    edges : index of the first function of each driver and form, and the number of functions
    """

    drivers: tuple[tuple[Driver, Form, Array, Array], ...]
    functions: Array
    edges: Array


def _blocks(drivers: Sequence[tuple[Driver, Array]], forms: dict[str, tuple[Form, ...]]) -> Iterator[_Block]:
    """Yield the block of all forms with one part, then that with two.

    drivers : each with its values, shape (n,); forms : by kind of driver
    """
    for parts in (1, 2):
        which = [(d, f, x, f.grid(x)) for d, x in drivers for f in forms[d.kind] if len(f.parts) == parts]
        if not which:
            continue
        values = [f.values(x, settings) for _, f, x, settings in which]
        functions = np.concatenate([scaled(v) for v in values], axis=-1)
        yield _Block(tuple(which), functions, np.cumsum([0, *(v.shape[-1] for v in values)]))


def _means(gains: Array, edges: Array) -> Array:
    """Return the log of the mean evidence over the settings of each driver and form [nats].

    gains : log evidence of each function; edges : see `_Block`
    """
    top = np.maximum.reduceat(gains, edges[:-1])
    counts = np.diff(edges)
    total = np.add.reduceat(np.exp(gains - np.repeat(top, counts)), edges[:-1])
    return np.asarray(top + np.log(total / counts))


def _screened_in_block(seam: InsertionPoint, block: _Block, gains: Array, keep: int) -> list[ScreenedLaw]:
    """Return the best laws of a block at a place by mean evidence over settings, at most `keep`.

    gains : log evidence of each function of the block [nats]
    """
    means = _means(gains, block.edges)
    rough = []
    for k in ranked(means, logs=True)[:keep]:
        driver, form, x, settings = block.drivers[k]
        own = gains[block.edges[k] : block.edges[k + 1]]
        best = first_of_best(own, logs=True)
        tried = TriedLaws((seam,), driver, form, (x,))
        rough.append(ScreenedLaw(tried, 0, settings[best], float(own[best]), float(means[k])))
    return rough


def _everywhere(
    problem: Problem, drivers: Sequence[tuple[Driver, Array]], seams: Sequence[InsertionPoint]
) -> Iterator[ScreenedLaw]:
    """Yield, for each place, the best laws of all drivers in all forms by screened evidence.

    drivers : each with its values, shape (n,); seams : the places
    """
    for block in _blocks([d for d in drivers if d[0].kind != "weighted"], FORMS_BY_KIND):
        for seam in seams:
            some = block
            if seam.law.seam == "payload":
                allowed = [d for d in drivers if seam.takes(d[0])]
                own = [b for b in _blocks(allowed, FORMS_BY_KIND) if len(b.functions) == len(block.functions)]
                if not own:
                    continue
                some = own[0]
            yield from _screened_in_block(seam, some, problem.gains(seam, some.functions), SETTINGS.max_exact_laws)


def _fine(
    problem: Problem, drivers: Sequence[tuple[Driver, Array]], seams: Sequence[InsertionPoint]
) -> Iterator[ScreenedLaw]:
    """Yield the best fine wave of each joint over its own angle; none for less than 50 poses."""
    if len(problem.evidence.r) < 50:  # fewer poses do not determine fine waves
        return
    own = {d.text: (d, x) for d, x in drivers if d.family == "angle"}
    for seam in seams:
        if seam.law.seam == "joint" and f"q{seam.law.joint}" in own:
            (block,) = _blocks([own[f"q{seam.law.joint}"]], {"angle": (FORMS["fine wave"],)})
            yield from _screened_in_block(seam, block, problem.gains(seam, block.functions), 1)


def _joined_waves(
    problem: Problem, drivers: Sequence[tuple[Driver, Array]], seams: Sequence[InsertionPoint]
) -> Iterator[ScreenedLaw]:
    """Yield the best waves of each joint that depend on two drivers.

    The amplitude is proportional to load, moment or warmth, or the phase is linear in the load; or
    the wave is over a weighted sum of the joint's own angle and a neighbour's.
    """
    by_text = {d.text: (d, x) for d, x in drivers}
    weighted = [d for d in drivers if d[0].kind == "weighted"]
    for seam in seams:
        j = seam.law.joint
        if seam.law.seam == "joint":
            for block in _blocks([d for d in weighted if f"q{j}" in parse(d[0].text).names], FORMS_BY_KIND):
                yield from _screened_in_block(
                    seam, block, problem.gains(seam, block.functions), SETTINGS.max_exact_laws
                )
        if seam.law.seam not in ("joint", "tilt") or f"q{j}" not in by_text:
            continue
        driver, x = by_text[f"q{j}"]
        forms = [wave_by(n, by_text[n][1]) for n in (f"tau{j}", f"m{j}x", f"m{j}y", DEFAULT_WARMTH) if n in by_text]
        forms += [wave_plus(n, by_text[n][1]) for n in (f"tau{j}",) if n in by_text]
        for form in forms:
            own = replace(driver, family="wave by load" if f"tau{j}" in form.name else form.name)
            (block,) = _blocks([(own, x)], {"angle": (form,)})
            yield from _screened_in_block(seam, block, problem.gains(seam, block.functions), 1)


def _every_joint(
    problem: Problem, linear: Linearisation, known: Collection[str], seam: InsertionPoint
) -> Iterator[ScreenedLaw]:
    """Yield the best laws of all joints at once, each joint with its own driver and factor.

    known : names in formulas whose columns are available; seam : the place "joints"
    """
    drivers = own_drivers()
    of_joint = {n: [f"{n}{j}" for j in linear.robot.numbers] for n in ("q", "tau", "approach", "move")}
    needed = {d: [m for n in parse(d.text).names for m in of_joint.get(n, [n])] for d in drivers}
    drivers = [d for d in drivers if all(n.startswith(("q", "tau")) or n in known for n in needed[d])]
    values = variables(linear, tuple(dict.fromkeys(n for d in drivers for n in needed[d])))
    every = [(d, own_values(linear, values, d)) for d in drivers]
    moving = [
        (d, x) for d, x in every if x.any() and np.abs(x).max() < SETTINGS.max_driver_value
    ]  # no load turns an upright axis
    for block in _blocks(moving, FORMS_BY_KIND):
        yield from _screened_in_block(seam, block, problem.gains(seam, block.functions), SETTINGS.max_exact_laws)


def search_laws(
    case: Case, chosen: Array, without: frozenset[str] = frozenset(), least: float = 0.0
) -> list[ScoredLaw]:
    """Return the laws of highest score, the best first; the best ones have refined settings.

    chosen : indices of the columns in the model; without : labels of laws in it
    least : score [nats] that a law needs to be of interest; others may be omitted, even all
    """
    # A score is refined evidence less its price. Refining a law's settings raises it by 10 nats at
    # most, and refining its station, too, by 40 nats.
    problem = Problem.of_case(case, chosen, least - 10.0)
    assert isinstance(case.whole.E, EffectColumns)
    m, available = with_columns(case.m, drivers_of(case.given), case.given.loads)
    m, _ = derive(m, map(head_column, stations(case.given)))
    linear = replace(case.whole.E.linear, conditions=dict(m.conditions)).at(np.flatnonzero(case.inliers))
    varying, values = values_of(linear, available)
    drivers = list(zip(varying, values.T, strict=True))
    *seams, every = at_poses(linear, [*seams_at(case.given), Law(None, "joints", "a", count=case.given.n)])
    of_instrument = all(m.position is not None for m in case.observations.sets)  # what touches a robot has no beam
    rough = [*_everywhere(problem, drivers, seams), *_fine(problem, drivers, seams)]
    joined = [*_joined_waves(problem, drivers, seams)]
    rough += joined
    rough += _every_joint(problem, linear, {n for d in varying for n in parse(d.text).names}, every)
    if of_instrument:
        rough += by_the_beam(Problem.of_case(case, chosen, least - 40.0), linear, case.given)
    instances = len(seams) * len(drivers) + len(joined) + 1
    rough = [r for r in rough if r.mean > NOT_JUDGED_LOG_EVIDENCE / 2]
    # These forms of time can follow anything that varied during the measurement: they pay 5 nats, since
    # the driver itself may be among the candidates.
    last = ("bump", "on and off", "cycle")
    last_resorts = [r.tried.driver.kind == "time" and r.tried.form.name in last for r in rough]
    prices = [
        np.log(instances) + np.log(1 + len(FORMS_BY_KIND[r.tried.driver.kind])) + 5.0 * last_resort
        for r, last_resort in zip(rough, last_resorts, strict=True)
    ]
    order = ranked([r.mean - price for r, price in zip(rough, prices, strict=True)], logs=True)
    order, rest = order[: SETTINGS.max_exact_laws], order[SETTINGS.max_exact_laws :]
    order += [k for k in rest if rough[k].tried.nearby][: SETTINGS.min_moved_laws]
    some = [rough[k] for k in order]
    if not some:
        return []
    made = [r.tried.column(r.seam, r.settings) for r in some]
    grids = problem.grids([columns for _, columns in made])
    exact = problem.over_none(grids)
    scored = [float(e - r.best + r.mean - prices[k]) for e, r, k in zip(exact, some, order, strict=True)]
    best = ranked(scored, logs=True)
    # The settings of the six best laws by exact evidence are refined.
    closely = {*best[:6], *[k for k in best if some[k].tried.nearby][: SETTINGS.min_moved_laws]}
    laws = []
    for k in best:
        if made[k][0].label not in without:
            r, (law, columns) = some[k], made[k]
            errors, noise = np.full(len(r.settings), np.nan), likely_noise(grids[k])
            s = ScoredLaw(law, r.tried, r.seam, r.settings, scored[k], float(exact[k]), columns, noise, errors)
            laws.append(refined(problem, s) if k in closely else s)
    return [laws[k] for k in ranked([s.score for s in laws], logs=True)]


def refined(problem: Problem, found: ScoredLaw) -> ScoredLaw:
    """Return the law with settings and place of more evidence; its score rises by the same.

    For a moved place the increase is 4 nats less, but not negative.
    """
    if not len(found.settings) and not found.tried.nearby:
        return found
    (tried, seam, settings), better = refined_settings(problem, found.tried, found.seam, found.settings)
    law, columns = tried.column(seam, settings)
    more = better - found.evidence
    # A moved place pays 4 nats, the gain of its coordinates and direction in noise alone.
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


def _moved(tried: TriedLaws, seam: int, settings: Array, k: int, step: float) -> Array:
    """Return a law's settings with the one of index k changed by a step, rounded.

    A width w is multiplied by exp(10 step); a frequency f changes by 10 step divided by the range
    of the driver, a phase rate p by 20 step, others by step times the range.
    seam : index of the law's place
    """
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


# One law: the laws that were tried, the index of its place in these, and its settings.
Chosen: TypeAlias = tuple[TriedLaws, int, Array]


def refined_settings(
    problem: Problem, tried: TriedLaws, seam: int, settings: Array, poses: Array | slice = slice(None)
) -> tuple[Chosen, float]:
    """Return the best settings and place near given ones, and their log evidence over none [nats].

    seam : index of the place; settings : given settings
    poses : indices of the problem's poses among those of `tried`
    """

    def evidences(trial: Sequence[Chosen]) -> Array:
        """Return the exact log evidence over none of each law, shape (len(trial),) [nats]."""
        return problem.evidences([of.column(place, s)[1][poses] for of, place, s in trial])

    best: Chosen = (tried, seam, settings)
    evidence = float(evidences([best])[0])
    # The first step is a fraction of the driver's range (see `_moved` for other settings).
    step, halved = 0.03, 0
    # 30 rounds where a station with three coordinates is moved, too.
    for _ in range(30 if tried.nearby else 10 if len(settings) else 0):
        of, place, s = best
        near: list[Chosen] = [(of, place, _moved(of, place, s, k, d)) for k in range(len(s)) for d in (-step, step)]
        near += [(other, len(other.seams) - 1, s) for other in of.with_moved_place(place, step)]
        logs = evidences(near)
        first = first_of_best(logs, logs=True)
        if logs[first] > evidence + 0.1:
            best, evidence = near[first], float(logs[first])
            continue
        step, halved = step / 2, halved + 1
        if halved > 3:
            break
    return best, evidence


def _sigmas(problem: Problem, tried: TriedLaws, seam: int, settings: Array, evidence: float) -> Array:
    """Return the standard error of each setting, from the decrease of the log evidence about it.

    A setting that differs by it has 0.5 nats less, for a parabola through the steps evaluated.
    evidence : log evidence at the settings [nats]; seam : index of the place
    """
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

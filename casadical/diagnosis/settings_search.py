"""Settings in which a cause is not linear (knee, lag, cycles, time of a step), between the grid's points, and the size
of an effect's parts, learnt from the data: marginal likelihood, by MacKay's fixed point.

A part's variance is set to the mean square of its parameters over the share of them that the data determine; the noise
variance too. A part that the data do not determine keeps its size. (MacKay 1992, Bayesian interpolation, sec. 4.)
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.normal_equations import root_of_inverse
from casadical.core.statistics import first_of_best
from casadical.diagnosis.cross_validation import new_fit
from casadical.diagnosis.evidence import KAPPA_WEIGHTS, Evidence
from casadical.diagnosis.linear_problem import Case
from casadical.effects import Effect
from casadical.measurements.measurements import Noise

# Steps are halved once none of them helps, so often at most; a gain of log evidence below the second is none.
MAX_HALVINGS, MIN_SETTING_GAIN, MAX_SETTING_ROUNDS = 2, 0.3, 10
# Whole numbers are looked at within this share of a fraction; they may have so much less log evidence, and a setting
# that is tried beside them must bring so much. Steps at which it is refined.
WHOLE_NUMBER_RANGE, WHOLE_NUMBER_BONUS, TRIED_SETTING_PRICE = 0.12, 2.0, 5.0
FINE_STEPS = (0.0, -0.6, -0.3, 0.3, 0.6)
# Log evidences that differ by less are equal: a step between two poses fits alike wherever it lies between them.
EQUAL_LOG_EVIDENCE = 1e-6
# Of learning sizes: rounds at most, and the change of a logarithm that is none.
MAX_SIZE_ROUNDS, SIZE_TOLERANCE = 8, 0.05
# A part of which the data determine less than this many parameters is left as it is.
MIN_DETERMINED_PARAMETERS = 1.0
MIN_SIZE_FACTOR, MAX_SIZE_FACTOR = 0.05, 8.0


def neighbours(effect: Effect, fineness: float) -> list[Effect]:
    """The effect with one setting moved by a fraction of the grid's spacing, each in turn (see `Effect`)."""
    effects = []
    for f in fields(effect):
        value = getattr(effect, f.name)
        if not isinstance(value, float) or f.metadata.get("given"):
            continue
        if f.metadata.get("steps"):
            first, second = f.metadata["grid"][:2]
            moved = [value + step * fineness * (second - first) for step in (-0.67, -0.33, 0.33, 0.67)]
        else:
            moved = [value * float(np.exp(step * fineness)) for step in (-0.5, -0.25, 0.25, 0.5)]
        effects += [_with(effect, **{f.name: v}) for v in moved if v > 0 or (v and f.metadata.get("signed"))]
    return effects


def _with(effect: Effect, **settings: Any) -> Effect:
    """The effect with other settings."""
    return replace(effect, **settings)


def refined(
    case: Case, label: str, variant: tuple[Effect, ...], chosen: Array, noise: Noise
) -> tuple[Case, tuple[Effect, ...]]:
    """The case with the best settings found near a variant, and these settings.

    chosen : columns of causes that are in the model already; noise : that is left with the variant
    """
    if len(variant) != 1:
        return case, variant
    if variant[0].parts:
        learnt = learnt_sizes(case.judged, case.group(variant), variant[0].parts, chosen, noise)
        case, effect = case.with_sizes(variant[0], *learnt)
        return case, (effect,)
    halved = 0
    for _ in range(MAX_SETTING_ROUNDS):
        trial: list[tuple[Effect, ...]] = [variant, *((e,) for e in neighbours(variant[0], 0.5**halved))]
        if len(trial) == 1:
            break
        case = case.with_variants(label, trial[1:])
        log = _log_evidence(case, trial, chosen)
        best = _best(case, trial, log, chosen)
        if log[best] - log[0] < MIN_SETTING_GAIN:
            halved += 1
        variant = trial[best]
        if halved == MAX_HALVINGS:
            break
    case, effect = _between_poses(case, label, variant[0])
    return _with_probable_settings(case, label, effect, chosen)


def _between_poses(case: Case, label: str, effect: Effect) -> tuple[Case, Effect]:
    """A step between two poses, which fits alike wherever it lies between them, midway; another `at` as it is."""
    step: Any = effect
    at, progress = getattr(step, "at", None), np.unique(case.m.conditions.get("progress", []))
    if at is None or not len(progress) or not progress[0] <= at < progress[-1]:
        return case, effect
    after = int(np.searchsorted(progress, at, side="right"))
    step = replace(step, at=float(progress[after - 1 : after + 1].mean()))
    more = case.with_variants(label, [(step,)])
    before, moved = (more.whole.take(more.group((e,))) for e in (effect, step))
    return (more, step) if np.array_equal(before, moved) else (case, effect)


def _with_probable_settings(case: Case, label: str, effect: Effect, chosen: Array) -> tuple[Case, tuple[Effect, ...]]:
    """The case with a whole number in place of a fraction near it, where hardly less probable, and these settings.

    A load that follows the joint's angle moves the cycles that are read: beside whole numbers, a phase that runs with
    the load is tried, too (`tried` of a setting), and taken where it is worth its price.
    """
    whole = [f.name for f in fields(effect) if f.metadata.get("whole")]
    tried = [(f.name, v) for f in fields(effect) for v in f.metadata.get("tried", ())]
    if not whole:
        return case, (effect,)
    (name,) = whole
    read = float(getattr(effect, name))

    near = [float(k) for k in range(1, int(2 * read)) if abs(k - read) <= max(WHOLE_NUMBER_RANGE * read, 1.0)]
    plain = [_with(effect, **{name: k}) for k in near]
    joined = [_with(e, **{other: v}) for e in plain for other, v in tried]
    every = [(e,) for e in dict.fromkeys((effect, *plain, *joined))]
    case = case.with_variants(label, every[1:])
    log = _log_evidence(case, every, chosen)
    price = {(e,): TRIED_SETTING_PRICE for e in joined} | {(e,): -WHOLE_NUMBER_BONUS for e in plain}
    log = log - np.array([price.get(v, 0.0) for v in every])
    best = every[first_of_best(log, logs=True)][0]
    if best not in joined:
        return case, (best,)
    (other,) = {other for other, _ in tried}
    value = float(getattr(best, other))
    fine: list[tuple[Effect, ...]] = [(_with(best, **{other: value + step}),) for step in FINE_STEPS]
    case = case.with_variants(label, fine)
    return case, fine[first_of_best(_log_evidence(case, fine, chosen), logs=True)]


def _best(case: Case, trial: list[tuple[Effect, ...]], log: Array, chosen: Array) -> int:
    """Number of the best settings. Of equal ones those that explain the poses left out, too; else the first."""
    equal = np.flatnonzero(log >= log.max() - EQUAL_LOG_EVIDENCE)
    if len(equal) > 1 and not case.kept.all():
        every = case.with_kept(np.ones_like(case.kept))
        of_all = _log_evidence(every, [trial[k] for k in equal.tolist()], chosen)
        equal = equal[of_all >= of_all.max() - EQUAL_LOG_EVIDENCE]
    return int(equal[0])


def _log_evidence(case: Case, variants: Sequence[tuple[Effect, ...]], chosen: Array) -> Array:
    """Of each variant, shape (len(variants),)."""
    grids = case.judged.log_grids([case.group(v) for v in variants], chosen)
    return np.asarray(np.logaddexp.reduce((grids + np.log(KAPPA_WEIGHTS)).reshape(len(variants), -1), axis=1))


def learnt_sizes(
    e: Evidence, group: Array, parts: Mapping[int, Array], beside: Array, noise: Noise
) -> tuple[dict[int, float], Noise]:
    """Factor on the size of each part, and the noise that is left.

    e : the problem; group : columns of the effect, shape (k,); parts : places in the group, by part
    beside : columns of other causes in the model; noise : as far as known
    """
    columns = np.union1d(beside, group)
    fit = new_fit(e, columns, noise)
    sums = fit.sums
    first, own = len(fit.prior) - fit.combined.width, np.searchsorted(columns, group)
    places_of = {part: first + fit.combined.places(own[places]) for part, places in parts.items()}
    prior, mean = fit.prior.copy(), fit.mean
    factors, scale, rows = dict.fromkeys(parts, 1.0), 1.0, len(fit.y)
    square = float(fit.y @ fit.y)
    for _ in range(MAX_SIZE_ROUNDS):
        normal = sums.H / scale + np.diag(prior**-2)
        root = root_of_inverse(normal)
        x = root.T @ (root @ (sums.g / scale + mean / prior**2))
        determined = 1 - (root**2).sum(axis=0) / prior**2
        left = square - 2 * sums.g @ x + x @ sums.H @ x
        before = (scale, *factors.values())
        # With more parameters than rows the noise would shrink to nothing.
        scale = max(float(left / (rows - determined.sum())), MIN_SIZE_FACTOR**2)
        for part, at in places_of.items():
            count = float(determined[at].sum())
            if count > MIN_DETERMINED_PARAMETERS:
                unit = prior[at] / factors[part]
                factor = float(np.sqrt(((x[at] / unit) ** 2).sum() / count))
                factors[part] = float(np.clip(factor, MIN_SIZE_FACTOR, MAX_SIZE_FACTOR))
                prior[at] = unit * factors[part]
        if np.abs(np.log(np.array((scale, *factors.values())) / np.array(before))).max() < SIZE_TOLERANCE:
            break
    return factors, Noise(noise.sigma * float(np.sqrt(scale)), noise.repeatability * float(np.sqrt(scale)))

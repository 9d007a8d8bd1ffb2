"""Refinement of a cause's nonlinear settings (knee, lag, cycles) and of its parts' sizes.

Settings are optimised between the grid's points by their marginal likelihood. The prior sizes of an
effect's parts are learnt by MacKay's fixed point: a part's variance is set to the sum of squares of
its parameters over the number of them that the data determine; the noise variance likewise. A part
that the data do not determine keeps its size (MacKay 1992, Bayesian interpolation, sec. 4).
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.normal_equations import root_of_inverse
from casadical.core.linear_gaussian.search import log_factors
from casadical.core.statistics import first_of_best
from casadical.diagnosis.cross_validation import new_fit
from casadical.diagnosis.evidence import KAPPA_WEIGHTS, Evidence
from casadical.diagnosis.linear_problem import Case
from casadical.effects import Effect
from casadical.measurements.measurements import Noise


def neighbours(effect: Effect, fineness: float) -> list[Effect]:
    """Return copies of an effect, each with one setting changed by one of four steps.

    Values that are not positive are omitted, unless signed; settings of the user's are not changed.
    fineness : scale of the steps, 1 or less: in units of the grid's spacing for settings with
        `steps`, else of the setting's natural logarithm
    """
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
    """Return the effect with other values of some settings."""
    return replace(effect, **settings)


def refined(
    case: Case, label: str, variant: tuple[Effect, ...], chosen: Array, noise: Noise
) -> tuple[Case, tuple[Effect, ...]]:
    """Return the case and the effects with the best settings found near a variant.

    A variant of several effects is returned unchanged. The prior sizes of an effect's parts are
    learnt in place of settings.
    label : of the candidate; variant : its effects with settings of the grid
    chosen : indices of the columns of causes that are in the model already
    noise : most likely noise with the variant
    """
    if len(variant) != 1:
        return case, variant
    if variant[0].parts:
        learnt = learnt_sizes(case.judged, case.group(variant), variant[0].parts, chosen, noise)
        case, effect = case.with_sizes(variant[0], *learnt)
        return case, (effect,)
    halved = 0
    for _ in range(10):
        trial: list[tuple[Effect, ...]] = [variant, *((e,) for e in neighbours(variant[0], 0.5**halved))]
        if len(trial) == 1:
            break
        case = case.with_variants(dict.fromkeys(trial[1:], label))
        log = log_evidence(case, trial, chosen)
        best = _best(case, trial, log, chosen)
        if log[best] - log[0] < 0.3:  # nats
            halved += 1
        variant = trial[best]
        if halved == 2:
            break
    case, effect = _between_poses(case, label, variant[0], chosen)
    return _with_probable_settings(case, label, effect, chosen)


def _between_poses(case: Case, label: str, effect: Effect, chosen: Array) -> tuple[Case, Effect]:
    """Return case and effect with the time of a step midway between the two poses that fit best.

    A step fits equally well wherever it lies between two poses; one pose on its wrong side costs
    more evidence than all else. Other effects are returned unchanged.
    chosen : indices of the columns in the model
    """
    step: Any = effect
    at, progress = getattr(step, "at", None), np.unique(case.m.conditions.get("progress", []))
    if at is None or not len(progress) or not progress[0] <= at < progress[-1]:
        return case, effect
    after, middles = int(np.searchsorted(progress, at, side="right")), (progress[1:] + progress[:-1]) / 2
    # Four poses to each side: the search before stops within a few poses.
    near = middles[max(after - 5, 0) : after + 4].tolist()
    trial: list[tuple[Effect, ...]] = [*((replace(step, at=middle),) for middle in near), (effect,)]
    case = case.with_variants(dict.fromkeys(trial[:-1], label))
    return case, trial[_best(case, trial, log_evidence(case, trial, chosen), chosen)][0]


def _with_probable_settings(case: Case, label: str, effect: Effect, chosen: Array) -> tuple[Case, tuple[Effect, ...]]:
    """Return case and effects with an integer for a fractional setting if hardly less probable.

    A load that depends on the joint's angle shifts the apparent cycles per turn: in addition to
    integers, a phase that changes with the load is evaluated, too (values `tried` of a setting),
    and accepted if it gains enough evidence.
    label : of the candidate; chosen : indices of the columns in the model
    """
    whole = [f.name for f in fields(effect) if f.metadata.get("whole")]
    tried = [(f.name, v) for f in fields(effect) for v in f.metadata.get("tried", ())]
    if not whole:
        return case, (effect,)
    (name,) = whole
    read = float(getattr(effect, name))

    # Integers are evaluated within 12 % of a fractional setting, within one of it and at most four:
    # a load that depends on the angle shifts the frequency by a few cycles, whatever it is.
    near = [float(k) for k in range(1, int(2 * read)) if abs(k - read) <= min(max(0.12 * read, 1.0), 4.0)]
    # The second harmonic of half the true frequency fits, too.
    near.append(float(round(2 * read)))
    plain = [_with(effect, **{name: k}) for k in near]
    joined = [_with(e, **{other: v}) for e in plain for other, v in tried]
    every = [(e,) for e in dict.fromkeys((effect, *plain, *joined))]
    case = case.with_variants(dict.fromkeys(every[1:], label))
    log = log_evidence(case, every, chosen)
    # A whole number may lack 2 nats and still be preferred to the fraction; an additional setting
    # must gain 5 nats over the fraction, and 7 nats over a whole number.
    price = {(e,): 5.0 for e in joined} | {(e,): -2.0 for e in plain}
    log = log - np.array([price.get(v, 0.0) for v in every])
    best = every[first_of_best(log, logs=True)][0]
    if best not in joined:
        return case, (best,)
    (other,) = {other for other, _ in tried}
    value = float(getattr(best, other))
    fine: list[tuple[Effect, ...]] = [(_with(best, **{other: value + step}),) for step in (0.0, -0.6, -0.3, 0.3, 0.6)]
    case = case.with_variants(dict.fromkeys(fine, label))
    return case, fine[first_of_best(log_evidence(case, fine, chosen), logs=True)]


def _best(case: Case, trial: list[tuple[Effect, ...]], log: Array, chosen: Array) -> int:
    """Return the index of the most probable variant; ties are decided with the outliers included.

    trial : variants; log : log evidence of each, shape (len(trial),); chosen : columns in the model
    """
    equal = np.flatnonzero(log >= log.max() - 1e-6)  # settings between which the poses cannot tell
    if len(equal) > 1 and not case.inliers.all():
        every = case.with_inliers(np.ones_like(case.inliers))
        of_all = log_evidence(every, [trial[k] for k in equal.tolist()], chosen)
        equal = equal[of_all >= of_all.max() - 1e-6]
    return int(equal[0])


def log_evidence(case: Case, variants: Sequence[tuple[Effect, ...]], chosen: Array) -> Array:
    """Return the log Bayes factor of each variant given chosen columns, shape (len(variants),)."""
    e = case.judged
    return log_factors(e.log_grids([case.group(v) for v in variants], chosen), e.log_base(chosen), KAPPA_WEIGHTS)[0]


def learnt_sizes(
    e: Evidence, group: Array, parts: Mapping[int, Array], given: Array, noise: Noise
) -> tuple[dict[int, float], Noise]:
    """Return the estimated factor on the prior size of each part, and the remaining noise.

    Factors are 0.05 to 8, and 1 for parts that the data do not determine; the noise is at least a
    twentieth of the initial one.
    e : linear model; group : indices of the effect's columns, shape (k,)
    parts : indices into the group, by part
    given : indices of the columns of other causes in the model; noise : initial estimate
    """
    columns = np.union1d(given, group)
    fit = new_fit(e, columns, noise)
    sums = fit.sums
    first, own = len(fit.prior) - fit.combined.width, np.searchsorted(columns, group)
    places_of = {part: first + fit.combined.places(own[places]) for part, places in parts.items()}
    prior, mean = fit.prior.copy(), fit.mean
    factors, scale, rows = dict.fromkeys(parts, 1.0), 1.0, len(fit.y)
    for _ in range(8):
        normal = sums.H / scale + np.diag(prior**-2)
        root = root_of_inverse(normal)
        x = root.T @ (root @ (sums.g / scale + mean / prior**2))
        determined = 1 - (root**2).sum(axis=0) / prior**2
        before = (scale, *factors.values())
        # The lower bound prevents that the noise shrinks to zero with more parameters than rows.
        scale = max(float(sums.moved(-x).square / (rows - determined.sum())), 0.05**2)
        for part, at in places_of.items():
            count = float(determined[at].sum())
            # A part's size is learnt only if the data determine more than one of its parameters.
            if count > 1.0:
                unit = prior[at] / factors[part]
                factor = float(np.sqrt(((x[at] / unit) ** 2).sum() / count))
                factors[part] = float(np.clip(factor, 0.05, 8.0))
                prior[at] = unit * factors[part]
        # It has converged where no size changes by more than 5 %.
        if np.abs(np.log(np.array((scale, *factors.values())) / np.array(before))).max() < 0.05:
            break
    return factors, Noise(noise.sigma * float(np.sqrt(scale)), noise.repeatability * float(np.sqrt(scale)))

"""Conclusion of a search for causes: held-out errors, causes, outliers and verdict."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from casadical.core.basics import Array
from casadical.core.statistics import ranked
from casadical.diagnosis.claims import cause_set, named, with_additional_cause
from casadical.diagnosis.cross_validation import (
    errors_and_distances,
    fit_of,
    partitioned_errors,
    partitions,
    shrink_interval,
)
from casadical.diagnosis.held_out_gap import course
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.noise_account import NoiseAccount, account_of
from casadical.diagnosis.noise_floor import noise_floor, outlier_probability, replicates
from casadical.diagnosis.noise_forms import noisy_joint_label
from casadical.diagnosis.posterior import PRIOR_FURTHER
from casadical.diagnosis.result import Cause, Diagnosis, Gap, Outlier, Verdict
from casadical.diagnosis.search import State, Step
from casadical.diagnosis.settings import SETTINGS
from casadical.diagnosis.structure import joint_of_outliers
from casadical.effects import Effect
from casadical.identification.result import Identification
from casadical.measurements.measurements import Noise


def conclude(identification: Identification, state: State, seed: int) -> Diagnosis:
    """Return the diagnosis that follows from the final state of a search.

    state : as returned by `search`; seed : seed of the held-out partitions
    """
    state = named(state, seed)
    # A further event of a kind is no candidate that reports compare: it looks like the first one.
    alone = [c for c in state.case.candidates if getattr(c.variants[0][0], "event", 1) == 1]
    own = {s.labels[0] for s in state.steps}
    shown = tuple(c for c in state.case.candidates if c in alone or c.label in own)
    state = replace(state, case=replace(state.case, candidates=shown)._with_evidence(state.case.evidence))
    case, columns = state.case, state.columns()
    before = partitioned_errors(case.evidence, columns[:0], state.rankings[0].noise[""], seed)
    repeated = replicates(case.m, case.whole.r, case.inliers, case.observations.apart, case.whole.measured)

    def noise_of(state: State) -> tuple[Noise, NoiseAccount, float]:
        """Return the noise that the best model leaves, its account and its held-out error [m].

        The best model includes an unlisted cause, unless the search ended without one.
        """
        last = state.rankings[-1]
        noise = last.noise["" if state.end == "none" else last.order[0]]
        # A form that gains little compared with the causes may be a flaw of their equations; one that
        # would not be detected as a cause is none.
        least = max(SETTINGS.max_flaw * state.log_gain, -float(np.log(SETTINGS.max_p_nothing_further)))
        form = last.noise_form if last.log_none - np.log(PRIOR_FURTHER["none"]) > least else ""
        account = account_of(case, columns, noise, repeated, form, last.noise.get(form, noise))
        return noise, account, noise_floor(case.evidence, noise, account.anchor, seed)

    noise, account, floor = noise_of(state)
    richer = None if repeated.enough or state.end != "claimed" else _with_richer_form(state, floor, seed)
    if richer:
        state = replace(richer, end="unknown")
        noise, account, floor = noise_of(state)
    after = partitioned_errors(case.evidence, columns, noise, seed) if state.steps else before
    account = account.unless_small(float(before.mean() / after.mean())) if state.steps else account
    error, distance = errors_and_distances(case.whole, columns, noise, case.inliers)
    causes = [_cause(state, step, account, before, seed) for step in state.steps]
    joint = joint_of_outliers(case, columns, noise)
    before_all, outliers = (before, ()) if joint else _outliers_as_cause(case, before, error, distance, seed)
    # Noise causes no more than the whole remaining error, though its size is estimated on a grid.
    gap = Gap(float(before_all.mean()), float(after.mean()), min(floor, float(after.mean())), float(before.mean()))
    causes += outliers
    causes = [causes[k] for k in ranked([c.shrink for c in causes])]
    names = ["base", *(f"+ {step.labels[0]}" for step in state.steps)]
    noises = [*(r.noise[""] for r in state.rankings[: len(state.steps)]), noise]
    stages = [(name, state.columns(state.steps[:k]), noises[k]) for k, name in enumerate(names)]
    shrinks = course(case, stages, partitions(case.evidence, seed), noise, seed)
    rest = max(0.0, (gap.after - gap.floor) / gap.before)
    more = state.rankings[-1]
    flaw = more.log_factor[more.order[0]] <= SETTINGS.max_flaw * state.log_gain
    verdict = _verdict(state, gap, rest, flaw, bool(causes), shrinks)
    exactly = with_additional_cause(cause_set(state), state, seed)
    if verdict == "explained":
        doubted = exactly and exactly.probability < SETTINGS.min_set and not flaw
        verdict = "ambiguous" if doubted else "unknown" if richer else "explained"
    if verdict == "explained" and state.steps and account.doubt:
        verdict = "unknown"
    if exactly:
        untried = SETTINGS.untried_in_doubt if account.doubt else SETTINGS.untried
        others = tuple((labels, p * (1 - untried)) for labels, p in exactly.others)
        members = {c.label: min(c.confidence, p) for c in causes for p in [exactly.members.get(c.label)] if p}
        known = 1 - SETTINGS.look_alike
        known_as = {c: {k: known * p for k, p in own.items()} for c, own in exactly.names.items()}
        p = exactly.probability * (1 - untried)
        exactly = replace(exactly, probability=p, members=members, names=known_as, others=others, untried=untried)
    if (account.is_structure or joint) and not state.steps and verdict in ("none", "explained"):
        verdict = "unknown"
    return Diagnosis(
        verdict=verdict,
        causes=tuple(causes),
        gap=gap,
        noise=noise,
        account=account,
        unknown_rest=rest,
        course=shrinks,
        replicates=repeated,
        rankings=state.rankings,
        outliers=_outliers(case, error, distance),
        joint_of_outliers=joint,
        missing=case.missing,
        case=case,
        identification=identification,
        seed=seed,
        p_nothing=state.p_nothing,
        cause_set=exactly,
    )


def _with_richer_form(state: State, floor: float, seed: int) -> State | None:
    """Return the state with one more ranking if another effect fits better than the noise floor.

    Its held-out error is then below `floor` [m]: the search ended only by its limit on the number
    of causes, and the floor, estimated by the fit, includes unexplained error. Else None.
    """
    case, further = state.case, state.ranked()
    ranking = further.rankings[-1]
    label = ranking.order[0]
    if ranking.none > SETTINGS.max_p_nothing_further or label not in state.by_label:
        return None
    form = case.group(state.by_label[label].variants[ranking.variant[label]])
    columns = np.union1d(state.columns(), form)
    error = partitioned_errors(case.evidence, columns, ranking.noise[label], seed).mean()
    return further if error < floor else None


def _rest_at(state: State, step: Step, account: NoiseAccount) -> float:
    """Return the probability that something unlisted remains where a cause acts or has its driver.

    There the cause and something else are equally probable. It is 1 where the joint scatters and
    the noise is in doubt, and 0 for a flaw of the equation. account : of the noise
    """
    last, names = state.rankings[-1], ("joint", "driver", "source", "first", "second")
    every = (getattr(e, name, None) for e in step.effects for name in names)
    places = {joint for joint in every if isinstance(joint, int)}
    if account.doubt and last.noise_form in {noisy_joint_label(j) for j in places}:
        return 1.0
    unlisted = [c for c in state.case.candidates if not c.listed and c.label in last.probability]
    there = [c.label for c in unlisted if not places.isdisjoint(getattr(c.variants[0][0], n, None) for n in names)]
    gain = max((last.log_factor[label] for label in there), default=0.0)
    flaw = gain <= SETTINGS.max_flaw * step.log_gain
    return 0.0 if flaw else sum(last.probability[label] for label in there)


def _cause(state: State, step: Step, account: NoiseAccount, before: Array, seed: int) -> Cause:
    """Return a step of the search as a named cause.

    before : held-out errors of the inliers by the base model, shape (n_inliers,) [m]
    """
    label, ranking = step.labels[0], step.ranking
    candidate = state.by_label[label]
    alone = partitioned_errors(state.case.evidence, state.case.group(step.effects), ranking.noise[label], seed)
    values = parameter_values(state.case, state.columns(), step.effects, ranking.noise[label])
    # An effect in doubt that is four times as large as what the cause explains may do the same.
    small = account.unless_small(float(before.mean() / alone.mean()), 4.0).doubt
    share = (1 - SETTINGS.look_alike) * (1 - max(_rest_at(state, step, account), bool(small)) / 2)
    return Cause(
        effect=candidate.name,
        joint=candidate.joint,
        confidence=ranking.probability[label] * share,
        shrink=float(1 - alone.mean() / before.mean()),
        shrink_interval=shrink_interval(before, alone, seed, state.case.evidence.stop),
        indistinguishable=rivals_of(step, state.listed(ranking)),
        effects=step.effects,
        estimates={name if candidate.joint == e.joint else f"{name}@{e.joint}": v for (e, name), v in values.items()},
    )


def rivals_of(step: Step, listed: Sequence[str]) -> tuple[str, ...]:
    """Return the labels of a cause that the data cannot distinguish from its own.

    If the step has none, they are the next listed labels above `Settings.min_ambiguous`.
    listed : labels of listed effects, the most probable first
    """
    probable = (k for k in listed if k != step.labels[0] and step.ranking.probability[k] > SETTINGS.min_ambiguous)
    return step.labels[1:] or tuple(probable)[: SETTINGS.max_ambiguous - 1]


def parameter_values(
    case: Case, columns: Array, effects: Sequence[Effect], noise: Noise
) -> dict[tuple[Effect, str], tuple[float, float, str]]:
    """Return value, standard error and unit [SI] of the effects' parameters by effect and name.

    columns : indices of the columns of all causes, which are fitted together, shape (k,)
    Effects with a `summary` in place of their parameters are excluded, and parameters of
    instruments that are not in use.
    """
    value, error = fit_of(case.judged, columns, noise).causes
    parameters = {}
    for effect in (e for e in effects if not e.summary):
        places, sizes = np.searchsorted(columns, case.columns[effect]), case.sizes(case.columns[effect])
        seen = np.ones(len(sizes), dtype=bool)
        if effect.from_kind:
            seen = np.any(case.whole.take(case.columns[effect]), axis=(0, 1))
        for place, size, there, (name, (_, unit)) in zip(places, sizes, seen, effect.sizes().items(), strict=True):
            if there:
                parameters[effect, name] = float(value[place] * size), float(error[place] * size), unit
    return parameters


def _outliers(case: Case, error: Array, distance: Array) -> tuple[Outlier, ...]:
    """Return the outlier poses, that of the largest error first.

    error, distance : as returned by `errors_and_distances`, shape (n,)
    """
    out = sorted(np.flatnonzero(~case.inliers), key=lambda i: -error[i])
    return tuple(Outlier(int(case.m.row[i]), float(error[i]), float(np.sqrt(distance[i]))) for i in out)


def _outliers_as_cause(
    case: Case, before: Array, error: Array, distance: Array, seed: int
) -> tuple[Array, tuple[Cause, ...]]:
    """Return the errors of all poses, outliers included [m], and the outliers as a cause.

    Without outliers, or with one below twice `Settings.outlier_distance`: `before` and no cause.
    before : held-out errors of the inliers, shape (n_inliers,) [m]
    error, distance : as returned by `errors_and_distances`, shape (n,)
    """
    out = ~case.inliers
    count = int(out.sum())
    if count == 0 or (count == 1 and distance[out][0] < 2 * SETTINGS.outlier_distance):
        return before, ()
    whole = np.concatenate([before, error[out]])
    shrink = float(1 - before.mean() / whole.mean())
    interval = shrink_interval(whole, np.concatenate([before, np.full(count, before.mean())]), seed)
    return whole, (Cause("outliers", None, outlier_probability(distance[out]), shrink, interval, ()),)


def _verdict(state: State, gap: Gap, rest: float, flaw: bool, found: bool, shrinks: pd.DataFrame) -> Verdict:
    """Return the verdict by the search's end, the fraction of the gap explained, and time blocks.

    rest : fraction of the gap that neither causes nor noise explain; found : if any cause is named
    flaw : whether what is probable beside the causes may be a flaw of their equations
    shrinks : held-out errors as causes are added (see `course`)
    """
    if not state.steps and state.end in ("unknown", "ambiguous"):
        return "unknown" if state.end == "unknown" else "ambiguous"
    if not found:
        return "none"
    share = (gap.before - gap.after) / max(gap.before - gap.floor, 1e-9)
    if share < SETTINGS.min_explained and (state.end == "unknown" or rest > SETTINGS.max_unexplained):
        return "unknown"
    if state.end == "unknown" and state.log_gain > 0 and not flaw:
        return "unknown"
    if any(len(step.labels) > 1 for step in state.steps):
        return "ambiguous"
    # A model that does not predict held-out blocks of time explains nothing.
    blocks = shrinks["blocks_mm"].to_numpy()
    return "unknown" if blocks[-1] > SETTINGS.max_block_ratio * blocks[0] else "explained"

"""Which causes of a search are claimed, and how probable the set of them is."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import TIE_TOLERANCE, best_of, first_of_best, ranked
from casadical.diagnosis.cross_validation import partitioned_errors, shrink_interval
from casadical.diagnosis.result import CauseSet
from casadical.diagnosis.search import End, State, Step, indistinguishable, next_cause
from casadical.diagnosis.settings import SETTINGS
from casadical.measurements.measurements import Noise


def named(state: State, seed: int) -> State:
    """Return the state with only the causes that may be claimed, and why its search ended.

    A cause is certain if its probability given that there is one reaches `Settings.min_claim`, that
    of none is small, and the gap on held-out poses shrinks with it. A cause with two or three
    labels that the data do not distinguish is certain as of `_is_certain`.
    One detected cause that is not certain remains, as the first one, if it has more evidence than
    each certain one and, together with the causes that cannot be distinguished from it, at
    least the probability `Settings.min_doubtful`. All others that are not certain are removed.
    seed : of the partitions into held-out poses
    """
    if not state.steps:
        return state
    steps = [_given_others(state, k) for k in range(len(state.steps))]
    # Unlisted causes with one label only are never claimed.
    kept = [s for s in steps if len(s.labels) > 1 or state.by_label[s.labels[0]].listed]
    again: End = state.end if len(kept) == len(steps) else "ambiguous"
    if again == state.end and len(steps) > 1:
        # Nor is a cause that the others make improbable; they are judged again without it.
        least = best_of(steps, lambda s: s.ranking.none)
        kept = [s for s in steps if s is not least or s.ranking.none <= 0.5]
    if len(kept) < len(steps):
        rest = replace(state, steps=tuple(kept), end=again).ranked()
        # An effect that is removed took probability from a listed one that looks like it.
        if len(kept) == 1:
            rest = replace(rest, steps=(_given_others(rest, 0, first=True),))
        return named(rest, seed)
    there = [s for k, s in enumerate(steps) if s.labels[0] not in state.doubted and _shrinks(state, k, seed)]
    alone = len(state.steps) == 1
    further = SETTINGS.max_p_nothing_further
    certain = [s for s in there if _is_certain(state, s) and (alone or s.ranking.none <= further)]
    doubtful = [s for s in there if s not in certain and _is_listed(state, s)]
    doubtful = [s for s in doubtful if sum(s.ranking.probability[k] for k in s.labels) >= SETTINGS.min_doubtful]
    strongest = best_of(doubtful, lambda s: s.log_gain, logs=True) if doubtful else None
    if strongest and all(strongest.log_gain > s.log_gain + TIE_TOLERANCE for s in certain):
        certain = [strongest, *certain]
    if len(certain) == len(steps):
        return replace(state, steps=tuple(certain))
    remaining = replace(state, steps=tuple(certain)).ranked()
    again, names = next_cause(remaining, remaining.rankings[-1])
    if again == "claimed" and len(names) > 1:
        more = remaining.with_cause(names)
        if (
            more is not remaining
            and _is_certain(more, more.steps[-1])
            and _shrinks(more.ranked(), len(more.steps) - 1, seed)
        ):
            remaining = more.ranked()
            again, _ = next_cause(remaining, remaining.rankings[-1])
    # A cause that was removed is not certain, even if it is the most probable one again.
    unclear = again == "claimed" or (not certain and again == "none")
    return replace(remaining, end="ambiguous" if unclear else again)


def _given_others(state: State, k: int, *, first: bool = False) -> Step:
    """Return step k with its ranking and indistinguishable labels given all other causes.

    first : whether they are computed again, too, if there is no other cause
    """
    step, others = state.steps[k], (*state.steps[:k], *state.steps[k + 1 :])
    if not others and not first:
        return step
    label = step.labels[0]
    own = state.by_label[label]
    later = getattr(own.variants[0][0], "event", 1) > 1
    ranking = state.rank(others, keep=label if own.together or later else "")
    alike = indistinguishable(ranking, [label, *(c for c in state.listed(ranking) if c != label)])
    certain = ranking.none <= SETTINGS.max_p_nothing_further and len(alike) == 1
    return replace(step, ranking=ranking, labels=(label,) if certain else alike[: max(2, len(alike))])


def _is_listed(state: State, step: Step) -> bool:
    """Return whether a step's cause is the most probable listed one and probably a listed one.

    The latter holds if listed causes have half of the probability that there is a cause. Forms at
    the joint of the cause count with it where it has a quarter of their probability together.
    """
    ranking, listed, label = step.ranking, state.listed(step.ranking), step.labels[0]
    share = sum(ranking.probability[k] for k in listed)
    own = sum(ranking.probability[k] for k in state.twins(label) & ranking.probability.keys())
    share += own if ranking.probability[label] >= 0.25 * (own + ranking.probability[label]) else 0.0
    return listed[0] == label and share >= 0.5 * (1 - ranking.none)


def _is_certain(state: State, step: Step) -> bool:
    """Return whether a step has one label, or several that reach `Settings.min_claim` together.

    The several must be of effects that name each other in `Effect.confused_with`, or forms at the
    joint of the first; others indicate a flaw in another cause's equation instead.
    """
    each, twins = [step.ranking.probability[k] for k in step.labels], state.twins(step.labels[0])
    own, *others = (state.by_label[k].variants[0][0] for k in step.labels if k not in twins)
    alike = all(own.name in e.confused_with or e.name in own.confused_with for e in others)
    return len(each) == 1 or (
        alike and first_of_best(each) == 0 and min(each) >= SETTINGS.min_ambiguous and sum(each) >= SETTINGS.min_claim
    )


def _shrinks(state: State, k: int, seed: int) -> bool:
    """Return whether the mean held-out error shrinks with cause k, alone or added to all others.

    It does if the 95 % interval of the shrink is above zero.
    """
    steps, own = state.steps, state.steps[k]

    def errors(model: Sequence[Step], noise: Noise) -> Array:
        """Return the held-out errors with the causes of some steps, shape (n_inliers,) [m]."""
        return partitioned_errors(state.case.judged, state.columns(model), noise, seed)

    def shrinks(before: Array, after: Array) -> bool:
        """Return whether the mean error shrinks significantly."""
        return shrink_interval(before, after, seed, state.case.judged.stop)[0] > 0

    if shrinks(errors((), state.rankings[0].noise[""]), errors((own,), own.ranking.noise[own.labels[0]])):
        return True
    last = state.rankings[-1].noise[""]
    return len(steps) > 1 and shrinks(errors((*steps[:k], *steps[k + 1 :]), last), errors(steps, last))


def with_additional_cause(found: CauseSet | None, state: State, seed: int) -> CauseSet | None:
    """Return the set with the labels of one additional cause, if a listed one is detected.

    They are the most probable listed labels that no cause has, and are probable together (see
    `Settings.min_doubtful`); else `found` is returned unchanged, also None.
    """
    last = state.rankings[-1]
    named_labels = {k for step in state.steps for k in step.labels}
    unsaid = [k for k in state.listed(last) if k not in named_labels]
    likely = [k for k in unsaid if last.probability[k] >= SETTINGS.min_ambiguous][: SETTINGS.max_ambiguous]
    further = {k: last.probability[k] for k in likely}
    if not found or last.none > SETTINGS.max_p_nothing_further or sum(further.values()) < SETTINGS.min_doubtful:
        return found
    effects = state.by_label[likely[0]].variants[last.variant[likely[0]]]
    columns = np.union1d(state.columns(), state.case.group(effects))
    errors = partitioned_errors(state.case.evidence, columns, last.noise[likely[0]], seed)
    return replace(found, further=further, further_gap=float(errors.mean()))


def cause_set(state: State) -> CauseSet | None:
    """Return the causes' probabilities as a set, among all sets that differ by one cause.

    These are the sets with one more cause (the last ranking), and those without one of its causes
    or with another one in its place (the ranking given the others). None without causes.
    """
    if not state.steps:
        return None
    last, own = state.rankings[-1], tuple(s.labels[0] for s in state.steps)
    # Odds of each set against the named one; another label of a cause in the set is no additional
    # cause.
    named_labels = {k for step in state.steps for k in step.labels}
    odds = {(*own, k): p / max(last.none, 1e-12) for k, p in last.probability.items() if k not in named_labels}
    more = sum(odds.values())
    against, names = {}, {}
    for step, label in zip(state.steps, own, strict=True):
        ranking, rest = step.ranking, tuple(k for k in own if k != label)
        if len(step.labels) > 1:
            names[label] = {k: ranking.probability[k] for k in step.labels}
        p = max(sum(ranking.probability[k] for k in step.labels), 1e-12)
        others = {k: q / p for k, q in ranking.probability.items() if k not in step.labels}
        odds |= {(*rest, k): q for k, q in others.items()} | {rest: ranking.none / p}
        against[label] = (1 - p) / p
    total = 1 + more + sum(against.values())
    keys = list(odds)
    # At most three other sets are reported.
    first = [keys[k] for k in ranked(list(odds.values()))[:3]]
    sets = tuple((k, odds[k] / total) for k in first if odds[k] / total >= SETTINGS.min_ambiguous)
    return CauseSet(1 / total, more / (1 + more), {k: 1 - odd / total for k, odd in against.items()}, sets, names)

"""Beam search for sets of causes that explain the data together where no single cause does.

The evidence of a set is that of its first cause, times that of each additional one given those
before; its prior falls with its size. Every ranking given a set yields the mass of that set with
each candidate added, so that a few rankings compare thousands of sets, including those with an
unlisted cause.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from casadical.core.statistics import TIE_TOLERANCE, first_of_best, ranked
from casadical.diagnosis.posterior import PRIOR_FURTHER, Ranking
from casadical.diagnosis.settings import SETTINGS
from casadical.effects import Effect

# Causes of a set: the effects of each, with settings, by label, in the order of choice.
Chosen = Mapping[str, tuple[Effect, ...]]
# A set of causes with its ranking of an additional one.
Ranked = tuple[Chosen, Ranking]
# Function that returns, for each of some sets, the ranking of an additional cause given it.
RankingsGiven = Callable[[Sequence[Chosen]], Sequence[Ranking]]


@dataclass(eq=False)
class _Search:
    """State of the beam search over sets.

    rankings_given : function that returns the rankings given sets
    variants : effects of each variant of each candidate, by label
    listed : labels that may be named; mass : log mass of each set found so far, by its labels
    reached : for each set, the smaller ranked set from which it was reached and the added label
    expanded : labels of the sets whose ranking was computed
    """

    rankings_given: RankingsGiven
    variants: Mapping[str, tuple[tuple[Effect, ...], ...]]
    listed: frozenset[str]
    mass: dict[frozenset[str], float] = field(default_factory=dict)
    reached: dict[frozenset[str], tuple[Ranked, str]] = field(default_factory=dict)
    expanded: set[frozenset[str]] = field(default_factory=set)

    def take(self, chosen: Chosen, ranking: Ranking) -> Ranked:
        """Record a ranked set and all sets with one more cause, and return the former."""
        own = frozenset(chosen)
        self.expanded.add(own)
        for label, mass in ranking.log_mass.items():
            labels, total = own | {label}, self.mass.get(own, 0.0) + mass
            if total > self.mass.get(labels, -np.inf) + TIE_TOLERANCE:
                self.mass[labels], self.reached[labels] = total, ((chosen, ranking), label)
        return chosen, ranking

    def expand(self, sets: Sequence[frozenset[str]]) -> list[Ranked]:
        """Rank an additional cause given each set of these labels; record and return the sets."""
        chosen = []
        for (before, ranking), label in (self.reached[labels] for labels in sets):
            chosen.append({**before, label: self.variants[label][ranking.variant[label]]})
        return [self.take(*one) for one in zip(chosen, self.rankings_given(chosen), strict=True)]

    def best(self, of: Iterable[frozenset[str]], count: int) -> list[frozenset[str]]:
        """Return the labels of the `count` sets of largest mass that are not expanded yet."""
        unexpanded = [k for k in of if k not in self.expanded]
        return [unexpanded[k] for k in ranked([self.mass[k] for k in unexpanded], logs=True)[:count]]

    def gaining(self, sets: Iterable[Ranked]) -> set[frozenset[str]]:
        """Return the labels of the sets with one more cause, if it gains enough evidence.

        All causes are listed ones; the gain is more than `Settings.min_set_log_gain`.
        """
        least = SETTINGS.min_set_log_gain
        return {
            frozenset((*chosen, label))
            for chosen, ranking in sets
            for label in ranking.log_mass
            if self.listed >= {*chosen, label} and ranking.log_factor[label] > least
        }


def most_probable_set(
    first: Ranking,
    rankings_given: RankingsGiven,
    variants: Mapping[str, tuple[tuple[Effect, ...], ...]],
    twins: Mapping[str, frozenset[str]],
    steps: int = 0,
) -> tuple[tuple[str, ...], frozenset[str]]:
    """Return the labels of the most probable set of additional causes, and those not certain.

    All are listed ones. The set is empty if a single cause is more probable. A cause of it is not
    certain if sets without it have more than 0.05 while those with an unlisted cause or none have
    more than 0.1; if none is certain, the set is empty, too.
    first : ranking given the causes in the model; steps : number of these causes
    rankings_given : function that returns the rankings given sets of additional causes
    variants : effects of each variant of each candidate, by label
    twins : labels of the forms at the joint of each candidate that may be named, by its label
    """
    listed = frozenset(twins)
    search = _Search(rankings_given, variants, listed)
    root = search.take({}, first)
    # Sets are built from six first causes, and from three sets of each larger size.
    frontier, width = [root], 6
    for _ in range(SETTINGS.max_causes - steps):
        frontier = search.expand(search.best(search.gaining(frontier), width))
        if not frontier:
            break
        width = 3
    # The best two sets with an unlisted cause are expanded, too, so that the comparison is fair.
    for _ in range(2):
        mixed = (
            k
            for k, ((_, before), label) in search.reached.items()
            if not k <= listed and k <= variants.keys() and before.log_factor[label] > SETTINGS.min_set_log_gain
        )
        search.expand(search.best(mixed, 1))
    # The best listed set is expanded a few times to see whether a larger one is better.
    for _ in range(4):
        listed_sets = [k for k in search.mass if k <= listed]
        if not listed_sets:
            return (), frozenset()
        best = listed_sets[first_of_best([search.mass[k] for k in listed_sets], logs=True)]
        if best in search.expanded:
            break
        search.expand([best])
    closed = np.array(list(search.mass.values())) + np.log(PRIOR_FURTHER["none"])
    of_listed = np.array([search.mass[k] for k in search.mass if k <= listed]) + np.log(PRIOR_FURTHER["none"])
    share = float(np.exp(np.logaddexp.reduce(of_listed) - np.logaddexp.reduce(np.append(closed, first.log_none))))
    # A single cause would have been ranked first.
    if len(best) < 2 or best not in search.expanded:
        return (), frozenset()
    total = np.append(closed, first.log_none)
    there = {c: np.array([not k.isdisjoint({c} | twins[c]) for k in search.mass] + [False]) for c in best}
    without = {c: float(np.exp(np.logaddexp.reduce(total[~there[c]]) - np.logaddexp.reduce(total))) for c in best}
    # Where all listed sets together are less probable than 0.9, against those with an unlisted cause,
    # each cause must be in sets of probability 0.95.
    doubted = frozenset(c for c in best if share < 0.9 and without[c] > 1 - 0.95)
    (before, _), last = search.reached[best]
    return ((), frozenset()) if doubted == best else ((*before, last), doubted)

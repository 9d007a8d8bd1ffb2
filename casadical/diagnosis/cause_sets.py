"""Sets of causes that explain together what no single one does: a beam search over sets, compared with the unlisted.

The evidence of a set is that of its first cause, times that of each further one beside those before; its prior falls
with its size. Every ranking beside a set gives the mass of that set with each candidate added, so that a few rankings
compare thousands of sets, those with something unlisted in them too.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from casadical.core.statistics import TIE_TOLERANCE, first_of_best, ranked
from casadical.diagnosis.posterior import PRIOR_FIRST, PRIOR_FURTHER, Ranking
from casadical.diagnosis.settings import SETTINGS
from casadical.effects import Effect

# How many first causes are tried, and how many larger sets are followed.
MAX_FIRST_CAUSES, BEAM_WIDTH = 6, 3
# A further cause of a set gains at least so much log evidence.
MIN_LOG_GAIN = 8.0
# How probable the listed sets must be against all with something unlisted in them.
MIN_LISTED_SHARE = 0.9
# Sets with the unlisted are followed for so many causes, and the best listed set is looked beyond so many times.
MAX_UNLISTED_CAUSES, MAX_BEST_SET_UPDATES = 2, 4

Chosen = Mapping[str, tuple[Effect, ...]]
Beside = Callable[[Sequence[Chosen]], Sequence[Ranking]]


@dataclass(frozen=True, eq=False)
class _Set:
    """A set of causes: label -> settings, in the order of choice; log of prior times evidence; what is ranked next."""

    chosen: Chosen
    log_mass: float
    ranking: Ranking

    def more(self) -> Iterable[tuple[frozenset[str], str, float]]:
        """Each set with one more cause: its labels, the new one, its log mass."""
        for label, mass in self.ranking.log_mass.items():
            yield frozenset((*self.chosen, label)), label, self.log_mass + mass


@dataclass(eq=False)
class _Search:
    """What is known of sets so far: log mass by labels, and how to reach them."""

    beside: Beside
    variants: Mapping[str, tuple[tuple[Effect, ...], ...]]
    listed: frozenset[str]
    mass: dict[frozenset[str], float] = field(default_factory=dict)
    reached: dict[frozenset[str], tuple[_Set, str]] = field(default_factory=dict)
    expanded: set[frozenset[str]] = field(default_factory=set)

    def take(self, found: _Set) -> _Set:
        """Note a set and all with one more cause."""
        self.expanded.add(frozenset(found.chosen))
        for labels, label, mass in found.more():
            if mass > self.mass.get(labels, -np.inf) + TIE_TOLERANCE:
                self.mass[labels], self.reached[labels] = mass, (found, label)
        return found

    def expand(self, sets: Sequence[frozenset[str]]) -> list[_Set]:
        """The sets of these labels, ranked beside."""
        chosen = []
        for before, label in (self.reached[labels] for labels in sets):
            chosen.append({**before.chosen, label: self.variants[label][before.ranking.variant[label]]})
        rankings = self.beside(chosen)
        masses = [self.mass[labels] for labels in sets]
        return [self.take(_Set(*one)) for one in zip(chosen, masses, rankings, strict=True)]

    def best(self, of: Iterable[frozenset[str]], count: int) -> list[frozenset[str]]:
        """Those of most mass that are not expanded yet."""
        left = [k for k in of if k not in self.expanded]
        return [left[k] for k in ranked([self.mass[k] for k in left], logs=True)[:count]]

    def gaining(self, sets: Iterable[_Set]) -> set[frozenset[str]]:
        """Listed sets with one more cause than one of these, which gains enough."""
        return {
            labels
            for s in sets
            for labels, label, _ in s.more()
            if labels <= self.listed and s.ranking.log_factor[label] > MIN_LOG_GAIN
        }


def most_probable_set(
    first: Ranking,
    beside: Beside,
    variants: Mapping[str, tuple[tuple[Effect, ...], ...]],
    listed: frozenset[str],
    steps: int = 0,
) -> tuple[tuple[str, ...], frozenset[str]]:
    """Labels of the listed causes that explain together what a ranking gives to no single one, and those in doubt.

    In doubt are causes that sets of much probability do without; where all are, there is no set.

    first : ranking beside the causes in the model, of which there are `steps`; beside : those with further ones in it
    variants : settings of each candidate; listed : labels of those that may be named
    """
    search = _Search(beside, variants, listed)
    root = search.take(_Set({}, 0.0, first))
    frontier, width = [root], MAX_FIRST_CAUSES
    for _ in range(SETTINGS.max_causes - steps):
        frontier = search.expand(search.best(search.gaining(frontier), width))
        if not frontier:
            break
        width = BEAM_WIDTH
    _follow_unlisted(search, root)
    none = np.log((PRIOR_FURTHER if steps else PRIOR_FIRST)["none"]) + first.log_noise
    for _ in range(MAX_BEST_SET_UPDATES):
        known = [k for k in search.mass if k <= listed]
        if not known:
            return (), frozenset()
        best = known[first_of_best([search.mass[k] for k in known], logs=True)]
        if best in search.expanded:
            break
        search.expand([best])
    closed = np.array(list(search.mass.values())) + np.log(PRIOR_FURTHER["none"])
    of_listed = np.array([search.mass[k] for k in search.mass if k <= listed]) + np.log(PRIOR_FURTHER["none"])
    share = float(np.exp(np.logaddexp.reduce(of_listed) - np.logaddexp.reduce(np.append(closed, none))))
    # A single one would have been ranked first.
    if len(best) < 2 or best not in search.expanded:
        return (), frozenset()
    total = np.append(closed, none)
    there = {c: np.array([c in k for k in search.mass] + [False]) for c in best}
    without = {c: float(np.exp(np.logaddexp.reduce(total[~there[c]]) - np.logaddexp.reduce(total))) for c in best}
    # Where they are not: how probable each cause must be, whatever else is there.
    doubted = frozenset(c for c in best if share < MIN_LISTED_SHARE and without[c] > 1 - 0.95)
    before, last = search.reached[best]
    return ((), frozenset()) if doubted == best else ((*before.chosen, last), doubted)


def _follow_unlisted(search: _Search, root: _Set) -> None:
    """The best set that begins with what is on no list, so that the comparison is fair."""
    unlisted = [k for k in root.ranking.order if k not in search.listed and k in search.variants]
    found = root
    for k in range(MAX_UNLISTED_CAUSES if unlisted else 0):
        label = unlisted[0] if not k else next((c for c in found.ranking.order if c in search.variants), None)
        if label is None or found.ranking.log_factor[label] < MIN_LOG_GAIN:
            return
        (found,) = search.expand([frozenset((*found.chosen, label))])

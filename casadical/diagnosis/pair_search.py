"""Two causes at once, where no single one explains: mixtures look like the unknown until both are in the model."""

import numpy as np

from casadical.diagnosis.evidence import log_sum
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.posterior import PRIOR_FIRST, PRIOR_FURTHER, Ranking, prior_weights, rank

# How many causes are tried as the first of two, and how probable two listed causes must be, against one, none and
# anything with the unknown in it.
SEEDS, TWO = 6, 0.9


def most_probable_pair(case: Case, first: Ranking) -> tuple[str, str] | None:
    """Labels of the two listed causes that explain together what the ranking gives to the unknown, or None.

    first : without any cause in the model. The evidence of two is that of one, times that of the other beside it.
    """
    listed = {c.label for c in case.candidates if c.listed}
    variants = {c.label: c.variants for c in case.candidates}
    single = prior_weights(case, PRIOR_FIRST, frozenset())
    alone = {k: float(np.log(single[k])) + f for k, f in first.log_factor.items()}
    seeds = [k for k in sorted(alone, key=lambda k: -alone[k]) if k in listed][:SEEDS]
    pairs: dict[frozenset[str], float] = {}
    for seed in seeds:
        skip = frozenset([seed])
        beside = rank(case, case.group(variants[seed][first.variant[seed]]), skip)
        further = prior_weights(case, PRIOR_FURTHER, skip)
        for label, factor in beside.log_factor.items():
            pair = frozenset([seed, label])
            mass = alone[seed] + float(np.log(further[label])) + factor
            pairs[pair] = max(mass, pairs.get(pair, -np.inf))
    one = [np.log(PRIOR_FIRST["none"]), *(m + np.log(PRIOR_FURTHER["none"]) for m in alone.values())]
    known = {pair: m for pair, m in pairs.items() if pair <= listed}
    if not known:
        return None
    share = np.exp(log_sum(np.array(list(known.values()))) - log_sum(np.array([*one, *pairs.values()])))
    if share < TWO:
        return None
    best, _ = max(known.items(), key=lambda item: item[1])
    a, b = sorted(best, key=lambda k: -alone[k])
    return a, b

"""Description of an unlisted cause by its most probable smooth forms, and its held-out error.

An unlisted form (any function of a joint's own angle, smooth in time, ...) names no cause, nor does
a listed effect in addition to it. Together they still describe the error; where the description
predicts held-out poses, it can be corrected.
"""

import numpy as np

from casadical.diagnosis.cross_validation import partitioned_errors, shrink_interval
from casadical.diagnosis.posterior import Ranking, rank
from casadical.diagnosis.result import Diagnosis, Unlisted
from casadical.diagnosis.settings import SETTINGS
from casadical.effects import Effect


def describe_unlisted(found: Diagnosis) -> Unlisted | None:
    """Return up to four forms that best describe the remaining error, with held-out errors.

    None unless the verdict is unknown, an additional cause is detected and the most probable one is
    unlisted. Forms, which may be listed effects, are added one by one while the next has a
    probability above 0.5; each is then compared again given the others.
    """
    if found.verdict != "unknown":
        return None
    case, seed = found.case, found.seed
    # Effects at single joints of a cause at several joints are in the model, too.
    named = frozenset((*(c.label for c in found.causes), *(e.label for e in found.effects())))
    by_label = {c.label: c for c in case.candidates}
    ranking = found.rankings[-1].restricted_to(by_label)
    if ranking.none > SETTINGS.max_p_nothing_further or by_label[ranking.order[0]].listed:
        return None
    forms: dict[str, tuple[Effect, ...]] = {}

    def ranked(without: str = "") -> Ranking:
        """Return the posterior over an additional form given the chosen ones, except `without`."""
        others = [case.group(e) for label, e in forms.items() if label != without]
        return rank(case, np.unique(np.concatenate([found.columns, *others])), named | forms.keys() - {without})

    def best(ranking: Ranking) -> tuple[str, tuple[Effect, ...]]:
        """Return label and effects of the most probable form."""
        label = ranking.order[0]
        return label, by_label[label].variants[ranking.variant[label]]

    while (
        len(forms) < 4
        and ranking.none <= SETTINGS.max_p_nothing_further
        and ranking.probability[ranking.order[0]] > 0.5
    ):
        label, variant = best(ranking)
        forms[label] = variant
        ranking = ranked()
    for label in list(forms) if len(forms) > 1 else ():
        again = ranked(label)
        del forms[label]
        better, variant = best(again)
        forms[better] = variant
    columns = np.unique(np.concatenate([found.columns, *(case.group(e) for e in forms.values())]))
    noise = found.noise if found.effects() else found.rankings[0].noise[""]
    before = partitioned_errors(case.evidence, found.columns, noise, seed)
    last = ranked()
    after = partitioned_errors(case.evidence, columns, last.noise[""], seed)
    means = float(before.mean()), float(after.mean())
    interval = shrink_interval(before, after, seed, case.evidence.stop)
    effects = tuple(e for variant in forms.values() for e in variant)
    return Unlisted(tuple(forms), effects, *means, 1 - means[1] / means[0], interval, last)

"""Laws as rivals of the candidates at every ranking of a diagnosis: what a law explains better is no listed cause."""

from collections.abc import Sequence

from casadical.core.arrays import Array
from casadical.diagnosis.laws.search import search_laws
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.posterior import Rival

MOST = 5


def law_rivals(case: Case, chosen: Array) -> Sequence[Rival]:
    """The most probable laws beside what is in the model, for `diagnose(..., rivals=law_rivals)`; some seconds each.

    chosen : columns of the causes in the model
    """
    best: dict[str, Rival] = {}
    for s in search_laws(case, chosen):
        best.setdefault(s.law.label, Rival(s.law.label, s.score, s.noise))
    return list(best.values())[:MOST]

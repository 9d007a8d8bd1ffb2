"""Laws as rivals of the candidates at every ranking of a diagnosis: what a law explains better is no listed cause."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.evidence import RHOS
from casadical.diagnosis.laws.problem import Scored
from casadical.diagnosis.laws.search import search_laws
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.posterior import Rival

MOST = 5
# A law is a listed effect by another name if their columns correlate by more.
CORRELATION = 0.95


def law_rivals(case: Case, chosen: Array, variant: Mapping[str, int]) -> Sequence[Rival]:
    """The most probable laws beside what is in the model, for `diagnose(..., rivals=law_rivals)`; some seconds each.

    A law that is a listed effect by another name is none.

    chosen : columns of the causes in the model; variant : the most likely settings of each candidate, by label
    """
    best: dict[str, Scored] = {}
    for s in search_laws(case, chosen):
        best.setdefault(s.law.label, s)
    first = list(best.values())[:MOST]
    return [Rival(s.law.label, s.score, s.noise) for s in first if not aliases(case, chosen, s, variant)]


def aliases(case: Case, chosen: Array, law: Scored, variant: Mapping[str, int]) -> tuple[str, ...]:
    """Labels of the listed effects that can do what a law does: its fit correlates with what they make of it.

    chosen : columns of what is in the model beside it; variant : settings of each candidate, by label
    """
    base = case.evidence.with_base(chosen)
    rho = float(RHOS[int(np.argmin(np.abs(RHOS - law.noise.repeatability / law.noise.sigma)))])
    listed = [c for c in case.candidates if c.listed and c.label in variant and not c.variants[0][0].parts]
    groups = [case.group(c.variants[variant[c.label]]) for c in listed]
    if not groups:
        return ()
    projection = base.projection(rho)
    E = projection.columns(np.concatenate([law.columns, case.evidence.take(np.concatenate(groups))], axis=2))
    w = law.columns.shape[2]
    own = E[:, :w]
    fit = own @ np.linalg.lstsq(own, projection.y, rcond=None)[0]
    found, at = [], w
    for candidate, group in zip(listed, groups, strict=True):
        other = E[:, at : at + len(group)]
        at += len(group)
        same = other @ np.linalg.lstsq(other, fit, rcond=None)[0]
        if np.linalg.norm(same) > CORRELATION * np.linalg.norm(fit):
            found.append(candidate.label)
    return tuple(found)

"""The search for causes of a joint log: one by one, noise found again beside each, until no further one is claimed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.motion.problem import NONE, MotionCase
from casadical.diagnosis.posterior import Ranking, rank
from casadical.diagnosis.thresholds import CLAIM, DETECT_FURTHER, LEAST_ALIKE, SET_SHARE, SET_SIZE

# Something is there if "nothing" is less probable than this.
DETECT = 0.02
# A cause explains at least this share of what the base leaves, where it acts; most causes that are looked for.
VISIBLE, MOST = 0.4, 6
# A further cause gains so much log evidence.
GAIN = 12.0
Verdict = Literal["explained", "ambiguous", "unknown", "none"]


@dataclass(frozen=True)
class Found:
    """A cause in the model. label, variant : of the candidate; probability : beside the others

    share : its rms over that of what is left where it acts most
    """

    label: str
    variant: int
    probability: float
    share: float


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a search found. ranking : the last one; rankings : each; alike : what is not told apart, with probabilities"""

    case: MotionCase
    verdict: Verdict
    found: tuple[Found, ...]
    rankings: tuple[Ranking, ...]
    alike: tuple[tuple[str, float], ...] = ()

    @property
    def columns(self) -> Array:
        """Of the causes in the model."""
        return columns_of(self.case, self.found)


def columns_of(case: MotionCase, found: tuple[Found, ...]) -> Array:
    """Of some causes, in rising order."""
    parts = [case.group(f.label, f.variant) for f in found]
    return np.sort(np.concatenate(parts)) if parts else NONE


def share_of(case: MotionCase, columns: Array, own: Array) -> float:
    """How large a cause's part of the residual is, as a share of what is left, in the row where it is most."""
    x, theta = case.fitted(columns)
    left = case.left(columns, x, theta)[case.of_log]
    mine = np.isin(columns, own)
    part = (case.E.take(columns[mine]) @ theta[mine])[case.of_log]
    # What the base could take over is no part of it.
    base = case.base[case.of_log]
    out = []
    for row in np.flatnonzero(np.abs(part).max(axis=0) > 0):
        A = base[:, row] / case.noise.sigma[row]
        y = part[:, row] / case.noise.sigma[row]
        seen = np.linalg.lstsq(np.vstack([A, np.eye(A.shape[1])]), np.concatenate([y, np.zeros(A.shape[1])]), rcond=None)[0]
        rest = (y - A @ seen) * case.noise.sigma[row]
        out.append(float(np.sqrt((rest**2).mean() / ((left[:, row] ** 2).mean() + 1e-30))))
    return max(out, default=0.0)


def search(case: MotionCase) -> Outcome:
    """Causes until no further one can be named; those too small to be named stay in the model."""
    found: tuple[Found, ...] = ()
    rankings: tuple[Ranking, ...] = ()
    while True:
        named = [f for f in found if f.share >= VISIBLE]
        last: Verdict = "explained" if named else "none"
        ranking = rank(case, columns_of(case, found), frozenset(f.label for f in found))
        rankings, top, there = (*rankings, ranking), ranking.order[0], 1 - ranking.none
        if ranking.none > (DETECT_FURTHER if found else DETECT) or ranking.log_factor[top] < GAIN or len(found) == MOST:
            return Outcome(case, last, found, rankings)
        share = _share(case, found, ranking, top)
        listed = [k for k in ranking.order if case.by_label[k].listed]
        p = ranking.probability[top] / there
        if share >= VISIBLE and top not in listed:
            return Outcome(case, last if named else "unknown", found, rankings)
        if share >= VISIBLE and p < CLAIM:
            alike = [(k, ranking.probability[k] / there) for k in listed if ranking.probability[k] > LEAST_ALIKE * there]
            whole = sum(p for _, p in alike[:SET_SIZE])
            verdict: Verdict = "ambiguous" if whole > SET_SHARE else "unknown"
            return Outcome(case, last if named else verdict, found, rankings, tuple(alike))
        found = (*found, Found(top, ranking.variant[top], p, share))
        case = case.renewed(columns_of(case, found))


def _share(case: MotionCase, found: tuple[Found, ...], ranking: Ranking, label: str) -> float:
    own = case.group(label, ranking.variant[label])
    return share_of(case, np.union1d(columns_of(case, found), own), own)

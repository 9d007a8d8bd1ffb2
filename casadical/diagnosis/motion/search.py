"""The search for causes of a joint log: one by one, noise found again beside each, until no further one is claimed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.motion.problem import NONE, MotionCase
from casadical.diagnosis.posterior import Ranking, rank
from casadical.diagnosis.thresholds import CLAIM, DETECT_FURTHER, LEAST_ALIKE, SET_SHARE, SET_SIZE

# Something is there if "nothing" is less probable than this.
DETECT = 0.02
# A cause is at least so large over what is left, where it acts; most causes that are looked for.
VISIBLE, MOST = 0.75, 5
# A cause gains so much log evidence, and one that is short in time so much: there every friction has flaws.
# Where no torque was logged, the servo's gain and friction are known far worse, and it gains so many times more.
CERTAIN, LOCAL, WITHOUT_TORQUE = 40.0, 80.0, 2.5
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
    """What a search found. rankings : of each step; alike : what the log does not distinguish, with probabilities"""

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
    """How large a cause's part of the residual is, over what all leave, in the row where it is most."""
    x, theta = case.fitted(columns)
    left = case.left(columns, x, theta)[case.of_log]
    part = (case.E.take(own) @ theta[np.isin(columns, own)])[case.of_log]
    return float(np.sqrt((part**2).mean(axis=0) / (left**2).mean(axis=0)).max())


def search(case: MotionCase) -> Outcome:
    """Causes until no further one can be named; those too small to be named stay in the model."""
    found: tuple[Found, ...] = ()
    rankings: tuple[Ranking, ...] = ()
    while True:
        named = [f for f in found if f.share >= 1]
        last: Verdict = "explained" if named else "none"
        skip, chosen = frozenset(f.label for f in found), columns_of(case, found)
        ranking = rank(case, chosen, skip)
        # Beside the most probable one the noise is what it is; without it, it would take a cause for noise.
        own = case.group(ranking.order[0], ranking.variant[ranking.order[0]])
        case = case.renewed(np.union1d(chosen, own))
        ranking = rank(case, chosen, skip)
        rankings, top, there = (*rankings, ranking), ranking.order[0], 1 - ranking.none
        if ranking.none > (DETECT_FURTHER if found else DETECT) or len(found) == MOST:
            return Outcome(case, last, found, rankings)
        least = (LOCAL if case.by_label[top].name == "contact" else CERTAIN) * (1.0 if case.unit else WITHOUT_TORQUE)
        if ranking.log_factor[top] < least:
            return Outcome(case, last, found, rankings)
        share = _share(case, found, ranking, top)
        listed = [k for k in ranking.order if case.by_label[k].listed]
        p = sum(ranking.probability[k] for k in ranking.order if twins(case, k, top)) / there
        if share >= 1 and top not in listed:
            return Outcome(case, last if named else "unknown", found, rankings)
        if share >= 1 and p < CLAIM:
            alike = [
                (k, ranking.probability[k] / there) for k in listed if ranking.probability[k] > LEAST_ALIKE * there
            ]
            whole = sum(p for _, p in alike[:SET_SIZE])
            verdict: Verdict = "ambiguous" if whole > SET_SHARE else "unknown"
            return Outcome(case, last if named else verdict, found, rankings, tuple(alike))
        found = (*found, Found(top, ranking.variant[top], p, share))


def twins(case: MotionCase, one: str, other: str) -> bool:
    """Whether two labels are one cause, or two names of what is the same in the data at usual sizes."""
    a, b = case.by_label[one], case.by_label[other]
    names = {a.name, b.name}
    if one == other or (names == {"lag", "transport_delay"} and a.joint == b.joint):
        return True
    last = case.by_label.get(f"link_mass@{case.joints}")
    return names == {"payload", "link_mass"} and last is not None and last.label in (one, other)


def _share(case: MotionCase, found: tuple[Found, ...], ranking: Ranking, label: str) -> float:
    """What of a cause can be seen, over what is needed to name it."""
    own = case.group(label, ranking.variant[label])
    return share_of(case, np.union1d(columns_of(case, found), own), own) / VISIBLE

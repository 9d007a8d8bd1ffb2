"""Which cause: posteriors over none, every listed cause and the unknown, step by step while the gap shrinks."""

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import first_of_best, ranked
from casadical.diagnosis.cross_validation import likely_noise
from casadical.diagnosis.evidence import KAPPA_WEIGHTS
from casadical.measurements.measurements import Noise

if TYPE_CHECKING:
    from casadical.diagnosis.linear_problem import Case
    from casadical.diagnosis.motion.problem import MotionCase

    # What a ranking is of.
    Judged: TypeAlias = Case | MotionCase

# Before any data: nothing, one of the listed effects, something on no list; and the same once causes were found.
PRIOR_FIRST = {"none": 0.25, "listed": 0.60, "unknown": 0.15}
PRIOR_FURTHER = {"none": 0.75, "listed": 0.20, "unknown": 0.05}


@dataclass(frozen=True, eq=False)
class Ranking:
    """What the data say about the next cause, given those already chosen.

    none : probability that there is no further one; probability : of each candidate, by label, summing to one with it
    log_factor : log Bayes factor of each candidate against none, by label; log_mass : with the log of its prior
    variant : its most likely settings, by label (index of the variant); a rival has none
    noise : most likely noise, without a further cause (key "") and with each candidate
    log_noise : what other forms of noise add to the log mass of none; noise_form : the best, where it is more probable
        than plain noise (see `noise_forms`)
    """

    none: float
    probability: Mapping[str, float]
    log_factor: Mapping[str, float]
    log_mass: Mapping[str, float]
    variant: Mapping[str, int]
    noise: Mapping[str, Noise]
    log_noise: float = 0.0
    noise_form: str = ""

    @property
    def order(self) -> tuple[str, ...]:
        """Labels, the most probable first."""
        labels = list(self.probability)
        return tuple(labels[k] for k in ranked(list(self.probability.values())))

    def weighed(self, none: float) -> "Ranking":
        """The same with probabilities by its masses; none : log mass of no further cause."""
        logs = np.array([none, *self.log_mass.values()])
        share = np.exp(logs - np.logaddexp.reduce(logs, axis=None))
        return replace(
            self, none=float(share[0]), probability=dict(zip(self.log_mass, share[1:].tolist(), strict=True))
        )

    def among(self, labels: Collection[str]) -> "Ranking":
        """The same between none and these candidates alone."""
        kept = {k: p for k, p in self.probability.items() if k in labels}
        total = self.none + sum(kept.values())
        return replace(self, none=self.none / total, probability={k: p / total for k, p in kept.items()})


@dataclass(frozen=True)
class Rival:
    """What is compared at a ranking beside the case's candidates, such as a law that a search found; on no list.

    label : unlike that of any candidate
    log_factor : log Bayes factor against none, averaged over its settings, with the log of its share of all rivals'
        prior: what it was selected from is paid for
    noise : most likely with it
    """

    label: str
    log_factor: float
    noise: Noise


# A further cause at a joint that has one already is more likely a flaw of the first one's equation.
SAME_JOINT = 0.05


def rank(
    case: "Judged", chosen: Array, skip: frozenset[str] = frozenset(), covered: frozenset[str] = frozenset()
) -> Ranking:
    """Posterior over the next cause.

    chosen : columns of causes that are in the model already; skip : their labels, no longer candidates
    covered : labels of those that a cause in the model holds already, no candidates either
    """
    judged = [k for k, (c, _) in enumerate(case.variants) if case.candidates[c].label not in skip | covered]
    grids = case.judged.log_grids([case.groups[k] for k in judged], chosen) + np.log(KAPPA_WEIGHTS)
    base_grid = case.judged.log_base(chosen)
    base = float(np.logaddexp.reduce(base_grid, axis=None))
    log_variant = np.logaddexp.reduce(grids.reshape(len(grids), -1), axis=1) - base
    owner = np.array([case.variants[k][0] for k in judged])
    prior = PRIOR_FURTHER if len(chosen) else PRIOR_FIRST
    weights = prior_weights(case, prior, skip, covered)
    factor, variant, noise = {}, {}, {"": likely_noise(base_grid, case.judged.sigmas)}
    for c, candidate in enumerate(case.candidates):
        if candidate.label in weights:
            own = np.flatnonzero(owner == c)
            factor[candidate.label] = float(np.logaddexp.reduce(log_variant[own], axis=None)) - float(np.log(len(own)))
            best = int(own[first_of_best(log_variant[own], logs=True)])
            variant[candidate.label] = case.variants[judged[best]][1]
            noise[candidate.label] = likely_noise(grids[best], case.judged.sigmas)
    mass = {k: float(np.log(weights[k])) + f for k, f in factor.items()}
    return Ranking(1.0, {}, factor, mass, variant, noise).weighed(float(np.log(prior["none"])))


def prior_weights(
    case: "Judged", prior: Mapping[str, float], skip: frozenset[str], covered: frozenset[str] = frozenset()
) -> dict[str, float]:
    """Listed effects share alike, then each its joints; so do the rarer ones, and all smooth forms have as much."""
    open_ = [c for c in case.candidates if c.label not in skip | covered]
    taken = {c.joint for c in case.candidates if c.label in skip and c.joint is not None}
    names = Counter(c.name for c in open_ if not c.together)
    kinds = {c.name: c.listed for c in open_}
    rare = [name for name, listed in kinds.items() if not listed and name != "unknown"]
    part = {name: prior["listed"] / sum(kinds.values()) for name, listed in kinds.items() if listed}
    part |= {name: prior["unknown"] / 2 / len(rare) for name in rare}
    part["unknown"] = prior["unknown"] / (2 if rare else 1)
    return {c.label: part[c.name] / max(names[c.name], 1) * (SAME_JOINT if c.joint in taken else 1.0) for c in open_}

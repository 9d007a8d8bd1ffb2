"""Posterior probabilities of the next cause: none, each candidate effect, or an unlisted one."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import best_of, ranked
from casadical.diagnosis.candidates import Candidate
from casadical.diagnosis.cross_validation import likely_noise
from casadical.diagnosis.evidence import KAPPA_WEIGHTS
from casadical.diagnosis.settings import SETTINGS
from casadical.measurements.measurements import Noise

if TYPE_CHECKING:
    from casadical.diagnosis.linear_problem import Case

# Prior probabilities of the first cause: no cause, one of the listed effects, an unlisted effect.
PRIOR_FIRST = {"none": 0.25, "listed": 0.55, "unknown": 0.20}
# Prior probabilities of an additional cause, once one was found: none, a listed or an unlisted
# effect.
PRIOR_FURTHER = {"none": 0.65, "listed": 0.20, "unknown": 0.15}


@dataclass(frozen=True, eq=False)
class Ranking:
    """Posterior over the next cause, given those already in the model.

    none : posterior probability that there is no additional cause
    probability : posterior probability of each candidate, by label; they and `none` sum to one
    log_factor : log Bayes factor of each candidate against no additional cause, by label
    log_mass : log_factor plus the log of the candidate's prior probability, by label
    variant : index of the most likely variant (settings) of a candidate, by label; not of a `Rival`
    noise : most likely noise without an additional cause (key "") and with each candidate, by label
    log_noise : increase of the log mass of no additional cause by other forms of noise
    noise_form : the most probable form of noise, where it is more probable than white noise; else
        empty (see `noise_forms`)
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
        """Return the labels of the candidates, the most probable first."""
        labels = list(self.probability)
        return tuple(labels[k] for k in ranked(list(self.probability.values())))

    @classmethod
    def of_variants(cls, logs: Mapping[tuple[str, int], float], weights: Mapping[str, float], none: float) -> "Ranking":
        """Return the posterior over the next cause, each averaged over its variants, without noise.

        logs : log Bayes factor against no additional cause by label and index of the variant
        weights : prior probability of each candidate, by label; none : that of no additional cause
        """
        each: dict[str, dict[int, float]] = {}
        for (label, v), log in logs.items():
            each.setdefault(label, {})[v] = log
        factor, variant = {}, {}
        for label in weights:
            own = each[label]
            factor[label] = float(np.logaddexp.reduce([*own.values()]) - np.log(len(own)))
            variant[label] = best_of(own, own.__getitem__, logs=True)
        mass = {k: float(np.log(weights[k])) + f for k, f in factor.items()}
        return cls(1.0, {}, factor, mass, variant, {}).normalised(float(np.log(none)))

    def normalised(self, none: float) -> "Ranking":
        """Return the ranking with `none` and `probability` computed from its log masses.

        none : log mass of no additional cause
        """
        logs = np.array([none, *self.log_mass.values()])
        share = np.exp(logs - np.logaddexp.reduce(logs, axis=None))
        return replace(
            self, none=float(share[0]), probability=dict(zip(self.log_mass, share[1:].tolist(), strict=True))
        )

    def with_rivals(self, rivals: "Sequence[Rival]", prior: Mapping[str, float]) -> "Ranking":
        """Return the ranking with rivals, such as laws, among its candidates, renormalised.

        prior : one of PRIOR_FIRST and PRIOR_FURTHER; the rivals share that of unlisted effects
        """
        more = replace(
            self,
            log_factor={**self.log_factor, **{r.label: r.log_factor for r in rivals}},
            log_mass={**self.log_mass, **{r.label: float(np.log(prior["unknown"])) + r.log_factor for r in rivals}},
            noise={**self.noise, **{r.label: r.noise for r in rivals}},
        )
        return more.normalised(float(np.log(prior["none"])) + self.log_noise)

    def restricted_to(self, labels: Collection[str]) -> "Ranking":
        """Return the ranking of these candidates only; they and `none` are renormalised."""
        chosen = {k: p for k, p in self.probability.items() if k in labels}
        total = self.none + sum(chosen.values())
        return replace(self, none=self.none / total, probability={k: p / total for k, p in chosen.items()})


@dataclass(frozen=True)
class Rival:
    """An unlisted alternative to the case's candidates, such as an expression found by a search.

    label : name that no candidate has
    log_factor : log Bayes factor against no cause, averaged over its settings, plus the log of the
        fraction that it has of the prior of all rivals, which pays for the selection among them
    noise : most likely noise with this rival in the model
    """

    label: str
    log_factor: float
    noise: Noise


def rank(
    case: "Case", chosen: Array, skip: frozenset[str] = frozenset(), covered: frozenset[str] = frozenset()
) -> Ranking:
    """Return the posterior over the next cause, each averaged over its settings and the noise.

    chosen : indices of the columns of causes that are in the model already
    skip : labels of these causes, which are no longer candidates
    covered : labels of candidates that a cause in the model includes, which are no longer any
    """
    prior = PRIOR_FURTHER if len(chosen) else PRIOR_FIRST
    weights = prior_weights(case.candidates, prior, skip, covered)
    groups = {key: group for key, group in case.groups.items() if key[0] in weights}
    e = case.judged
    grids, base = e.log_grids([*groups.values()], chosen) + np.log(KAPPA_WEIGHTS), e.log_base(chosen)
    none = np.logaddexp.reduce(base, axis=None)
    gains = (np.logaddexp.reduce(grids.reshape(len(grids), -1), axis=1) - none) / e.poses_per_stop
    logs = dict(zip(groups, gains.tolist(), strict=True))
    ranking = Ranking.of_variants(logs, weights, prior["none"])
    grid_of = dict(zip(groups, grids, strict=True))
    likely = {"": base, **{k: grid_of[k, v] for k, v in ranking.variant.items()}}
    return replace(ranking, noise={k: likely_noise(grid, e.sigmas) for k, grid in likely.items()})


def prior_weights(
    candidates: Sequence[Candidate],
    prior: Mapping[str, float],
    skip: frozenset[str],
    covered: frozenset[str] = frozenset(),
) -> dict[str, float]:
    """Return the prior probability of each candidate, by label.

    The prior of listed effects is divided equally among the effects, and that of each effect
    equally among its joints; an effect of the extended list has a quarter of the share of others.
    The prior of unlisted effects is divided in the same way, a quarter among the rare effects, if
    any, and the rest for the smooth forms named "unknown". A candidate at the joint of a cause in
    `skip` has `Settings.same_joint_prior_factor` times its share.
    prior : one of PRIOR_FIRST and PRIOR_FURTHER; skip, covered : see `rank`
    """
    open_ = [c for c in candidates if c.label not in skip | covered]
    taken = {c.joint for c in candidates if c.label in skip and c.joint is not None}
    names = Counter(c.name for c in open_ if not c.together)
    kinds = {c.name: c.listed for c in open_}
    rare = [name for name, listed in kinds.items() if not listed and name != "unknown"]
    odds = {c.name: 0.25 if c.variants[0][0].on_list == "extended" else 1.0 for c in open_ if c.listed}
    part = {name: prior["listed"] * share / sum(odds.values()) for name, share in odds.items()}
    part |= {name: prior["unknown"] / 4 / len(rare) for name in rare}
    part["unknown"] = prior["unknown"] * (0.75 if rare else 1.0)
    return {
        c.label: part[c.name] / max(names[c.name], 1) * (SETTINGS.same_joint_prior_factor if c.joint in taken else 1.0)
        for c in open_
    }

"""Posterior probabilities of the next cause: none, each candidate effect, or an unlisted one."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.search import Posterior, log_factors
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

# Unlisted alternatives to a case's candidates, by label: the log Bayes factor against no cause,
# averaged over settings, plus the log of the share of their prior; and the most likely noise.
Rivals = dict[str, tuple[float, Noise]]


@dataclass(frozen=True, eq=False)
class Ranking(Posterior):
    """Posterior over the next cause of a campaign, and its noise with each; see `Posterior`.

    variant : not of rivals
    noise : most likely noise without an additional cause (key "") and with each candidate, by label
    noise_form : the most probable form of noise, where it is more probable than white noise; else
        empty (see `noise_forms`)
    """

    noise: Mapping[str, Noise] = field(default_factory=dict)
    noise_form: str = ""

    def with_rivals(self, rivals: Rivals, prior: Mapping[str, float]) -> "Ranking":
        """Return the ranking with rivals, such as laws, among its candidates.

        prior : one of PRIOR_FIRST and PRIOR_FURTHER; the rivals share that of unlisted effects
        """
        factor = {label: log for label, (log, _) in rivals.items()}
        return replace(
            self,
            log_factor={**self.log_factor, **factor},
            log_mass={**self.log_mass, **{k: float(np.log(prior["unknown"])) + f for k, f in factor.items()}},
            noise={**self.noise, **{label: noise for label, (_, noise) in rivals.items()}},
        )


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
    base = e.log_base(chosen)
    factors, grids = log_factors(e.log_grids([*groups.values()], chosen), base, KAPPA_WEIGHTS)
    logs = dict(zip(groups, (factors / e.poses_per_stop).tolist(), strict=True))
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

"""Search for causes over one linear model: the posterior over the next one, and the steps.

Poses, joint logs, laws and changes between campaigns supply the candidates: columns, a prior
probability and a label. They are compared by their log Bayes factors, given those that are in the
model already, and added one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, TypeVar

import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import best_of, ranked

Item = TypeVar("Item")


def log_factors(log_grids: Array, log_base: Array, kappa_weights: Array) -> tuple[Array, Array]:
    """Return the log Bayes factor of each group against no additional cause, (groups,) [nats].

    The second item is `log_grids` weighted by the prior of the sizes, the same shape.

    log_grids : log likelihood with each group, shape (groups, points, sigmas, kappas)
    log_base : log likelihood without it, shape (points, sigmas)
    kappa_weights : prior probability of each size of the grid, shape (kappas,)
    """
    weighted = log_grids + np.log(kappa_weights)
    none = np.logaddexp.reduce(log_base, axis=None)
    return np.asarray(np.logaddexp.reduce(weighted.reshape(len(weighted), -1), axis=1) - none), weighted


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior over the next cause, given those already in the model.

    log_none : log mass of no additional cause: its prior probability, and what else adds to it
    log_factor : log Bayes factor of each candidate against no additional cause, by label
    log_mass : log_factor plus the log of the candidate's prior probability, by label
    variant : index of the most likely variant (settings) of a candidate, by label
    """

    log_none: float
    log_factor: Mapping[str, float]
    log_mass: Mapping[str, float]
    variant: Mapping[str, int]

    @classmethod
    def of_variants(cls, logs: Mapping[tuple[str, int], float], weights: Mapping[str, float], none: float) -> Self:
        """Return the posterior over the next cause, each averaged over its variants.

        logs : log Bayes factor against no additional cause by label and index of the variant
        weights : prior probability of each candidate, by label; none : that of no additional cause
        """
        each: dict[str, dict[int, float]] = {}
        for (label, v), log in logs.items():
            each.setdefault(label, {})[v] = log
        factor = {k: float(np.logaddexp.reduce([*each[k].values()]) - np.log(len(each[k]))) for k in weights}
        variant = {k: best_of(each[k], each[k].__getitem__, logs=True) for k in weights}
        mass = {k: float(np.log(weights[k])) + f for k, f in factor.items()}
        return cls(float(np.log(none)), factor, mass, variant)

    @cached_property
    def log_total(self) -> float:
        """Return the log mass of all outcomes together [nats]."""
        return float(np.logaddexp.reduce(np.array([self.log_none, *self.log_mass.values()]), axis=None))

    @property
    def none(self) -> float:
        """Return the posterior probability that there is no additional cause."""
        return float(np.exp(self.log_none - self.log_total))

    @cached_property
    def probability(self) -> Mapping[str, float]:
        """Return the posterior probability of each candidate, by label; all and `none` sum to 1."""
        share = np.exp(np.array([*self.log_mass.values()]) - self.log_total)
        return dict(zip(self.log_mass, share.tolist(), strict=True))

    @property
    def order(self) -> tuple[str, ...]:
        """Return the labels of the candidates, the most probable first."""
        labels = list(self.probability)
        return tuple(labels[k] for k in ranked(list(self.probability.values())))

    def restricted_to(self, labels: Collection[str]) -> Self:
        """Return the posterior over these candidates only and no additional cause."""
        return replace(self, log_mass={k: mass for k, mass in self.log_mass.items() if k in labels})


def stepwise(
    next_given: Callable[[Sequence[Item]], Item], enough: Callable[[Item, Sequence[Item]], bool], most: int
) -> tuple[list[Item], Item]:
    """Return items found one by one, and the last one, which was not enough or is one too many.

    next_given : function that returns the best item in addition to some
    enough : returns whether an item is added to some; most : largest number of items
    """
    found: list[Item] = []
    while enough(last := next_given(found), found) and len(found) < most:
        found.append(last)
    return found, last


def compared_again(found: Sequence[Item], next_given: Callable[[Sequence[Item]], Item]) -> list[Item]:
    """Return the items, of several each found again given the others; see `stepwise`."""
    again = list(found)
    for k in range(len(found) if len(found) > 1 else 0):
        again[k] = next_given([*again[:k], *again[k + 1 :]])
    return again

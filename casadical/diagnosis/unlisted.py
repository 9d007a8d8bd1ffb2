"""What the unknown is worth: its likeliest forms taken into the model, and how far the gap shrinks with them.

A form on no list (any function of a joint's own angle, smooth in time, ...) names no cause. It is a description all
the same, and where it predicts poses that were held out it can be corrected.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..effects import Effect
from ..transforms import Array
from .case import Case
from .gap import Noise, shrink_interval
from .rules import DETECT_FURTHER
from .which import Ranking, rank

MOST_FORMS = 3


@dataclass(frozen=True, eq=False)
class Unlisted:
    """Forms on no list, the likeliest first.

    labels : what they are; effects : they as effects of the model
    before, after : mean held-out gap [m] with the named causes, and with these forms too
    shrink, shrink_interval : share by which it falls, with a 95 % interval
    """

    labels: tuple[str, ...]
    effects: tuple[Effect, ...]
    before: float
    after: float
    shrink: float
    shrink_interval: tuple[float, float]


def unlisted_forms(
    case: Case,
    ranking: Ranking,
    named: tuple[Array, frozenset[str]],
    errors: Callable[[Array, Noise], Array],
    before: Array,
    seed: int,
) -> Unlisted | None:
    """Forms taken up one by one while the likeliest is on no list; None where the first is not.

    ranking : the last one; named : columns and labels of the named causes; before : held-out errors with these,
    shape (kept,) [m]; errors : the same for other columns, with the noise that they leave
    """
    by_label = {c.label: c for c in case.candidates}
    columns, skip = named
    labels: list[str] = []
    effects: list[Effect] = []
    after = before
    while len(labels) < MOST_FORMS and ranking.none <= DETECT_FURTHER:
        label = ranking.order[0]
        if by_label[label].listed:
            break
        found = by_label[label].variants[ranking.variant[label]]
        columns, skip = np.union1d(columns, case.group(found)), skip | {label}
        labels.append(label)
        effects += found
        after = errors(columns, ranking.noise[label])
        ranking = rank(case, columns, skip)
    if not labels:
        return None
    means = float(before.mean()), float(after.mean())
    return Unlisted(
        tuple(labels), tuple(effects), *means, 1 - means[1] / means[0], shrink_interval(before, after, seed)
    )

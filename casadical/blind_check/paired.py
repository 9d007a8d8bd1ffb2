"""Two methods on the same campaigns: how often only one of them is right, and how likely that is if both were as good.

Campaigns on which both are right, or neither, tell nothing of which is better; of the others each would win half
(exact sign test; McNemar 1947).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import comb

from casadical.blind_check.figures import of_kind, seen
from casadical.blind_check.trials import Trial

Right = Callable[[Trial], bool]


@dataclass(frozen=True)
class Pair:
    """One question put to two methods.

    first, other : campaigns on which this one alone is right; both, neither : the rest
    p : probability of so uneven a split, or a more uneven one, between methods that are equally good
    """

    name: str
    first: int
    other: int
    both: int
    neither: int

    @property
    def p(self) -> float:
        n, least = self.first + self.other, min(self.first, self.other)
        return min(1.0, 2 * sum(comb(n, k) for k in range(least + 1)) / (1 << n))

    def __str__(self) -> str:
        return (
            f"{self.first} : {self.other} (of {self.first + self.other + self.both + self.neither}; p = {self.p:.2g})"
        )


def pairs(first: Sequence[Trial], other: Sequence[Trial]) -> list[Pair]:
    """Answers of two methods to the same campaigns, question by question."""
    beside = {t.name: t for t in other}

    def told(name: str, trials: Sequence[Trial], right: Right) -> Pair:
        return _pair(name, [(right(t), right(beside[t.name])) for t in trials])

    listed = [t for t in first if t.kind in ("one", "several")]
    less = [(t.left < beside[t.name].left, beside[t.name].left < t.left) for t in seen(listed)]
    return [
        told("nothing there, and nothing said", of_kind(first, "none"), lambda t: not t.detected),
        told("detected, signal >= .35", [t for t in seen(first) if t.kind != "none"], lambda t: t.detected),
        told("one effect: first cause right, signal >= .35", seen(of_kind(first, "one")), lambda t: t.first_right),
        told("one effect: claimed and right", of_kind(first, "one"), lambda t: t.claimed and t.first_right),
        told("on no list, and not claimed", of_kind(first, "unlisted"), lambda t: not t.claimed),
        told("all campaigns: no wrong claim", first, lambda t: not t.wrongly),
        _pair("listed effects, signal >= .35: less of the gap is left", less),
    ]


def _pair(name: str, right: Sequence[tuple[bool, bool]]) -> Pair:
    return Pair(name, *(right.count(which) for which in ((True, False), (False, True), (True, True), (False, False))))

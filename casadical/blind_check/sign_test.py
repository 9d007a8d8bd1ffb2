"""Two methods on the same campaigns: how often one alone is right, and how likely that is if both are equally good.

Campaigns on which both are right, or neither, do not count; of the others each would win half (exact sign test;
McNemar 1947).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import comb

from casadical.blind_check.metrics import detectable, of_kind
from casadical.blind_check.outcomes import Outcome

Right = Callable[[Outcome, Outcome], bool]


@dataclass(frozen=True)
class SignTest:
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


def sign_tests(first: Sequence[Outcome], other: Sequence[Outcome]) -> list[SignTest]:
    """Answers of two methods to the same campaigns, question by question."""
    twin = {t.name: t for t in other}

    def test(name: str, outcomes: Sequence[Outcome], right: Right) -> SignTest:
        # right : whether the first of two outcomes of a campaign is right (by itself, or better than the second).
        both = [(right(t, twin[t.name]), right(twin[t.name], t)) for t in outcomes]
        splits = ((True, False), (False, True), (True, True), (False, False))
        return SignTest(name, *(both.count(split) for split in splits))

    def smaller(t: Outcome, o: Outcome) -> bool:
        return t.share_left < o.share_left

    none, one, unlisted = (of_kind(first, kind) for kind in ("none", "one", "unlisted"))
    large = [t for t in detectable(first) if t.kind != "none"]
    listed = [t for t in large if t.kind != "unlisted"]
    return [
        test("nothing there, and nothing said", none, lambda t, _: not t.detected),
        test("detected, signal >= .35", large, lambda t, _: t.detected),
        test("one effect: first cause right, signal >= .35", detectable(one), lambda t, _: t.first_right),
        test("one effect: claimed and right", one, lambda t, _: t.claimed and t.first_right),
        test("on no list, and not claimed", unlisted, lambda t, _: not t.claimed),
        test("all campaigns: no wrong claim", first, lambda t, _: not t.wrong_claims),
        test("listed effects, signal >= .35: less of the gap is left", listed, smaller),
    ]

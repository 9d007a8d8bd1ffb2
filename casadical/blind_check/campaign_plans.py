"""Plans of campaigns: shares of none, one, several and unlisted effects; poses, robots, columns left out."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TypeVar

import numpy as np

from casadical.blind_check.protocol import Kind

SHARES: dict[Kind, float] = {"none": 0.25, "one": 0.45, "several": 0.15, "unlisted": 0.15}
POSES = (40, 100, 200)
ROBOTS = ("hh800", "kr210", "ur10e")
# What may not be logged, and how its columns begin.
COLUMNS = {"temperature": "temperature_degC", "payload": "payload_kg", "approach": "approach", "time": "time_s"}
STRUCK = 1 / 3
NOISES = (10e-6, 20e-6, 30e-6)
REPEATABILITIES = (2e-6, 8e-6)

Thing = TypeVar("Thing")


@dataclass(frozen=True)
class Plan:
    """One campaign before it is measured; noise [m], repeatability [rad], seed : of everything else that is drawn."""

    name: str
    robot: str
    kind: Kind
    effects: tuple[str, ...]
    poses: int
    missing: str | None
    noise: float
    repeatability: float
    seed: int

    @property
    def not_logged(self) -> tuple[str, ...]:
        return tuple(self.missing.split(",")) if self.missing else ()


def draw_plans(
    n: int,
    seed: int,
    words: tuple[Sequence[str], Sequence[str]],
    poses: Sequence[int] = POSES,
    *,
    robots: Sequence[str] = ROBOTS,
    noises: Sequence[float] = NOISES,
    struck: float = STRUCK,
) -> list[Plan]:
    """n campaigns in random order; shares are kept as nearly as whole numbers allow, all else takes turns.

    words : effects that are on the diagnosis' list, and on none; poses : numbers of poses of a campaign
    robots, noises [m] : one of these each; struck : share of campaigns in which a column is not logged
    """
    rng = np.random.default_rng([seed, 1])
    kinds = shuffled(rng, in_shares(n, SHARES))
    lacking = shuffled(rng, in_shares(n, {True: struck, False: 1 - struck}))
    names, sizes, columns = turns(rng, robots), turns(rng, poses), turns(rng, tuple(COLUMNS))
    known, foreign = (turns(rng, pool) for pool in words)
    plans = []
    for k, kind in enumerate(kinds):
        count = {"none": 0, "one": 1, "unlisted": 1}.get(kind) if kind != "several" else int(rng.integers(2, 4))
        pool, names_of = (foreign, words[1]) if kind == "unlisted" else (known, words[0])
        robot = next(names)
        plans.append(
            Plan(
                name=f"{robot}-{k + 1:03d}",
                robot=robot,
                kind=kind,
                effects=distinct(pool, min(count or 0, len(set(names_of)))),
                poses=next(sizes),
                missing=next(columns) if lacking[k] else None,
                noise=float(rng.choice(noises)),
                repeatability=float(rng.uniform(*REPEATABILITIES)),
                seed=int(rng.integers(1 << 62)),
            )
        )
    return plans


def in_shares(n: int, shares: dict[Thing, float]) -> list[Thing]:
    """n things in the given shares, rounded by largest remainder."""
    exact = {thing: n * share for thing, share in shares.items()}
    counts = {thing: int(count) for thing, count in exact.items()}
    for thing in sorted(exact, key=lambda t: counts[t] - exact[t])[: n - sum(counts.values())]:
        counts[thing] += 1
    return [thing for thing, count in counts.items() for _ in range(count)]


def shuffled(rng: np.random.Generator, things: Sequence[Thing]) -> list[Thing]:
    return [things[int(k)] for k in rng.permutation(len(things))]


def turns(rng: np.random.Generator, things: Sequence[Thing]) -> Iterator[Thing]:
    """Everything once in random order, then everything again in another, without end."""
    while True:
        yield from shuffled(rng, things)


def distinct(pool: Iterator[Thing], count: int) -> tuple[Thing, ...]:
    """The next things of a pool that differ from each other."""
    things: dict[Thing, None] = {}
    while len(things) < count:
        things.update(dict.fromkeys(islice(pool, 1)))
    return tuple(things)

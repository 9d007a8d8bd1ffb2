"""python docs/studies/grown_scatter.py --keep FILE [--seconds S], then with --table > docs/studies/grown_scatter.txt

How often is a robot named by `casadical fleet` because its last campaign leaves more than those before, where nothing
changed, and where the noise grew?

Campaigns of a simulated UR10e at 12, 20 and 40 random poses with a noise of 0.03 mm, each of another robot as
`fewer_poses.py` builds it: 120 of each number of poses. What they leave, with its degrees of freedom, is drawn 20,000
times for the lives of robots of 2 or 5 campaigns. Of fleets of 1 and of 100 such robots the share of robots is given
that is named, with the noise of the last campaign as before, 1.2 times, 2 times and 3 times it. Beside it: the rule
that was used before, twice the median of those before; and "plain", the share of ratios of two campaigns that chance
exceeds in 1 of 100 by the degrees of freedom, which is 0.01 where these are right. All data are synthetic.

Seed 50 was used while the rule was made; 51 judges.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from itertools import product

import numpy as np
from fewer_poses import ROOT, built, measured
from kept import Row, add_options, rows_of

from casadical import identify
from casadical.core.basics import Array
from casadical.core.statistics import exceeded_by_chance
from casadical.fleet.estimates import estimate
from casadical.fleet.result import ALARMS, grown
from casadical.project.problem import read_campaign_robot

POSES, CAMPAIGNS, SPREAD = (12, 20, 40), 120, 3e-4
LIVES, COUNTS, TIMES, FLEETS = 20_000, (2, 5), (1.0, 1.2, 2.0, 3.0), (1, 100)


def campaign(n: int, k: int, seed: int) -> Row:
    """What one campaign leaves [mm], and its degrees of freedom."""
    rng = np.random.default_rng([seed, n, k])
    nominal = read_campaign_robot(ROOT / "problems/ur10e")
    m = measured(built(nominal, SPREAD, rng), n, rng)
    told = estimate(identify(nominal, m, loss="huber"))
    assert told.sigma is not None
    return {"left": 1e3 * told.sigma, "free": told.freedom}


def lives(found: Array, count: int, times: float, rng: np.random.Generator) -> Iterator[tuple[Array, Array]]:
    """What the campaigns of a robot leave and their degrees of freedom; found : shape (campaigns, 2)."""
    for _ in range(LIVES):
        left, free = found[rng.choice(len(found), count, replace=False)].T
        yield np.where(np.arange(count) < count - 1, 1.0, times) * left, free


def main() -> None:
    parser = argparse.ArgumentParser()
    add_options(parser, "grown_scatter")
    parser.add_argument("--seed", type=int, default=51)
    given = parser.parse_args()
    todo = [(f"{n}-{k}-{given.seed}", (n, k, given.seed)) for n in POSES for k in range(CAMPAIGNS)]
    rows = rows_of(todo, lambda entry: campaign(*entry), given)
    print("poses free  plain | campaigns noise | named: of 1 robot, of 100 | twice the median")
    for n in POSES:
        found = np.array([(r["left"], r["free"]) for r in rows if r["name"].startswith(f"{n}-")])
        rng = np.random.default_rng(given.seed)
        plain = [exceeded_by_chance((a[1] / a[0]) ** 2, d[1], d[0]) < 0.01 for a, d in lives(found, 2, 1.0, rng)]
        for count, times in product(COUNTS, TIMES):
            drawn = list(lives(found, count, times, rng))
            named = [np.mean([bool(grown(a, d, ALARMS / size)) for a, d in drawn]) for size in FLEETS]
            old = np.mean([a[-1] > 2 * np.median(a[:-1]) for a, _ in drawn])
            figures = f"{n:5d} {np.median(found[:, 1]):4.0f} {np.mean(plain):6.4f} | {count:9d} {times:5.1f}"
            print(f"{figures} | {named[0]:17.4f} {named[1]:7.4f} | {old:16.4f}")


if __name__ == "__main__":
    main()

"""python docs/studies/another_robot.py [--seed N] [--lives N] > docs/studies/another_robot.txt

Is a table of another robot told from a robot in which several things changed at once? Lives by drawn estimates as in
`lives.py` (synthetic: 30 monthly campaigns of 40 poses of a UR10e, a KR 210 and an HH800, noise 30 um), in which at one
campaign comes

    robot   another robot of the type: lengths, angles, zeros and bars of both 0.5 mm or mrad from the drawing,
            compliances 30 %, curves 12 urad, tool and frame elsewhere by 1 mm or mrad; since then, or in one alone
    alike   the same, 0.1 mm or mrad and 10 %
    two     zeros of two joints turn by 0.2 to 1 mrad
    four    zeros of joints 2 to 5 do
    crash   zero of a joint, the link after it by 0.1 to 1 mm or mrad, and the tool by 0.1 to 5 mm
    gears   two joints get another gear, as in `lives.py`

Judged when it is first seen, and at the end. Right: another robot is named and nothing else claimed (robot, alike);
it is not claimed (all others). Claims before it happens are counted in both.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping

import numpy as np
from lives import BUILT, CAMPAIGNS, MISFIT, ROBOTS, Life, by_draws, drawn, frame_of, robots, together

from casadical import Robot
from casadical.fleet.comparison import compare
from casadical.fleet.estimates import Estimate
from casadical.fleet.evidence import ROBOT

KINDS = ("robot", "alike", "two", "four", "crash", "gears")
SWAPS = {"robot": (BUILT, 0.3), "alike": (1e-4, 0.1)}


def other(robot: Robot, spread: float, softer: float, rng: np.random.Generator) -> dict[str, float]:
    """How another robot of the type differs from this one [SI]."""
    found = {}
    for p in robot.parameters:
        if p.group in ("geometry", "loop"):
            found[p.name] = np.sqrt(2) * spread * rng.normal()
        elif p.group == "compliance":
            found[p.name] = softer * max(p.value, p.prior) * rng.uniform(-1, 1)
    for j in robot.revolute:
        found |= {f"joint_error_curve.{w}{k}_q{j}": MISFIT * rng.normal() for w in "sc" for k in (1, 2)}
    return found | {n: 1e-3 * rng.normal() for n in ("tool_x", "tool_y", "tool_z", *frame_of(robot))}


def zero(rng: np.random.Generator, joint: int) -> dict[str, float]:
    return {f"theta{joint}": float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(2e-4), np.log(1e-3))))}


def change(kind: str, robot: Robot, rng: np.random.Generator) -> Mapping[str, float]:
    turning = [j for j in (2, 3, 4, 5) if j in robot.revolute]
    if kind in SWAPS:
        return other(robot, *SWAPS[kind], rng)
    if kind == "two":
        return together(*(zero(rng, int(j)) for j in rng.choice(turning, 2, replace=False)))
    if kind == "four":
        return together(*(zero(rng, j) for j in turning))
    if kind == "crash":
        j = int(rng.choice(turning))
        link = [p.name for p in robot.parameters if p.name in (f"alpha{j}", f"a{j}", f"beta{j}", f"d{j + 1}")]
        bent = {n: float(rng.choice([-1, 1]) * rng.uniform(1e-4, 1e-3)) for n in link}
        moved = {n: float(rng.normal() * rng.uniform(1e-4, 5e-3)) for n in ("tool_x", "tool_y", "tool_z")}
        return together(zero(rng, j), bent, moved)
    return together(drawn(robot, "gear", rng).of[-1], drawn(robot, "gear", rng).of[-1])


def one(kind: str, name: str, rng: np.random.Generator) -> tuple[list[Estimate], int]:
    """A life, and the first campaign that shows it."""
    robot = robots(name)[1]
    by, since = change(kind, robot, rng), int(rng.integers(2, CAMPAIGNS - 1))
    alone = kind in SWAPS and rng.random() < 0.5
    of = [by if k == since or (k > since and not alone) else {} for k in range(CAMPAIGNS)]
    return by_draws(name, Life(kind, "", since, "", of), rng), since


def said(told: list[Estimate], same: bool) -> str:
    """robot, robot and more, robot? (not named), another cause, or nothing."""
    changes = compare(told, same_tool=same, same_frame=same).changes
    swapped = [c for c in changes if c.cause.kind == ROBOT]
    if not swapped:
        return "others" if changes else "nothing"
    return "robot" + ("" if swapped[0].named else "?") + (" and more" if len(changes) > 1 else "")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=6)
    parser.add_argument("--lives", type=int, default=30)
    options = parser.parse_args()
    print(f"another_robot.py, seed {options.seed}, {options.lives} lives of each kind; synthetic data")
    for same, words in ((True, "--same-tool --same-frame"), (False, "by default")):
        print(f"\n{words}\n{'kind':8}{'right at once':>14}{'at the end':>11}{'before':>7}   said otherwise")
        for kind in KINDS:
            at_once, at_end, early, wrong = 0, 0, 0, []
            for k in range(options.lives):
                rng = np.random.default_rng([options.seed, KINDS.index(kind), k])
                told, since = one(kind, ROBOTS[k % len(ROBOTS)], rng)
                early += said(told[:since], same) != "nothing"
                answers = said(told[: since + 1], same), said(told, same)
                good = [a == "robot" if kind in SWAPS else not a.startswith("robot") for a in answers]
                at_once, at_end = at_once + good[0], at_end + good[1]
                wrong += [f"{ROBOTS[k % len(ROBOTS)]} {a}" for a, g in zip(answers, good, strict=True) if not g]
            print(f"{kind:8}{at_once:14}{at_end:11}{early:7}   {', '.join(wrong)}", flush=True)


if __name__ == "__main__":
    main()

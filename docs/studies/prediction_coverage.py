"""nice python docs/studies/prediction_coverage.py --log FILE [--draws 200] [--minutes M]; then --print

Do 95 % intervals of predicted positions hold the truth anywhere in the workspace, whatever the poses determined,
and whatever the errors of the robot are beside the priors of its file? Synthetic: every parameter departs from nominal
by a draw from its prior, times .1, .3, 1 or 2 (compliance is never below zero), noise is 0.02 mm a coordinate, and
positions are predicted at 50 poses anywhere within the joint limits. Three robots in turn: the elbow arm of
`arm`, ur10e and kr210 of `problems`; thirteen designs of sixty poses (few poses: 14 to 20).

Good is 92 to 98 % on average over all designs and sizes, no cell (a design, a size) under 85 % in ten robots that
follow each other, and promised standard deviations of at most 5 times the error in each cell. Robots take turns over
the cells, so that a run that is stopped has as many in each, one aside. Seed 34 ran after these rules, and what
they judge, were committed; seed 33 judged the intervals before, of the priors as they are.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy.special import stdtrit
from synthetic import NOISE, measured, readings

from casadical import Body, Identification, Joint, Placement, Robot, identify, read_campaign_robot
from casadical.core.basics import Array, CasadicalError
from casadical.core.transforms import frame
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import unmeasured

SEED, PROBES, TEN = 34, 50, 10
SIZES = (0.1, 0.3, 1.0, 2.0)
PROBLEMS = Path(__file__).parents[2] / "problems"
Draw = Callable[[Robot, np.random.Generator], Array]


def arm() -> Robot:
    """An arm with parallel axes 2 and 3 and compliant joints; base pose and tool point are unknown."""
    right = np.pi / 2
    rows = [(0, 0, 0.4), (right, 0.1, 0), (0, 0.5, 0), (right, 0.05, 0.45), (-right, 0, 0), (right, 0, 0.1)]
    masses = [20.0, 12, 8, 4, 2, 1]
    joints = tuple(
        Joint(alpha=alpha, a=a, d=d, lower=-2.6, upper=2.6, compliance=2e-5 if 0 < i < 5 else None,
              body=Body(mass, np.array([0.2 if i in (1, 2) else 0.0, 0.02, 0.05])))
        for i, ((alpha, a, d), mass) in enumerate(zip(rows, masses, strict=True))
    )  # fmt: skip
    tool = Placement(frame(np.eye(3), np.array([0.05, 0.08, 0.12])), "position")
    return Robot("arm", joints, base=Placement(np.eye(4), "pose"), tool=tool, payload=Body(5.0, np.array([0, 0, 0.1])))


def limits(robot: Robot) -> Array:
    return np.array([(j.lower, j.upper) for j in robot.joints]).T


def standing(*joints: int) -> Draw:
    """Sixty poses; these joints, from 1, stand somewhere. Where joints 1, 4 and 6 do, the tool stays near a plane."""

    def draw(robot: Robot, rng: np.random.Generator) -> Array:
        q = readings(robot, 60, rng)
        rest = [k - 1 for k in joints]
        q[:, rest] = q[0, rest]
        return q

    return draw


def moving(number: int) -> Draw:
    """Sixty poses; so many joints move, the others stand."""

    def draw(robot: Robot, rng: np.random.Generator) -> Array:
        stand = np.sort(rng.permutation(robot.n)[number:])
        return standing(*(stand + 1))(robot, rng)

    return draw


def boxes(number: int) -> Draw:
    """Sixty poses within a tenth of every joint's range, about so many poses."""

    def draw(robot: Robot, rng: np.random.Generator) -> Array:
        q = readings(robot, 60, rng)
        lower, upper = limits(robot)
        middle = readings(robot, number, rng)[np.arange(60) % number]
        return np.asarray(np.clip(middle + 0.1 * (q - (lower + upper) / 2), lower, upper))

    return draw


def anywhere(robot: Robot, rng: np.random.Generator) -> Array:
    return readings(robot, 60, rng)


def few_poses(robot: Robot, rng: np.random.Generator) -> Array:
    """Fourteen to twenty poses anywhere."""
    return readings(robot, int(rng.integers(14, 21)), rng)


def one_pose(robot: Robot, rng: np.random.Generator) -> Array:
    """One pose sixty times."""
    return np.tile(readings(robot, 1, rng), (60, 1))


def half_turns(robot: Robot, rng: np.random.Generator) -> Array:
    """Sixty poses with joint 1 at +180 or -180 deg."""
    q = readings(robot, 60, rng)
    q[:, 0] = np.pi * rng.choice([-1, 1], 60)
    return q


def turning(robot: Robot) -> Robot:
    """The same with a first joint that reaches both half turns."""
    return replace(robot, joints=(replace(robot.joints[0], lower=-1.01 * np.pi, upper=1.01 * np.pi), *robot.joints[1:]))


def half_workspace(robot: Robot, rng: np.random.Generator) -> Array:
    """Sixty poses in the lower or upper half of every joint's range."""
    q = readings(robot, 60, rng)
    lower, upper = limits(robot)
    return np.asarray((lower + q) / 2 if rng.random() < 0.5 else (upper + q) / 2)


DESIGNS: Mapping[str, Draw] = {
    "anywhere": anywhere,
    "few poses": few_poses,
    "half the workspace": half_workspace,
    "one box": boxes(1),
    "two boxes": boxes(2),
    "+-180 deg": half_turns,
    "one plane": standing(1, 4, 6),
    "wrist stands": standing(4, 5, 6),
    "arm stands": standing(1, 2, 3),
    "joint 2 stands": standing(2),
    "two axes": moving(2),
    "one axis": moving(1),
    "one pose": one_pose,
}
Cell = tuple[str, float]


def drawn(robot: Robot, size: float, rng: np.random.Generator) -> Robot:
    """A robot with errors of so many times its priors."""
    values = {p.name: p.value + size * p.prior * rng.normal() for p in robot.parameters}
    return robot.with_values({n: max(v, 0.0) if robot.parameters[n].group == "compliance" else v
                              for n, v in values.items()})  # fmt: skip


def identified(robot: Robot, cell: Cell, rng: np.random.Generator) -> tuple[Identification, Array, Array]:
    """What one robot gave, other poses, and what is predicted wrongly there [m]."""
    built = drawn(robot, cell[1], rng)
    m = measured(built, DESIGNS[cell[0]](robot, rng), rng, NOISE)
    probe = readings(robot, PROBES, rng)
    result = identify(robot, m)
    return result, probe, result.predict(probe)[0] - predicted(built, unmeasured(probe))[0]


def held(result: Identification, covariance: Array, miss: Array) -> dict[str, float]:
    """Share of coordinates in their intervals, rms error and standard deviation [m]."""
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    share = np.mean(np.abs(miss) <= stdtrit(max(1, result.degrees_of_freedom), 0.975) * sigma)
    error, promised = (float(np.sqrt(np.mean(x**2))) for x in (miss, sigma))
    return {"held": float(share), "error": error, "sigma": promised}


def case(robot: Robot, cell: Cell, rng: np.random.Generator) -> dict[str, float] | None:
    """Of one robot; None where the identification refused it in words."""
    try:
        result, probe, miss = identified(robot, cell, rng)
    except CasadicalError as refusal:
        print(f"{cell}: refused: {str(refusal)[:150]}", file=sys.stderr)
        return None
    return held(result, result.predict(probe)[1], miss)


def run(log: Path, draws: int, minutes: float) -> None:
    """Robots that the log does not have yet, by turns over the cells."""
    robots = [turning(r) for r in (arm(), *(read_campaign_robot(PROBLEMS / name) for name in ("ur10e", "kr210")))]
    done = set(read(log))
    end = time.monotonic() + 60 * minutes
    for n, size, name in product(range(draws), SIZES, DESIGNS):
        if (name, size, n) not in done and time.monotonic() < end:
            rng = np.random.default_rng([SEED, list(DESIGNS).index(name), SIZES.index(size), n])
            found = case(robots[n % 3], (name, size), rng)
            with log.open("a", encoding="utf-8") as file:
                file.write(json.dumps([name, size, n, found]) + "\n")


def read(log: Path) -> dict[tuple[str, float, int], dict[str, float] | None]:
    lines = log.read_text(encoding="utf-8").splitlines() if log.exists() else []
    return {(name, size, n): found for name, size, n, found in map(json.loads, lines)}


def report(log: Path) -> None:
    """Held on average, in the worst ten, and sigma over error, of each cell."""
    found = read(log)
    of = {cell: [c for key, c in sorted(found.items()) if key[:2] == cell] for cell in product(DESIGNS, SIZES)}
    kept = {cell: [c for c in cases if c] for cell, cases in of.items()}
    shares = {cell: [c["held"] for c in cases] for cell, cases in kept.items()}
    tens = {
        cell: min(float(np.mean(x[k : k + TEN])) for k in range(0, max(1, len(x) - TEN + 1), TEN))
        for cell, x in shares.items()
    }
    wide = {cell: np.median([c["sigma"] / c["error"] for c in cases]) for cell, cases in kept.items()}
    every = float(np.mean([np.mean(x) for x in shares.values()]))
    low, far = [c for c in tens if tens[c] < 0.85], [c for c in wide if wide[c] > 5]
    numbers = sorted(len(cases) for cases in of.values())
    print(
        f"{numbers[0]} to {numbers[-1]} robots a cell, {sum(numbers) - sum(map(len, kept.values()))} refused in words"
    )
    print(f"{'met' if 0.92 <= every <= 0.98 else 'MISSED'}: 92 to 98 % on average: {every:.1%}")
    print(f"{'MISSED' if low else 'met'}: no ten robots of a cell under 85 %: {len(low)} of {len(tens)} cells are")
    print(f"{'MISSED' if far else 'met'}: sigma at most 5 times the error: {len(far)} of {len(wide)} cells are above")
    print("\nheld (worst ten) sigma over error, median; errors as times the prior")
    print(f"{'design':19s}" + "".join(f"{size:>20g}" for size in SIZES))
    for name in DESIGNS:
        cells = ((name, size) for size in SIZES)
        print(f"{name:19s}" + "".join(f"  {np.mean(shares[c]):6.1%} ({tens[c]:4.0%}) {wide[c]:4.1f}" for c in cells))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--log", type=Path, required=True, help="keeps what is done, so that a run can be continued")
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--minutes", type=float, default=np.inf)
    parser.add_argument("--print", action="store_true", dest="shown")
    given = parser.parse_args()
    if given.shown:
        report(given.log)
    else:
        run(given.log, given.draws, given.minutes)


if __name__ == "__main__":
    main()

"""nice python docs/studies/prediction_coverage.py [DRAWS] [SEED] > docs/studies/prediction_coverage.txt

Do 95 % intervals of predicted positions hold the truth anywhere in the workspace, when the measured poses did not
determine the whole robot? Synthetic: in each design every parameter of the robot departs from nominal by a draw from
the priors of its file (compliance is never below zero), noise is 0.02 mm a coordinate, and positions are predicted at
50 poses anywhere within the joint limits. Three robots in turn: the elbow arm of `coverage.py`, ur10e and kr210 of
`problems`. DRAWS designs of each of the six kinds (50 without an argument: 300 designs). The formula was settled on
draws of seed 16; SEED is 17 without an argument.

`--log FILE --seconds S` runs it in pieces: each continues where the log ends, and the last one prints.

"identified only" is what `Identification.predict` claimed before: the covariance of the identified parameters alone.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from time import process_time

import numpy as np
from coverage import arm
from synthetic import NOISE, measured, readings

from casadical import Identification, Robot, identify, read_campaign_robot
from casadical.core.arrays import Array
from casadical.core.errors import CasadicalError
from casadical.core.statistics import student_t
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import unmeasured

DRAWS, PROBES = 50, 50
PROBLEMS = Path(__file__).parents[2] / "problems"
Draw = Callable[[Robot, np.random.Generator], Array]


def limits(robot: Robot) -> Array:
    return np.array([(j.lower, j.upper) for j in robot.joints]).T


def one_plane(robot: Robot, rng: np.random.Generator) -> Array:
    """Sixty poses whose tool points lie within 1 mm of one upright plane before the robot: joints 1, 4 and 6 stand."""
    q = readings(robot, 60, rng)
    q[:, [0, 3, 5]] = q[0, [0, 3, 5]]
    return q


def one_axis(robot: Robot, rng: np.random.Generator) -> Array:
    """Sixty poses, one joint moves."""
    q = readings(robot, 60, rng)
    moves = rng.integers(robot.n)
    rest = np.arange(robot.n) != moves
    q[:, rest] = q[0, rest]
    return q


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
    "one plane": one_plane,
    "one axis": one_axis,
    "few poses": few_poses,
    "one pose": one_pose,
    "+-180 deg": half_turns,
    "half the workspace": half_workspace,
}


def drawn(robot: Robot, rng: np.random.Generator) -> Robot:
    """A robot as its priors say it may be built."""
    values = {p.name: p.value + p.prior * rng.normal() for p in robot.parameters}
    return robot.with_values({n: max(v, 0.0) if robot.parameters[n].group == "compliance" else v
                              for n, v in values.items()})  # fmt: skip


def identified_only(result: Identification, q: Array) -> Array:
    """Covariance of positions by the identified parameters alone, shape (n, 3, 3) [m^2]."""
    names, step = result.names, 1e-6
    columns = []
    for name in names:
        p = result.start.parameters[name]
        sides = []
        for sign in (1, -1):
            values = dict(zip(names, result.estimate, strict=True))
            values[name] += sign * step * p.scale
            sides.append(predicted(result.start, unmeasured(q), values)[0])
        columns.append((sides[0] - sides[1]) / (2 * step * p.scale))
    J = np.stack(columns, axis=2)
    return np.asarray(J @ np.nan_to_num(result.covariance) @ J.transpose(0, 2, 1))


def case(robot: Robot, draw: Draw, rng: np.random.Generator) -> dict[str, float] | None:
    """Coverage, errors and standard deviations of one design; None where the identification refused it in words."""
    built = drawn(robot, rng)
    m = measured(built, draw(robot, rng), rng, NOISE)
    probe = readings(robot, PROBES, rng)
    try:
        result = identify(robot, m)
    except CasadicalError as refusal:
        print(f"refused: {str(refusal)[:150]}", file=sys.stderr)
        return None
    p, covariance = result.predict(probe)
    miss = p - predicted(built, unmeasured(probe))[0]
    t = student_t(0.975, result.degrees_of_freedom)
    sigmas = {"all": covariance, "only": identified_only(result, probe)}
    found = {"error": float(np.linalg.norm(miss, axis=1).mean())}
    for name, C in sigmas.items():
        sigma = np.sqrt(np.diagonal(C, axis1=1, axis2=2))
        found[f"cover_{name}"] = float(np.mean(np.abs(miss) <= t * sigma))
        found[f"sigma_{name}"] = float(np.linalg.norm(sigma, axis=1).mean())
    return found


def cases(draws: int, seed: int, log: Path | None, seconds: float) -> dict[str, list[dict[str, float] | None]] | None:
    """Of each kind of design; None where processor time was up before all were done, which the log keeps."""
    robots = [turning(r) for r in (arm(), *(read_campaign_robot(PROBLEMS / name) for name in ("ur10e", "kr210")))]
    lines = log.read_text(encoding="utf-8").splitlines() if log and log.exists() else []
    done = {(k, n): found for given, k, n, found in map(json.loads, lines) if given == seed}
    for n, k in product(range(draws), range(len(DESIGNS))):
        if (k, n) in done:
            continue
        if process_time() > seconds:
            return None
        done[k, n] = case(robots[n % 3], list(DESIGNS.values())[k], np.random.default_rng([seed, k, n]))
        if log:
            with log.open("a", encoding="utf-8") as file:
                file.write(json.dumps([seed, k, n, done[k, n]]) + "\n")
    return {name: [done[k, n] for n in range(draws)] for k, name in enumerate(DESIGNS)}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("draws", nargs="?", type=int, default=DRAWS)
    parser.add_argument("seed", nargs="?", type=int, default=17)
    parser.add_argument("--log", type=Path, help="keeps what is done, so that a run can be continued")
    parser.add_argument("--seconds", type=float, default=np.inf, help="of processor time, in one run")
    given = parser.parse_args()
    found = cases(given.draws, given.seed, given.log, given.seconds)
    if found is None:
        return
    rows = {name: ([c for c in kind if c], sum(c is None for c in kind)) for name, kind in found.items()}
    whole = [c for kept, _ in rows.values() for c in kept]
    rows["all"] = whole, sum(refused for _, refused in rows.values())
    shares = [float(np.mean([c["cover_all"] for c in kept])) for kept, _ in rows.values()]
    met = all(0.9 <= share <= 0.99 for share in shares)
    print(f"{'met' if met else 'MISSED'}: 95 % intervals of positions hold 90 to 99 % in every kind of design")
    print()
    print("                                     error  |  predict:  sigma  held |  identified only:  sigma    held")
    print("design              fitted  refused     mm  |               mm   in  |                       mm      in")
    for (name, (kept, refused)), share in zip(rows.items(), shares, strict=True):
        mean = {key: float(np.mean([c[key] for c in kept])) for key in kept[0]}
        print(
            f"{name:18s} {len(kept):7d} {refused:8d} {1e3 * mean['error']:7.3f}  | {1e3 * mean['sigma_all']:15.3f} "
            f"{share:6.1%} | {1e3 * mean['sigma_only']:24.4f}  {mean['cover_only']:6.1%}"
        )


if __name__ == "__main__":
    main()

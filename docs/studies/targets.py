"""Several targets on one flange without a column that names them: recognised from repeats, with their distances.

    python docs/studies/targets.py [--tables N] [--accuracy N] [--clean N] [--seed S]

Arms, poses and departures from the drawing are plain numpy (see slips.py). Each pose has one row for each of three
targets of a nest, in one order or in a random one, with readings that differ by up to 0.003 deg and noise of 0.05 to
0.3 mm. In half of the tables some poses lack one or two targets, and some rows are bad. A nest is 20 to 250 mm wide;
one in four has two sides of the same length.

Recognised: three targets, every distance within 0.5 mm of the nest's, and no more than one row in a hundred (bad rows
aside) of the wrong target. Clean tables have one target, measured up to four times at each pose: with bad rows, a
station that moves by 5 to 200 mm or turns, drift, readings one row off, or backlash. None may be split into targets.
That repeats disagree (a warning) may be said where the station moves or drifts.

Accuracy: the arm calibrated with the three targets of a table as they were recognised, and with each of them alone,
bad rows included; errors at 200 poses that were not measured, against the arm as built, without noise. The best
alone is the target whose own calibration has the least error at that target.
"""

import argparse
import sys
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "cli"))
import first_hour
from slips import ARMS, robots

from casadical.core.basics import ConvergenceError, InputError
from casadical.core.parts import Target
from casadical.core.transforms import frame
from casadical.identification.accuracy import predicted
from casadical.identification.identification import identify
from casadical.measurements.measurements import unmeasured
from casadical.measurements.reading import from_table
from casadical.project.targets import recognised
from casadical.robot.robot import Robot

WITHIN = 0.5
UNSEEN = 200
CLEAN = ("repeats", "bad rows", "station moved", "station turned", "drift", "shifted", "backlash", "one row a pose")


def turn(rng: np.random.Generator) -> np.ndarray:
    """A rotation of the measuring frame."""
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def nest(rng: np.random.Generator) -> np.ndarray:
    """Three points on the flange, shape (3, 3) [mm]."""
    while True:
        points = [40, -20, 120] + rng.uniform(-1, 1, (3, 3)) * rng.uniform(20, 120)
        if rng.random() < 0.25:  # two sides of the same length
            middle, way = (points[0] + points[1]) / 2, points[1] - points[0]
            across = np.cross(way, rng.normal(size=3))
            points[2] = middle + across / np.linalg.norm(across) * rng.uniform(20, 120)
        sides = [np.linalg.norm(points[a] - points[b]) for a, b in ((0, 1), (0, 2), (1, 2))]
        if min(sides) > 20:
            return points


def arm_of(rng: np.random.Generator, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows as drawn and as built."""
    rows = np.array(list(ARMS.values())[k % len(ARMS)], dtype=float)
    return rows, rows + rng.normal(0, 1, rows.shape) * [0.03, 0.4, 0.4, 0.04]


def measured(rng: np.random.Generator, built: np.ndarray, q: np.ndarray, tool: np.ndarray, noise: float) -> np.ndarray:
    """Positions [mm] in the station's frame."""
    p = station(first_hour.positions(q, built, tool))
    return p + rng.normal(0, noise, p.shape)


def station(p: np.ndarray) -> np.ndarray:
    return p @ turn(np.random.default_rng(5)).T + [1800, -700, 400]


def answer(rows: np.ndarray, q: np.ndarray, p: np.ndarray):
    """What the package says of a table; q [deg], p [mm]."""
    names = [*(f"q{k}_deg" for k in range(1, len(rows) + 1)), "x_mm", "y_mm", "z_mm"]
    table = pd.DataFrame(np.column_stack([q, p]), columns=names)
    return recognised(robots([], rows)[0], from_table(table, len(rows), "position"))


@dataclass(frozen=True, eq=False)
class Nested:
    """One table of a nest: readings q (n, joints) [deg], positions p (n, 3) [mm], the true target of each row, bad."""

    rows: np.ndarray
    built: np.ndarray
    points: np.ndarray
    noise: float
    q: np.ndarray
    p: np.ndarray
    which: np.ndarray
    bad: np.ndarray
    poses: int


def table_of(k: int, seed: int) -> Nested:
    rng = np.random.default_rng([seed, k])
    rows, built = arm_of(rng, k)
    points, noise = nest(rng), rng.uniform(0.05, 0.3)
    poses, ordered, messy = int(rng.integers(15, 50)), rng.random() < 0.5, rng.random() < 0.5
    base = np.round(rng.uniform(-100, 100, (poses, len(rows))), 3)
    listed = []
    for i in range(poses):
        order = [0, 1, 2] if ordered else list(rng.permutation(3))
        gone = rng.integers(1, 3) if messy and rng.random() < 0.25 else 0
        listed += [(i, j) for j in order[: 3 - gone]]
    at, which = np.array(listed).T
    if not ordered and rng.random() < 0.5:
        mixed = rng.permutation(len(at))
        at, which = at[mixed], which[mixed]
    q = base[at] + np.round(rng.uniform(-0.003, 0.003, (len(at), len(rows))), 4)
    p = measured(rng, built, q, points[which], noise)
    bad = np.zeros(len(p), dtype=bool)
    if messy:
        bad[rng.choice(len(p), max(1, len(p) // 30), replace=False)] = True
        p[bad] += rng.normal(0, 60, (bad.sum(), 3))
    return Nested(rows, built, points, noise, q, p, which, bad, poses)


def nested(k: int, seed: int) -> tuple[bool, str]:
    """One table of a nest: whether it is recognised, and what was found."""
    t = table_of(k, seed)
    points, poses, which, bad, noise = t.points, t.poses, t.which, t.bad, t.noise
    found = answer(t.rows, t.q, t.p)
    if found is None:
        return False, f"{poses} poses: nothing"
    sides = np.sort([np.linalg.norm(points[a] - points[b]) for a, b in ((0, 1), (0, 2), (1, 2))])
    if found.count != 3:
        return False, f"{poses} poses: {found.count} targets"
    off = float(np.abs(1e3 * found.distances - sides).max())
    if found.which is None:
        return False, f"{poses} poses: distances {off:.2f} mm off, not distinguished"
    wrong = min(float(np.mean((np.array(o)[found.which] != which)[~bad])) for o in permutations(range(3)))
    text = f"{poses} poses, sides {sides.round(1)} mm, noise {noise:.2f}: {off:.2f} mm off, "
    text += f"{100 * wrong:.0f} % of rows wrong"
    return off < WITHIN and wrong <= 0.01, text


def accuracies(k: int, seed: int) -> tuple[float, float, float] | None:
    """Errors of one table at poses that were not measured, means [mm] against the arm as built, or None.

    Of each target calibrated alone, the least, at its own target; of the three together, as they were recognised, at
    the same target, and at all three. None where a target alone has too few poses for the arm, or nothing was
    recognised.
    """
    t = table_of(k, seed)
    rng = np.random.default_rng([seed, k, 2])
    found = answer(t.rows, t.q, t.p)
    if found is None or found.which is None or found.points is None:
        return None
    robot = robots([], t.rows)[0]
    joints = t.q.shape[1]
    names = [*(f"q{i}_deg" for i in range(1, joints + 1)), "x_mm", "y_mm", "z_mm"]
    table = pd.DataFrame(np.column_stack([t.q, t.p]), columns=names).assign(tool=np.array(found.names)[found.which])
    q = rng.uniform(-100, 100, (UNSEEN, joints))
    # The names that were given, in the order of the nest.
    given = [np.bincount(found.which[t.which == j], minlength=3).argmax() for j in range(3)]
    truth = [station(first_hour.positions(q, t.built, t.points[j])) for j in range(3)]

    def errors(arm: Robot) -> list[float]:
        means = []
        for j in range(3):
            at = {target.column: np.full(UNSEEN, float(target.name == found.names[given[j]])) for target in arm.targets}
            p, _ = predicted(arm, unmeasured(np.deg2rad(q), at))
            means.append(float(np.linalg.norm(1e3 * p - truth[j], axis=1).mean()))
        return means

    alone = []
    for j in range(3):
        own = from_table(table[found.which == given[j]].drop(columns="tool"), joints, "position")
        try:
            arm = identify(robot, own, method="KM", loss="huber").robot
        except (InputError, ConvergenceError):
            return None
        alone.append(errors(arm)[j])
    tool = robot.tool.T
    targets = tuple(Target(n, point) for n, point in zip(found.names[1:], found.points[1:], strict=True))
    first = frame(tool[:3, :3], found.points[0])
    several = replace(robot, tool=replace(robot.tool, T=first), tool_name=found.names[0], targets=targets)
    m = from_table(table, joints, "position")
    together = errors(identify(several, m, method="KM", loss="huber").robot)
    best = int(np.argmin(alone))
    return alone[best], together[best], float(np.mean(together))


def clean(k: int, seed: int) -> tuple[str, bool, bool]:
    """One table of one target: what was done to it, whether it was split, whether repeats were said to disagree."""
    rng = np.random.default_rng([seed, k, 1])
    kind = CLEAN[k % len(CLEAN)]
    rows, built = arm_of(rng, k // len(CLEAN))
    poses, times, noise = int(rng.integers(15, 50)), int(rng.integers(2, 5)), rng.uniform(0.05, 0.3)
    base = np.round(rng.uniform(-100, 100, (poses, len(rows))), 3)
    at = np.repeat(np.arange(poses), times) if rng.random() < 0.5 else np.tile(np.arange(poses), times)
    at = np.arange(poses) if kind == "one row a pose" else at
    q = base[at] + np.round(rng.uniform(-0.003, 0.003, (len(at), len(rows))), 4)
    p = measured(rng, built, q, nest(rng)[0], noise)
    n, half = len(p), np.arange(len(p)) >= rng.uniform(0.3, 0.7) * len(p)
    if kind == "bad rows":
        p[rng.choice(n, n // 10, replace=False)] += rng.normal(0, 50, (n // 10, 3))
    elif kind == "station moved":
        p[half] += rng.normal(size=3) / np.sqrt(3) * rng.uniform(5, 200)
    elif kind == "station turned":
        angle = np.deg2rad(rng.uniform(0.3, 10))
        c, s = np.cos(angle), np.sin(angle)
        p[half] = p[half] @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T
    elif kind == "drift":
        p += np.linspace(0, 1, n)[:, None] * rng.normal(size=3) * 10
    elif kind == "shifted":
        q, p = q[1:], p[:-1]
    elif kind == "backlash":
        p += first_hour.positions(q + rng.choice([-1, 1], q.shape) * 0.02, built, np.zeros(3)) - first_hour.positions(
            q, built, np.zeros(3)
        )
    found = answer(rows, q, p)
    return kind, found is not None and found.which is not None, found is not None


def print_accuracy(tables: int, seed: int) -> None:
    found = np.array([r for k in range(tables) if (r := accuracies(k, seed)) is not None])
    if not len(found):
        return
    alone, same, every = found.T
    print(f"calibrated with all three targets, of {len(found)} tables in which each target alone has poses enough:")
    print(f"   mean error [mm] of the best target alone {alone.mean():.3f}; of all three at that target "
          f"{same.mean():.3f}, at all targets {every.mean():.3f}")  # fmt: skip
    for what, e in (("at that target", same), ("at all targets", every)):
        r = e / alone
        print(f"   {what}: at least as accurate as the best alone in {np.mean(r <= 1):.0%}; ratio median "
              f"{np.median(r):.3f}, largest {r.max():.3f}")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tables", type=int, default=50)
    parser.add_argument("--clean", type=int, default=200)
    parser.add_argument("--accuracy", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    print(f"{given.tables} made-up tables of three targets without a column that names them; seed {given.seed}")
    good = 0
    for k in range(given.tables):
        ok, text = nested(k, given.seed)
        good += ok
        if not ok:
            print(f"   {list(ARMS)[k % len(ARMS)]}, table {k}: {text}", flush=True)
    print(f"recognised with right distances: {good} of {given.tables}")
    print_accuracy(given.accuracy, given.seed)
    kinds = {kind: [0, 0, 0] for kind in CLEAN}
    for k in range(given.clean):
        kind, split, said = clean(k, given.seed)
        kinds[kind] = [a + b for a, b in zip(kinds[kind], (1, split, said), strict=True)]
    for kind, (n, split, said) in kinds.items():
        print(f"one target, {kind}: {split} of {n} split, repeats disagree in {said}")
    print(f"clean tables that were split: {sum(v[1] for v in kinds.values())} of {given.clean}")


if __name__ == "__main__":
    main()

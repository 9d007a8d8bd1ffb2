"""python docs/studies/carried_over.py [--robots DIR] [--seeds N] > docs/studies/carried_over.txt

Curves of one campaign as the prior of the next: three series of one UR10, each with its own base frame.

Of each series about 70 % of the poses (of A 2800) give the calibrated robot with joint error curves, kept as a robot
file. Another series then gives 100 poses, from which its base and tool are fitted again; the mean error is that of all
its other poses, which nothing has seen. Three gross errors of series B (lines 534, 856 and 857 of the file) are left
out. Columns: calibrated without curves; frozen curves at their values; the same, on poses alone whose readings lie in
the ranges of the first campaign; own curves, learnt from the 100 poses; the other campaign's curves as a prior.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from real_diagnoses import ROOT, campaign

from casadical import identify, read_robot, write_robot
from casadical.effects import JointErrorCurve
from casadical.identification.accuracy import errors
from casadical.identification.prior import carry_over
from casadical.identification.result import Identification
from casadical.measurements.measurements import Measurements
from casadical.project.problem import read_problem
from casadical.robot.robot import Robot

NAMES = {"A": "ur10_grid", "B": "ur10_joints", "C": "ur10"}
LEARNT = {"A": 2800, "B": 1046, "C": 2000}
GROSS = [534, 856, 857]
PAIRS = (("A", "B"), ("A", "C"), ("B", "C"), ("C", "B"))
FEW = 100
BASE = ("kinematic", "compliance")


def series(which: str) -> tuple[Robot, Measurements]:
    """The nominal robot and all poses of a series."""
    robot = read_problem(ROOT / "problems" / NAMES[which]).robot
    m = campaign(NAMES[which], robot)
    return robot, m[~np.isin(m.row, GROSS)] if which == "B" else m


def with_own_curves(robot: Robot, m: Measurements) -> Identification:
    base = identify(robot, m, BASE, loss="huber", priors=True, screen=False).robot
    curve = JointErrorCurve().for_poses(len(m))
    return identify(base.with_effect(curve), m, (*BASE, curve.label), priors=True)


def learnt(which: str, file: Path) -> Robot:
    """The robot of a series as its file gives it; identified first where there is none."""
    if not file.exists():
        robot, m = series(which)
        poses = np.random.default_rng(0).permutation(len(m))[: LEARNT[which]]
        write_robot(with_own_curves(robot, m[np.sort(poses)]).robot, file)
    return read_robot(file)


def compared(robot: Robot, other: Robot, m: Measurements, seed: int) -> list[float]:
    """Mean errors [mm] on poses never seen, and the share of these that the other campaign's ranges cover."""
    order = np.random.default_rng(seed).permutation(len(m))
    train, test = m[np.sort(order[:FEW])], m[np.sort(order[FEW:])]
    held, prior = carry_over(robot, other, frozen=True)
    low, high = prior.knowledge.readings.T
    covered = ((test.q >= low) & (test.q <= high)).all(axis=1)
    calibrated = identify(robot, train, BASE, loss="huber", priors=True).robot
    frozen = errors(identify(held, train, BASE, priors=True).robot, test)
    own = with_own_curves(robot, train).robot
    carried = identify(robot, train, BASE, prior=other).robot
    means = [errors(r, test).mean() for r in (calibrated, own, carried)]
    inside = frozen[covered].mean() if covered.any() else np.nan
    return [1e3 * float(v) for v in (means[0], frozen.mean(), inside, *means[1:], 1e-3 * covered.mean())]


def main(folder: Path, seeds: int) -> None:
    print(f"mean error [mm] on poses never seen, {FEW} poses of the second series; {seeds} seeds, mean (least to most)")
    print(f"{'':8}{'calibrated':>12}{'frozen':>9}{'where covered':>15}{'share':>7}{'own curves':>12}{'as prior':>26}")
    for first, second in PAIRS:
        other = learnt(first, folder / f"{first}.toml")
        robot, m = series(second)
        rows = np.array([compared(robot, other, m, seed) for seed in range(seeds)])
        calibrated, frozen, inside, own, carried, share = rows.mean(axis=0)
        spread = f"{carried:.3f} ({rows[:, 4].min():.3f} to {rows[:, 4].max():.3f})"
        print(
            f"{first} -> {second:<3}{calibrated:12.3f}{frozen:9.3f}{inside:15.3f}{100 * share:5.0f} %{own:12.3f}"
            f"{spread:>26}",
            flush=True,
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--robots", type=Path, help="where the robot files of the series are, or are kept")
    parser.add_argument("--seeds", type=int, default=5)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        main(given.robots or Path(folder), given.seeds)

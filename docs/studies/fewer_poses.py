"""python docs/studies/fewer_poses.py [--robots N] [--new N] [--spread MM ...] [NAME ...] > docs/studies/fewer_poses.txt

How many poses a new robot needs with the prior of its fleet: for the accuracy that 60 poses give alone.

A fleet of 20 simulated robots of one type, each measured at 60 poses (noise 30 um a coordinate): geometry off from
robot to robot by a spread of 0.3 mm and mrad, or of a tenth of it; one length by 0.3 mm more in all; compliances
1.3 times those of the drawing, give or take a tenth. What they have in common is learnt as `casadical fleet` does
(`casadical.fleet.hierarchy`). Five new robots of the type are then identified from 10 to 60 poses, alone and with that
prior (`identify(priors=...)`). The accuracy is the mean error at 200 other poses without noise, averaged over the
robots; between two numbers of poses its logarithm is taken as linear in that of the number; nan: too few poses for a
result. Wanted: a third, 20 poses. All data are synthetic.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from casadical import Measurements, Robot, identify
from casadical.core.arrays import Array
from casadical.core.errors import CasadicalError
from casadical.core.transforms import frame, from_rpy
from casadical.fleet import estimate
from casadical.fleet.hierarchy import common_of
from casadical.fleet.one_robot import NOTHING, told_of
from casadical.identification.accuracy import errors, predicted
from casadical.project.problem import read_campaign_robot

ROOT = Path(__file__).parents[2]
NAMES = ("hh800", "kr210", "ur10e")
FULL, POSES, OTHER, NOISE = 60, (10, 15, 20, 30, 40, 60), 200, 3e-5
FAULT, SOFTER, SHARE = 3e-4, 1.3, 0.1
FAULTY = "a2"
CLOSED = 0.05


def built(robot: Robot, spread: float, rng: np.random.Generator) -> Robot:
    """One robot of the type, in its own place."""
    values = {}
    for p in robot.parameters:
        if p.group == "compliance":
            values[p.name] = max(p.value, p.prior) * SOFTER * (1 + SHARE * rng.normal())
        elif p.group in ("geometry", "loop"):
            values[p.name] = p.value + spread * rng.normal() + FAULT * (p.name == FAULTY)
        elif p.group == "tool":
            values[p.name] = p.value + 1e-3 * rng.normal()
    moved = robot.with_values(values)
    T = frame(from_rpy(rng.uniform(-0.3, 0.3, 3)), rng.uniform(-1, 1, 3))
    return replace(moved, base=replace(moved.base, T=moved.base.T @ T))


def measured(robot: Robot, n: int, rng: np.random.Generator, noise: float = NOISE) -> Measurements:
    lower, upper = np.array([(j.lower, j.upper) for j in robot.joints]).T
    q = rng.uniform(lower, upper, (5 * n, robot.n))
    bare = Measurements(q=q, kind="position", position=np.zeros((len(q), 3)))
    p, _ = predicted(robot, bare)
    w = bare.condition_matrix(robot.conditions, robot.declared)
    (margin,) = robot.model.evaluate(("margin",), q, w, robot.parameters.values)
    closed = (margin.reshape(-1, len(q)) > CLOSED).all(axis=0)  # of four-bars
    good = np.flatnonzero(closed & np.isfinite(p).all(axis=1))[:n]
    return replace(bare[good], position=p[good] + noise * rng.normal(size=(len(good), 3)))


def row(nominal: Robot, m: Measurements) -> dict[str, object]:
    found = identify(nominal, m)
    about = {"identified": list(found.names), "type": "", "type_name": nominal.name, "status": "ok"}
    return {**NOTHING, **about, **told_of(estimate(found), nominal)}


def error(nominal: Robot, robot: Robot, n: int, seed: int, priors: Mapping[str, tuple[float, float]] | None) -> float:
    """Mean error [mm] at poses that nothing has seen; NaN where too few poses give no result."""
    m = measured(robot, n, np.random.default_rng([seed, n]))
    other = measured(robot, OTHER, np.random.default_rng([seed, 999]), noise=0.0)
    try:
        found = identify(nominal, m, priors=priors or False)
    except CasadicalError:
        return float("nan")
    return 1e3 * float(errors(found.robot, other).mean())


def needed(poses: Array, means: Array, wanted: float) -> float:
    """Poses at which the error has fallen to the wanted one; infinite where it does not."""
    good = np.flatnonzero(means <= wanted)
    if not good.size:
        return float("inf")
    k = int(good[0])
    if k == 0:
        return float(poses[0])
    x, y = np.log(poses[k - 1 : k + 1]), np.log(means[k - 1 : k + 1])
    return float(np.exp(np.interp(-np.log(wanted), -y, x))) if np.isfinite(y).all() else float(poses[k])


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*", default=list(NAMES))
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--new", type=int, default=5)
    parser.add_argument("--spread", type=float, nargs="*", default=[0.3, 0.03], help="mm and mrad")
    options = parser.parse_args()
    for name, mm in ((n, s) for n in options.names for s in options.spread):
        spread = 1e-3 * mm
        nominal = read_campaign_robot(ROOT / "problems" / name)
        rows = []
        for k in range(options.robots):
            rng = np.random.default_rng([1, k])
            rows.append(row(nominal, measured(built(nominal, spread, rng), FULL, rng)))
        common = common_of(pd.DataFrame(rows))
        priors = common.priors_of(nominal)
        faults = ", ".join(f"{n} {m:+.3f} +/- {e:.3f}" for n, m, e in common.faults if not n.startswith("c"))
        print(f"{name}, spread {mm} mm: {options.robots} robots, {options.new} new; common faults [mm, mrad]: {faults}")
        means = {}
        for words, prior in (("alone", None), ("with the fleet", priors)):
            all_ = [
                [error(nominal, built(nominal, spread, np.random.default_rng([2, k])), n, k, prior) for n in POSES]
                for k in range(options.new)
            ]
            means[words] = np.array(all_).mean(axis=0)
            print(f"  {words:15}" + "".join(f"{n:5d}: {e:.4f} mm" for n, e in zip(POSES, means[words], strict=True)))
        wanted = means["alone"][-1]
        n = needed(np.array(POSES), means["with the fleet"], wanted)
        print(f"  poses needed with the fleet for what {FULL} give alone: {n:.1f} ({n / FULL:.2f} of them)", flush=True)


if __name__ == "__main__":
    main()

"""python docs/studies/real_diagnoses.py [--poses N] > docs/studies/real_diagnoses.txt

Diagnoses of the real sets: what the causes that are named are worth on poses that the diagnosis never saw.

Of each UR10 series, N poses drawn from the first 60 % of the campaign are diagnosed. The robot with the causes in its
model is then tried on other poses of the same 60 % ("same time") and on the last 40 % ("later"), beside the calibrated
base model. Blunders (errors beyond 3 mm with the base model) are left out of these figures, alike for all. No figure of
these sets had a part in any threshold of the diagnosis.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

from casadical import diagnose
from casadical.diagnosis.laws.discovery import describe_unlisted
from casadical.identification.accuracy import errors
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import from_table
from casadical.project.problem import read_problem
from casadical.robot.robot import Robot

ROOT = Path(__file__).parents[2]
SERIES = {
    "ur10": "series_C_random_poses",
    "ur10_joints": "series_B_joint_configurations",
    "ur10_grid": "series_A_grid",
}
BLUNDER = 3e-3
LAGS = ("warmth_0s", "warmth_300s", "warmth_600s", "warmth_1200s", "warmth_2400s")


def campaign(name: str, robot: Robot) -> Measurements:
    """A whole series in its order, with every column that an effect may need, derived before anything is split."""
    table = pd.read_csv(ROOT / "data" / "ur10_laser_tracker" / f"{SERIES[name]}.csv")
    stamps = pd.to_datetime(table["timestamp_raw"].astype(str), format="%Y%m%d%H%M%S", errors="coerce")
    table = table.drop(columns=[c for c in table if c.startswith(("goal_", "std_", "timestamp"))])
    if stamps.notna().all():
        table["time_s"] = (stamps - stamps.min()).dt.total_seconds()
    m = from_table(table.rename(columns={"order": "pose"}), robot.n, "position", source=name)
    return derive(m, ["progress", *LAGS, *(f"approach{i}" for i in range(1, robot.n + 1))])[0]


def figures(error: np.ndarray) -> str:
    return f"{1e3 * error.mean():6.3f} {1e3 * np.median(error):7.3f} {1e3 * np.quantile(error, 0.95):7.3f}"


def line(what: str, tests: dict[str, np.ndarray], base: dict[str, np.ndarray]) -> None:
    parts = [f"{figures(e)} {100 * (1 - e.mean() / base[k].mean()):5.1f} %" for k, e in tests.items()]
    print(f"  {what:<44}" + "   ".join(parts))


def study(name: str, poses: int) -> None:
    problem = read_problem(ROOT / "problems" / name)
    m = campaign(name, problem.robot)
    rng = np.random.default_rng(0)
    early = rng.permutation(int(0.6 * len(m)))
    train = m[np.sort(early[:poses])]
    tests = {"same time": m[np.sort(early[poses : poses + 2000])], "later": m[int(0.6 * len(m)) :]}
    tried = ", ".join(f"{len(t)} {k}" for k, t in tests.items())
    print(f"== {name}: {len(m)} poses; diagnosed on {len(train)}, tried on {tried}")
    d = diagnose(problem.robot, train)
    unlisted = describe_unlisted(d)
    base_robot = d.identification.robot
    tests = {k: t[errors(base_robot, t) < BLUNDER] for k, t in tests.items()}
    base = {k: errors(base_robot, t) for k, t in tests.items()}
    print(f"  {'never seen [mm]':<44}" + "   ".join(f"{k + ': mean, median, p95, shrink':<30}" for k in tests))
    line("calibrated base model", base, base)
    for top, cause in enumerate(d.causes, 1):
        if cause.effects:
            robot = d.apply(top)
            line(f"{'and' if top > 1 else 'with'} {cause.label}", {k: errors(robot, t) for k, t in tests.items()}, base)
    if unlisted:
        robot = d.apply(unlisted=unlisted)
        what = f"{'and' if d.effects() else 'with'} its unknown forms"
        line(what, {k: errors(robot, t) for k, t in tests.items()}, base)
    print(flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--poses", type=int, default=150)
    given = parser.parse_args()
    print(f"{given.poses} poses diagnosed a series, seed 0\n")
    for series in SERIES:
        study(series, given.poses)

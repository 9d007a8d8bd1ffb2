"""python docs/studies/real_diagnoses.py [--poses N] > docs/studies/real_diagnoses.txt

Diagnoses of the real sets: what is claimed, and what the claim is worth on poses that the diagnosis never saw.

Of each UR10 series, N poses drawn from the first 60 % of the campaign are diagnosed. The robot with the causes in its
model is then tried on other poses of the same 60 % ("same time") and on the last 40 % ("later"), beside the calibrated
base model and the compensator's network, trained on what either leaves of the same N poses. Blunders (errors beyond
3 mm with the base model) are left out of these figures, alike for all. No figure of these sets had a part in any
threshold of the diagnosis. The causes found in one series are then carried to the others, of the same robot.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from casadical import Diagnosis, diagnose, identify, isolability
from casadical.compensator import Compensator
from casadical.diagnosis import page_of
from casadical.diagnosis.details import Details
from casadical.diagnosis.held_out_gap import check_refit
from casadical.diagnosis.laws.discovery import describe_unlisted
from casadical.diagnosis.localisation import localise
from casadical.identification.accuracy import errors, predicted
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
Tests = dict[str, Measurements]
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


def residual_mm(robot: Robot, m: Measurements) -> np.ndarray:
    return 1e3 * (m.position - predicted(robot, m)[0])


def figures(error: np.ndarray) -> str:
    return f"{1e3 * error.mean():6.3f} {1e3 * np.median(error):7.3f} {1e3 * np.quantile(error, 0.95):7.3f}"


def line(what: str, tests: dict[str, np.ndarray], base: dict[str, np.ndarray]) -> None:
    parts = [f"{figures(e)} {100 * (1 - e.mean() / base[k].mean()):5.1f} %" for k, e in tests.items()]
    print(f"  {what:<44}" + "   ".join(parts))


def with_network(
    robot: Robot, train: Measurements, tests: dict[str, Measurements]
) -> tuple[str, dict[str, np.ndarray]]:
    net = Compensator.fit(train.q, residual_mm(robot, train), trainer="lm", seed=0)
    left = {k: residual_mm(robot, m) - net.correction_mm(m.q) for k, m in tests.items()}
    return "" if net.helps else " (refused)", {k: 1e-3 * np.linalg.norm(r, axis=1) for k, r in left.items()}


def study(name: str, poses: int) -> Diagnosis:
    problem = read_problem(ROOT / "problems" / name)
    m = campaign(name, problem.robot)
    rng = np.random.default_rng(0)
    early = rng.permutation(int(0.6 * len(m)))
    train = m[np.sort(early[:poses])]
    tests = {"same time": m[np.sort(early[poses : poses + 2000])], "later": m[int(0.6 * len(m)) :]}
    tried = ", ".join(f"{len(t)} {k}" for k, t in tests.items())
    print(f"== {name}: {len(m)} poses; diagnosed on {len(train)}, tried on {tried}")
    print(f"columns: {', '.join(c for c in train.conditions if c not in ('progress', *LAGS[1:]))}")
    d = diagnose(problem.robot, train, show=lambda text: print(text, file=sys.stderr, flush=True))
    unlisted = describe_unlisted(d)
    check = check_refit(d) if d.effects() else None
    print(page_of(d, Details(localise(d), isolability(d), unlisted, check)))
    for k, r in enumerate(d.rankings, 1):
        top = ", ".join(f"{label} {r.probability[label]:.2f}" for label in r.order[:4])
        print(f"step {k}: nothing {r.none:.2g}; {top}")
    base_robot = d.identification.robot
    tests = {k: t[errors(base_robot, t) < BLUNDER] for k, t in tests.items()}
    base = {k: errors(base_robot, t) for k, t in tests.items()}
    print(f"  {'never seen [mm]':<44}" + "   ".join(f"{k + ': mean, median, p95, shrink':<30}" for k in tests))
    line("calibrated base model", base, base)
    kept = train[d.case.inliers]
    word, error = with_network(base_robot, kept, tests)
    line(f"base + network{word}", error, base)
    for top, cause in enumerate(d.causes, 1):
        if cause.effects:
            robot = d.apply(top)
            line(f"{'and' if top > 1 else 'with'} {cause.label}", {k: errors(robot, t) for k, t in tests.items()}, base)
    if unlisted:
        robot = d.apply(unlisted=unlisted)
        line(
            f"{'and' if d.effects() else 'with'} its unknown forms",
            {k: errors(robot, t) for k, t in tests.items()},
            base,
        )
    if d.effects() or unlisted:
        word, error = with_network(robot, kept, tests)
        line(f"all causes + network{word}", error, base)
    print(flush=True)
    return d


def carried(found: dict[str, Diagnosis], poses: int) -> None:
    """Causes as one series gave them, settings and values held fixed, in the model of another series."""
    print(
        "== carried over: causes and values of one series held fixed in another, whose base model alone is identified"
    )
    print(f"   again from {poses} poses and tried on up to 2000 others; mean error [mm]")
    for source, d in found.items():
        unlisted = describe_unlisted(d)
        refit = d.refit(unlisted=unlisted)
        labels = {e.label for e in d.effects(unlisted=unlisted)}  # those of a whole arm have no joint in their names
        values = {n: v for n, v in zip(refit.names, refit.estimate, strict=True) if n.rpartition(".")[0] in labels}
        for target in (t for t in found if t != source):
            bare = read_problem(ROOT / "problems" / target).robot
            m = campaign(target, bare)
            order = np.random.default_rng(1).permutation(len(m))[: poses + 2000]
            train, test = m[order[:poses]], m[order[poses:]]
            means = []
            for robot in (bare, bare.with_effect(*d.effects(unlisted=unlisted)).with_values(values)):
                fit = identify(robot, train, ("kinematic", "compliance"), loss="huber", priors=True)
                means.append(1e3 * np.sort(errors(fit.robot, test))[: int(0.99 * len(test))].mean())
            shrink = 100 * (1 - means[1] / means[0])
            print(f"  {source:<12} -> {target:<12} {means[0]:.3f} -> {means[1]:.3f} {shrink:5.1f} %")
    print("  (the largest hundredth of the errors, blunders among them, left out of each)\n", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--poses", type=int, default=150)
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    print(f"{given.poses} poses diagnosed a series, seed 0\n")
    found = {name: study(name, given.poses) for name in SERIES if given.only in ("", name)}
    if not given.only:
        carried(found, given.poses)

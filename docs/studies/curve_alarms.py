"""python docs/studies/curve_alarms.py [CAMPAIGNS] [--only WORD] [--keep FILE] > docs/studies/curve_alarms.txt

False alarms of joint_error_curve: clean synthetic campaigns of both physics, three robots, 40 to 400 poses, in which
nothing is hidden; and of 15 to 60 poses of robots that are built to a tenth of the usual errors ("alike"). Counted are
those in which something is detected, and those in which the curve is the most probable cause of it; the largest log
Bayes factor of the curve says how far the others are from it. Run it in pieces with --only (mujoco, kr210, 400) and
--keep, then without --only; the committed print is of 15 campaigns a row.
"""

import argparse
import sys
from itertools import product
from pathlib import Path

import numpy as np
from campaign_robots import machine
from kept import add_options, rows_of

from casadical import identify
from casadical.blind_check import mujoco_physics
from casadical.diagnosis.candidates import standard_candidates
from casadical.diagnosis.linear_problem import make_case
from casadical.diagnosis.noise_forms import with_noise_forms
from casadical.diagnosis.posterior import rank
from casadical.diagnosis.thresholds import DETECT
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import from_table

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))  # for the simulator in numpy

import numpy_physics

ROOT = Path(__file__).parents[2]
POSES = (40, 100, 200, 400)
CURVE = "joint_error_curve"
SEEDS = {"numpy": 94, "mujoco": 95, "alike": 96}
ROBOTS = ("hh800", "kr210", "ur10e")
# Poses of robots that are built well: fewer numbers are measured than curves have parameters.
FEW = (15, 20, 25, 30, 40, 50, 60)


def clean(physics: str, name: str, poses: int, number: int) -> Measurements:
    """A campaign with noise of instrument and joints alone."""
    # Without effects both physics give the same points.
    rng = np.random.default_rng([SEEDS[physics], ROBOTS.index(name), poses, number])
    seeds = [int(s) for s in rng.integers(1 << 30, size=2)]
    noise = {"noise_mm": float(rng.choice([0.01, 0.02, 0.03])), "repeatability_urad": float(rng.uniform(2, 8))}
    built = {"length_mm": 0.03, "angle_mrad": 0.03} if physics == "alike" else {}
    plant = mujoco_physics.perturb(machine(name)[1], seeds[0], **built)
    if physics == "mujoco":
        table = mujoco_physics.campaign(plant, (), poses, seeds[1], **noise)
    else:
        table = numpy_physics.campaign(plant, poses, seeds[1], **noise)
    return from_table(table, 6, "position")


def counted(physics: str, name: str, poses: int, campaigns: int) -> dict[str, float]:
    """Campaigns in which something is detected, and in which it is the curve; the curve's largest log Bayes factor."""
    robot = machine(name)[0]
    something = curve = 0
    largest, least, nothing = -np.inf, 1.0, np.zeros(0, dtype=np.int64)
    for number in range(campaigns):
        m = clean(physics, name, poses, number)
        found = identify(robot, m, ("kinematic", "compliance"), loss="huber", priors=True, screen=False)
        case = make_case(found, standard_candidates(robot))
        ranking = with_noise_forms(rank(case, nothing), case, nothing)
        detected = ranking.none <= DETECT
        something += detected
        curve += detected and ranking.order[0] == CURVE
        largest, least = max(largest, ranking.log_factor[CURVE]), min(least, ranking.none)
    return {"something": int(something), "curve": int(curve), "largest": float(largest), "least": float(least)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("campaigns", type=int, nargs="?", default=20)
    parser.add_argument("--only", default="", help="physics, robot or number of poses; all rows by default")
    add_options(parser, "curve_alarms")
    chosen = parser.parse_args()
    every = [*product(("numpy", "mujoco"), ROBOTS, POSES), *product(("alike",), ROBOTS, FEW)]
    cells = [c for c in every if chosen.only in ("", *map(str, c))]
    todo = [(f"{cell[0]:7} {cell[1]:6} {cell[2]:5}", (*cell, chosen.campaigns)) for cell in cells]
    rows = rows_of(todo, lambda cell: counted(*cell), chosen)
    print(f"synthetic data; {chosen.campaigns} clean campaigns of each robot, physics and number of poses")
    print("physics  robot  poses   something   the curve   its largest log Bayes factor   least P(nothing)")
    for row in rows:
        print(f"{row['name']} {row['something']:8.0f} {row['curve']:11.0f} {row['largest']:20.1f} {row['least']:23.3f}")
    something, curve = (sum(row[key] for row in rows) for key in ("something", "curve"))
    print(f"all: {len(rows) * chosen.campaigns} campaigns, something in {something}, the curve in {curve}")

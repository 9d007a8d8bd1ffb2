"""python docs/studies/curve_alarms.py [CAMPAIGNS] > docs/studies/curve_alarms.txt

False alarms of joint_error_curve: clean synthetic campaigns of both physics, three robots, 40 to 400 poses, in which
nothing is hidden. Counted are those in which something is detected, and those in which the curve is the most probable
cause of it; the largest log Bayes factor of the curve says how far the others are from it.
"""

import json
import sys
from pathlib import Path

import numpy as np

from casadical import identify
from casadical.blind_check import mujoco_physics, numpy_physics
from casadical.diagnosis.candidates import standard_candidates
from casadical.diagnosis.linear_problem import make_case
from casadical.diagnosis.posterior import rank
from casadical.diagnosis.thresholds import detection
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import from_table
from casadical.project.problem import read_campaign_robot

ROOT = Path(__file__).parents[2]
POSES = (40, 100, 200, 400)
CURVE = "joint_error_curve"


def clean(physics: str, name: str, poses: int, number: int) -> Measurements:
    """A campaign with noise of instrument and joints alone."""
    drawing = json.loads((ROOT / "data" / "campaigns" / "robots" / f"{name}.json").read_text(encoding="utf-8"))
    rng = np.random.default_rng([91, poses, number])
    seeds = [int(s) for s in rng.integers(1 << 30, size=2)]
    noise = {"noise_mm": float(rng.choice([0.01, 0.02, 0.03])), "repeatability_urad": float(rng.uniform(2, 8))}
    plant = numpy_physics.perturb(numpy_physics.Plant.from_dict(drawing), seeds[0])
    if physics == "mujoco":
        table = mujoco_physics.campaign(plant, (), poses, seeds[1], **noise)
    else:
        table = numpy_physics.campaign(plant, poses, seeds[1], **noise)
    return from_table(table, 6, "position")


if __name__ == "__main__":
    campaigns = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    print(f"synthetic data; {campaigns} clean campaigns of each robot, physics and number of poses")
    print("physics  robot  poses   something   the curve   its largest log Bayes factor")
    total = np.zeros(3)
    for physics in ("numpy", "mujoco"):
        for name in ("hh800", "kr210", "ur10e"):
            robot = read_campaign_robot(ROOT / "problems" / name)
            for poses in POSES:
                something = curve = 0
                largest = -np.inf
                for number in range(campaigns):
                    m = clean(physics, name, poses, number)
                    found = identify(robot, m, ("kinematic", "compliance"), loss="huber", priors=True, screen=False)
                    ranking = rank(make_case(found, standard_candidates(robot)), np.zeros(0, dtype=np.int64))
                    detected = ranking.none <= detection(poses)
                    something += detected
                    curve += detected and ranking.order[0] == CURVE
                    largest = max(largest, ranking.log_factor[CURVE])
                total += [something, curve, campaigns]
                print(f"{physics:7} {name:6} {poses:5} {something:8} {curve:11} {largest:20.1f}", flush=True)
    print(f"all: {int(total[2])} campaigns, something in {int(total[0])}, the curve in {int(total[1])}")

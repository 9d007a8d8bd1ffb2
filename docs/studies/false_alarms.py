"""How often noise alone passes for something, by robot and number of poses: python docs/studies/false_alarms.py

Clean synthetic campaigns of the independent simulator; 1000 bootstrap draws of noise alone through the base model of
each (see casadical.diagnosis.cross_validation), judged as `diagnose` judges. Some ten minutes of one core.
"""

from pathlib import Path

import numpy as np
from campaign_robots import machine

from casadical.blind_check.mujoco_physics import campaign, perturb
from casadical.diagnosis.bootstrap import noise_odds
from casadical.diagnosis.candidates import candidates_of
from casadical.diagnosis.linear_problem import Case, make_case
from casadical.diagnosis.settings import SETTINGS
from casadical.identification.identification import identify
from casadical.measurements.reading import from_table

ROOT = Path(__file__).parents[2]
ROBOTS, POSES, CAMPAIGNS, DRAWS = ("hh800", "kr210", "ur10e"), (15, 20, 30, 40, 60, 100, 200), 3, 500
THRESHOLD = SETTINGS.max_p_nothing


def case(robot_name: str, poses: int, number: int) -> Case:
    """A campaign in which nothing is hidden."""
    robot, nominal = machine(robot_name)
    rng = np.random.default_rng([278, ROBOTS.index(robot_name), poses, number])
    plant = perturb(nominal, int(rng.integers(1 << 30)))
    noise, urad = float(rng.choice([0.01, 0.02, 0.03])), float(rng.uniform(2, 8))
    table = campaign(plant, (), poses, noise_mm=noise, repeatability_urad=urad, seed=int(rng.integers(1 << 30)))
    m = from_table(table, 6, "position")
    found = identify(robot, m, ("kinematic", "compliance"), loss="huber", priors=True, screen=False)
    return make_case(found, candidates_of(robot, "standard"))


def passes(c: Case) -> float:
    """Share of the draws in which "nothing" is less probable than the threshold of a diagnosis."""
    odds = np.concatenate(list(noise_odds(c, DRAWS, np.random.default_rng(1))))
    return float(np.mean(odds >= np.log((1 - THRESHOLD) / THRESHOLD)))


if __name__ == "__main__":
    print(f"Share of {DRAWS} draws of noise alone with P(nothing) below; {CAMPAIGNS} clean synthetic campaigns each\n")
    print(f"robot  poses  at {THRESHOLD:<4g}")
    every = []
    for robot_name in ROBOTS:
        for poses in POSES:
            every.append(np.mean([passes(case(robot_name, poses, k)) for k in range(CAMPAIGNS)]))
            print(f"{robot_name:6s} {poses:5d}  {every[-1]:7.4f}", flush=True)
    print(f"\nmean at the threshold of a diagnosis, {THRESHOLD:g}: {np.mean(every):.4f}")

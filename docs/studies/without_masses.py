"""Campaigns diagnosed with the true masses, and with all masses deleted from the robot file.

    python docs/studies/without_masses.py [--campaigns N] [--seed S] [--physics NAME] [--keep FILE.jsonl] [--seconds S]

Campaigns of the blind check, of UR10e, KR 210 and HH800, each from 100 poses: none, one or several listed causes, or
one that is on no list. Every campaign is diagnosed twice: with the masses, mass centres and payload with which it was
made, and with a robot file from which they are deleted. Held-out: mean error at poses left out of the fit, with the
causes that were found in the model (`gap_mm.after`), and of the refitted robot at 50 poses whose positions the
diagnosis did not have. A ratio is that without masses by that with the true ones; 1.15 was allowed. Synthetic data.
"""

import argparse
import json
import sys
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
from kept import Row, add_options, rows_of

from casadical.blind_check.generation import campaign_of
from casadical.blind_check.mujoco_physics import LISTED, UNLISTED, Plant
from casadical.blind_check.recording import MUJOCO, Plan, Subject, draw_plans
from casadical.core.basics import CasadicalError
from casadical.diagnosis.diagnose import Diagnosis, diagnose
from casadical.identification.accuracy import errors
from casadical.identification.gravity import in_words
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import from_table
from casadical.project.problem import read_campaign_robot
from casadical.robot.robot import Robot
from casadical.robot.robot_file import to_toml

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))  # for the simulator in numpy

from numpy_physics.simulator import NUMPY, WORDS

ROOT = Path(__file__).parents[2]
# Of each physics its simulator, and its effects: listed, and on no list.
PHYSICS = {"numpy": (NUMPY, WORDS), "mujoco": (MUJOCO, (tuple(LISTED), tuple(UNLISTED)))}
ALLOWED = 1.15
POSITION = ["x_mm", "y_mm", "z_mm"]


def without_masses(robot: Robot) -> Robot:
    """As if nobody had written any mass into its file."""
    return replace(robot, joints=tuple(replace(j, body=None) for j in robot.joints), payload=None)


def unseen_error(found: Diagnosis, m: Measurements) -> float:
    """Mean error [mm] at poses that were not diagnosed; NaN where the refit finds no optimum."""
    try:
        robot = found.refit().robot
    except CasadicalError:
        return float("nan")
    given, lost = derive(m, robot.conditions)
    return float("nan") if lost else 1e3 * float(errors(robot, given).mean())


def judged(entry: tuple[str, Plan]) -> Row:
    """One campaign diagnosed with and without masses; lengths in mm."""
    physics, plan = entry
    robot = read_campaign_robot(ROOT / "problems" / plan.robot)
    table = json.loads((ROOT / "data" / "campaigns" / "robots" / f"{plan.robot}.json").read_text())
    made = campaign_of(Subject(Plant.from_dict(table), to_toml(robot)), plan, PHYSICS[physics][0])
    m = from_table(pd.read_csv(StringIO(made.seen)), robot.n, "position")
    unseen = pd.read_csv(StringIO(made.unseen))
    unseen[POSITION] = np.array(made.secret.measured_mm)
    held = from_table(unseen, robot.n, "position")
    both = [diagnose(r, m) for r in (robot, without_masses(robot))]
    return {
        "physics": physics, "campaign": plan.name, "kind": plan.kind,
        "hidden": " + ".join(f"{h.effect}@{h.joint or ''}".strip("@") for h in made.secret.hidden),
        "true": 1e3 * both[0].gap.after, "without": 1e3 * both[1].gap.after,
        "unseen_true": unseen_error(both[0], held), "unseen_without": unseen_error(both[1], held),
        "verdicts": " / ".join(f"{d.verdict} {', '.join(c.label for c in d.causes)}".strip() for d in both),
        "gravity": in_words(both[1].identification),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--campaigns", type=int, default=24, help="of each physics")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--physics", choices=("numpy", "mujoco"), action="append")
    add_options(parser, "without_masses")
    given = parser.parse_args()
    plans = []
    for physics in given.physics or ("numpy", "mujoco"):
        drawn = draw_plans(given.campaigns, given.seed, PHYSICS[physics][1], (100,))
        plans += [(f"{physics} {given.seed} {plan.name}", (physics, plan)) for plan in drawn]
    rows = rows_of(plans, judged, given)
    print(f"{len(rows)} of {len(plans)} campaigns\n")
    for row in rows:
        print(
            f"{row['name']} {row['kind']} ({row['hidden'] or '-'}): {row['true']:.4f} -> {row['without']:.4f} mm, "
            f"unseen {row['unseen_true']:.4f} -> {row['unseen_without']:.4f}; {row['verdicts']}"
        )
    summary(pd.DataFrame(rows))


def summary(found: pd.DataFrame) -> None:
    """Ratios by robot and physics, and verdicts of campaigns that hide nothing."""
    found["ratio"] = found["without"] / found["true"]
    found["unseen"] = found["unseen_without"] / found["unseen_true"]
    found["robot"] = found["campaign"].str.partition("-")[0]
    print()
    for (physics, robot), part in found.groupby(["physics", "robot"]):
        print(
            f"{physics}, {robot}: {len(part)} campaigns, held-out {part['true'].mean():.4f} mm with true masses, "
            f"{part['without'].mean():.4f} without: median ratio {part['ratio'].median():.3f}, largest "
            f"{part['ratio'].max():.3f}; at unseen poses {part['unseen'].median():.3f}, {part['unseen'].max():.3f}"
        )
    print(f"ratio of the mean held-out errors {found['without'].mean() / found['true'].mean():.3f}; "
          f"campaigns within {ALLOWED}: {(found['ratio'] <= ALLOWED).sum()} of {len(found)}")  # fmt: skip
    none = found[found["kind"] == "none"]
    pairs = none["verdicts"].str.split(" / ")
    kept = sum(after.split()[0] == "none" for before, after in pairs if before.split()[0] == "none")
    print(f"none: {sum(before.split()[0] == 'none' for before, _ in pairs)} with true masses, {kept} of them without")
    print(f"for example: {found['gravity'].iloc[0]}")


if __name__ == "__main__":
    main()

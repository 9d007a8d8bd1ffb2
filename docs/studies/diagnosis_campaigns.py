"""Diagnose campaigns of the independent simulator and score: python docs/studies/diagnosis_campaigns.py

Some 1,500 campaigns (half an hour on two idle cores), a part for each figure; --share 0.1 makes a tenth. Three robots;
effects, sizes and joints are drawn by numpy_physics, which shares no formula with the candidates;
joint repeatability and instrument noise are always there. The same campaign made without the effect tells how far
the gap can shrink. Synthetic data throughout. Seeds are [2027, part, number], which nobody had seen when the rules
were fixed (commit 033c84f); these were chosen on seeds [77, number], [2026, part, number] and on campaigns
of casadical.blind_check.mujoco_physics.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, fields, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from campaign_robots import machine
from diagnosis_scores import Trial, near_rival, table, visible

from casadical.blind_check.mujoco_physics import perturb
from casadical.diagnosis.candidates import standard_candidates
from casadical.diagnosis.cross_validation import held_out_errors, likely_noise, random_folds
from casadical.diagnosis.diagnose import diagnose
from casadical.diagnosis.linear_problem import Case, make_case
from casadical.diagnosis.thresholds import PARTITIONS
from casadical.identification.identification import identify
from casadical.identification.result import Identification
from casadical.measurements.measurements import Measurements, Noise
from casadical.measurements.reading import from_table
from casadical.robot.robot import Robot

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))  # for the simulator in numpy

from numpy_physics import Disturbance, campaign, draw_disturbance
from numpy_physics.disturbances import LISTED, UNLISTED

ROOT = Path(__file__).parents[2]
ROBOTS = ("hh800", "kr210", "ur10e")
# Campaigns and poses of each part.
PARTS = {
    "none": (200, 100),
    "one": (300, 100),
    "unlisted": (200, 100),
    "two": (120, 100),
    "forty": (250, 40),
    "at .5": (200, 100),
    "at .35": (200, 100),
}


def drawn(effect: str, rng: np.random.Generator, scale: float) -> Disturbance:
    """An effect by chance, at any joint that can have it."""
    names = {f.name for f in fields((LISTED | UNLISTED)[effect])}
    joint = int(rng.integers(2 if "source" in names else 1, 7)) if "joint" in names else None
    return draw_disturbance(effect, int(rng.integers(1 << 30)), joint=joint, scale=scale)


def label(effect: str, disturbance: object) -> str:
    joint = 2 if effect == "gravity_compensator" else getattr(disturbance, "joint", None)
    return effect if joint is None else f"{effect}@{joint}"


def hidden(part: str, rng: np.random.Generator) -> dict[str, Disturbance]:
    """What a campaign of a part hides, by word."""
    if part == "none":
        return {"outliers": draw_disturbance("outliers", int(rng.integers(1 << 30)))} if rng.random() < 0.5 else {}
    pool = list(UNLISTED) if part == "unlisted" else [w for w in LISTED if not (part[:2] == "at" and w == "outliers")]
    words = rng.choice(pool, 2 if part == "two" else 1, replace=False)
    return {str(w): drawn(str(w), rng, float(rng.choice([0.7, 1.0, 1.5, 2.5]))) for w in words}


@cache
def standard(name: str) -> tuple[str, ...]:
    """The standard list's names, which leave the rarer effects out even as rivals."""
    return tuple(dict.fromkeys(c.name for c in standard_candidates(machine(name)[0]) if c.listed))


def calibrated(robot: Robot, m: Measurements) -> Identification:
    """As `diagnose` does."""
    return identify(robot, m, ("kinematic", "compliance"), loss="huber", priors=True, screen=False)


def floor(case: Case) -> float:
    """Mean held-out error [m] of the base model, as `diagnose` counts it."""
    e, columns = case.evidence, np.zeros(0, dtype=np.int64)
    noise = likely_noise(e.log_base())
    runs = [held_out_errors(e, columns, noise, random_folds(len(e.r), k)) for k in range(PARTITIONS)]
    return float(np.mean(runs))


def file_of(folder: Path, task: Sequence[Any]) -> Path:
    return folder / ("-".join(map(str, task)).replace(" ", "") + ".json")


def kept(folder: Path | None, task: Sequence[Any]) -> Trial:
    """The trial of a task, from the folder if it is there."""
    if folder is None:
        return trial(task)
    file = file_of(folder, task)
    if not file.exists():
        folder.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(asdict(trial(task))))
    found = json.loads(file.read_text())
    return Trial(**{k: tuple(v) if isinstance(v, list) else v for k, v in found.items()})


def trial(task: Sequence[Any]) -> Trial:
    """One campaign, hidden, measured, diagnosed and judged."""
    part, number, poses = task
    rng = np.random.default_rng([2027, list(PARTS).index(part), number])
    robot_name = ROBOTS[number % 3]
    robot, nominal = machine(robot_name)
    plant = perturb(nominal, int(rng.integers(1 << 30)))
    secret = hidden(part, rng)
    circumstances: dict[str, Any] = {
        "noise_mm": float(rng.choice([0.01, 0.02, 0.03])),
        "repeatability_urad": float(rng.uniform(2, 8)),
        "seed": int(rng.integers(1 << 30)),
    }

    def measured(*disturbances: Disturbance) -> Measurements:
        return from_table(campaign(plant, poses, disturbances=disturbances, **circumstances), 6, "position")

    m, clean = measured(*secret.values()), measured()
    noise = Noise(1e-3 * circumstances["noise_mm"], 1e-6 * circumstances["repeatability_urad"])
    alone = [measured(d).position - clean.position for d in secret.values()] if len(secret) > 1 else []
    shift = m.position - clean.position
    bare = make_case(calibrated(robot, clean), [])
    if part.startswith("at"):
        shift *= float(part.split()[1]) / visible(bare.whole, shift, noise)
        m = replace(m, position=clean.position + shift)
    began = time.process_time()
    base = calibrated(robot, m)
    found = diagnose(base)
    seconds = time.process_time() - began
    without = diagnose(base, effects=standard(robot_name)).verdict if part == "unlisted" else ""
    truth = tuple(label(w, d) for w, d in secret.items()) if part != "unlisted" else ()
    first = found.rankings[0].probability
    rival = near_rival(found.case, shift, noise, truth[0]) if part in ("one", "forty") else 0.0
    return Trial(
        part=part,
        truth=truth,
        hidden=", ".join(label(w, d) for w, d in secret.items()),
        poses=poses,
        visible=visible(bare.whole, shift, noise),
        beside=tuple(visible(bare.whole, s, noise, [o for o in alone if o is not s]) for s in alone),
        rival=rival,
        verdict=found.verdict,
        claims=tuple(c.label for c in found.causes),
        posterior=float("outliers" in truth and bool(found.outliers)) or first.get(truth[0] if truth else "", 0.0),
        alike=found.causes[0].indistinguishable if found.causes else (),
        predicted_shrink=1 - found.gap.after / found.gap.before,
        true_shrink=1 - floor(bare) / found.gap.before,
        without_rivals=without,
        seconds=seconds,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--share", type=float, default=1.0, help="of the campaigns of every part")
    parser.add_argument("--parts", default=",".join(PARTS), help="by commas")
    parser.add_argument("--keep", type=Path, help="folder that keeps finished trials, to go on after a break")
    parser.add_argument("--done", action="store_true", help="score what the folder has")
    options = parser.parse_args()
    tasks = [
        (k / PARTS[part][0], part, k, PARTS[part][1])
        for part in options.parts.split(",")
        for k in range(round(options.share * PARTS[part][0]))
    ]
    # All parts in step: a study that is broken off has a bit of each.
    tasks = [task for _, *task in sorted(tasks, key=lambda t: t[0])]
    if options.done:
        tasks = [task for task in tasks if file_of(options.keep, task).exists()]
    with ProcessPoolExecutor(2) as pool:
        trials = list(pool.map(partial(kept, options.keep), tasks))
    print(table({part: [t for t in trials if t.part == part] for part in PARTS}))


if __name__ == "__main__":
    main()

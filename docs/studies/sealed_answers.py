"""Answers for every sealed campaign of a round: python docs/studies/sealed_answers.py A (about five minutes), or B.

Round B has 160 campaigns and takes ten minutes. Writes data/campaigns/answers/CAMPAIGN.json (round B: answers_B), one
a campaign, as `casadical diagnose PROBLEM CAMPAIGN.csv --json` does. The keys to these campaigns are not in this
repository; nothing here was tuned on them. A campaign that is refused has no answer; its reason is printed.
`--jobs N` answers N campaigns at a time. Round L are 120 joint logs, which are not in this repository: give their
folder by `--logs`. Where causes are not named, what fits is answered as `ambiguous`, which claims none.
"""

import argparse
import json
import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd

from casadical import Body, InputError, Robot, diagnose, next_poses, read_urdf
from casadical.core.drive import read_drive
from casadical.core.files import write_whole
from casadical.diagnosis.details import Details
from casadical.diagnosis.json_answer import as_json
from casadical.diagnosis.localisation import localise
from casadical.diagnosis.motion.result import diagnose_log
from casadical.diagnosis.smooth_description import describe_unlisted
from casadical.measurements.logs.reading import read_log
from casadical.project.problem import read_campaign, read_campaign_robot

ROOT = Path(__file__).parents[2]
CAMPAIGNS = ROOT / "data" / "campaigns"
FOLDERS = {"A": ("sealed", "answers"), "B": ("sealed_B", "answers_B")}
# From the frame of joint 5 of the SO-101 to that of its gripper's link, in which payloads are declared [m].
GRIPPER = np.array([0.0, 0.0, 0.0234])


def answered(path: Path, answers: Path) -> str:
    """The line printed for a campaign, whose answer is written."""
    name = path.stem.split("-")[0]
    own = CAMPAIGNS / "robots_B" / f"{name}.robot.toml"
    place = own if own.is_file() else ROOT / "problems" / name
    robot = read_campaign_robot(place)
    try:
        found = diagnose(robot, read_campaign(place, path, robot))
    except InputError as error:
        return f"{path.stem}  refused    {error}"
    more = Details(localise(found), unlisted=describe_unlisted(found), poses=next_poses(found, 15))
    write_whole(answers / f"{path.stem}.json", json.dumps(as_json(found, path.stem, more), indent=1) + "\n")
    causes = ", ".join(f"{c.label} {c.confidence:.2f}" for c in found.causes)
    return f"{path.stem}  {found.verdict:<10} {1e3 * found.gap.before:.4f} -> {1e3 * found.gap.after:.4f} mm  {causes}"


def answered_log(row: Mapping[str, Any], logs: Path, answers: Path) -> str:
    """The line printed for a joint log, whose answer is written."""
    bare = read_urdf(logs / row["urdf"])
    bare = replace(bare, drive=read_drive(logs / "robots" / row["robot"] / "drive.toml", bare.n))
    robot = loaded(bare, row)
    log = read_log(logs / row["file"], robot)
    healthy = read_log(logs / row["reference"], bare) if row["reference"] else None
    found = diagnose_log(robot, log, healthy, healthy=bare).to_json()
    verdict, causes = found["verdict"], found["causes"]
    if verdict in ("unknown", "ambiguous") and (fits := [*found["fits"], *found["alike"]]):
        verdict, causes = "ambiguous", [c for k, c in enumerate(fits) if c not in fits[:k]]
    gap = {k: found["gap"][k] for k in ("before", "after")}
    answer = {"verdict": verdict, "causes": causes, "gap": gap}
    write_whole(answers / f"{row['id']}.json", json.dumps(answer, indent=1) + "\n")
    said = ", ".join(f"{c['effect']}@{c['joint'] or ''} {c['probability']:.2f}" for c in causes)
    return f"{row['id']}  {row['robot']:6} {verdict:<10} {gap['before']:.4g} -> {gap['after']:.4g}  {said}"


def loaded(robot: Robot, row: Mapping[str, Any]) -> Robot:
    """With the payload that is declared; the SO-101's is at the link before its last."""
    if not row["payload_kg"]:
        return robot
    mass, com = float(row["payload_kg"]), np.array(str(row["payload_com_m"]).split(), float)
    if row["robot"] != "so101":
        return replace(robot, payload=Body(mass, com))
    joints = list(robot.joints)
    own, com = joints[4].body, com + GRIPPER
    assert own is not None
    apart, both = com - own.com, own.mass + mass
    about = own.mass * mass / both * (apart @ apart * np.eye(3) - np.outer(apart, apart))
    joints[4] = replace(joints[4], body=Body(both, own.com + mass / both * apart, own.likely_inertia + about))
    return replace(robot, joints=tuple(joints))


def lines(given: argparse.Namespace, pool: ProcessPoolExecutor) -> Iterator[str]:
    if given.round == "L":
        answers = given.answers or CAMPAIGNS / "answers_L"
        answers.mkdir(exist_ok=True)
        table = pd.read_csv(given.logs / "manifest.csv", dtype={"payload_com_m": str}).fillna({"reference": ""})
        rows = [row for row in table.to_dict("records") if row["id"].startswith(given.only)]
        return pool.map(answered_log, rows, [given.logs] * len(rows), [answers] * len(rows))
    sealed, folder = (CAMPAIGNS / name for name in FOLDERS[given.round])
    answers = given.answers or folder
    answers.mkdir(exist_ok=True)
    paths = sorted(sealed.glob(f"{given.only}*.csv"))
    return pool.map(answered, paths, [answers] * len(paths))


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("round", choices=[*FOLDERS, "L"], nargs="?", default="A")
    options.add_argument("--jobs", type=int, default=1)
    options.add_argument("--only", default="", help="campaigns whose names begin so")
    options.add_argument("--answers", type=Path, help="another folder for the answers")
    options.add_argument("--logs", type=Path, help="with round L: the folder of the logs")
    given = options.parse_args()
    with ProcessPoolExecutor(given.jobs) as pool:
        for line in lines(given, pool):
            print(line, flush=True)


if __name__ == "__main__":
    main()

"""Answers for every sealed campaign of a round: python docs/studies/sealed_answers.py A (about five minutes), or B.

Round B has 160 campaigns and takes ten minutes. Writes data/campaigns/answers/CAMPAIGN.json (round B: answers_B), one
a campaign, as `casadical diagnose PROBLEM CAMPAIGN.csv --json` does. The keys to these campaigns are not in this
repository; nothing here was tuned on them. A campaign that is refused has no answer; its reason is printed.
`--jobs N` answers N campaigns at a time.
"""

import argparse
import json
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

from casadical import InputError, diagnose, next_poses
from casadical.core.files import write_whole
from casadical.diagnosis.details import Details
from casadical.diagnosis.json_answer import as_json
from casadical.diagnosis.localisation import localise
from casadical.diagnosis.smooth_description import describe_unlisted
from casadical.project.problem import read_campaign, read_campaign_robot

ROOT = Path(__file__).parents[2]
CAMPAIGNS = ROOT / "data" / "campaigns"
FOLDERS = {"A": ("sealed", "answers"), "B": ("sealed_B", "answers_B")}


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


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("round", choices=FOLDERS, nargs="?", default="A")
    options.add_argument("--jobs", type=int, default=1)
    options.add_argument("--only", default="", help="campaigns whose names begin so")
    options.add_argument("--answers", type=Path, help="another folder for the answers")
    given = options.parse_args()
    sealed, folder = (CAMPAIGNS / name for name in FOLDERS[given.round])
    answers = given.answers or folder
    answers.mkdir(exist_ok=True)
    paths = sorted(sealed.glob(f"{given.only}*.csv"))
    with ProcessPoolExecutor(given.jobs) as pool:
        for line in pool.map(answered, paths, [answers] * len(paths)):
            print(line, flush=True)


if __name__ == "__main__":
    main()

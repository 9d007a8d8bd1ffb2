"""Answers for every sealed campaign: python docs/studies/sealed_answers.py (about five minutes).

Writes data/campaigns/answers/CAMPAIGN.json, one a campaign, as `casadical diagnose PROBLEM CAMPAIGN.csv --json` does.
The key to these campaigns is not in this repository; nothing here was tuned on them.
"""

import json
from pathlib import Path

from casadical import diagnose, next_poses, read_measurements
from casadical.core.files import write_whole
from casadical.diagnosis import Details, as_json, describe_unlisted, localise
from casadical.project.problem import read_campaign_robot

ROOT = Path(__file__).parents[2]


def main() -> None:
    robots = {name: read_campaign_robot(ROOT / "problems" / name) for name in ("hh800", "kr210", "ur10e")}
    for path in sorted((ROOT / "data" / "campaigns" / "sealed").glob("*.csv")):
        robot = robots[path.stem.split("-")[0]]
        found = diagnose(robot, read_measurements(path, robot.n))
        more = Details(localise(found), unlisted=describe_unlisted(found), poses=next_poses(found, 15))
        answer = as_json(found, path.stem, more)
        write_whole(ROOT / "data" / "campaigns" / "answers" / f"{path.stem}.json", json.dumps(answer, indent=1) + "\n")
        causes = ", ".join(f"{c.label} {c.confidence:.2f}" for c in found.causes)
        gap = f"{1e3 * found.gap.before:.4f} -> {1e3 * found.gap.after:.4f} mm"
        print(f"{path.stem}  {found.verdict:<10} {gap}  {causes}", flush=True)


if __name__ == "__main__":
    main()

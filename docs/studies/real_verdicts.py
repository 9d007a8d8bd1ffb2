"""Real robots that no tracker measured: a verdict each, with intervals, and what it is worth on poses held out.

    python docs/studies/real_verdicts.py [--splits 10] [--keep FILE.jsonl] [--seconds S] [--table]

Real data: an FR3 with a camera on its hand (full poses of a board), and two Panda arms that hold a ball in sockets
(contacts). Each split draws 70 % of the poses, which alone are calibrated (`casadical calibrate`, as the problem
says) and diagnosed; the other 30 % judge, the same splits as in `real_data.txt`. "as calibrated" is calibrate's robot,
"base model" that of the diagnosis, "causes" with the named causes in the model, "described" with the forms too that
describe an unknown, where there are some. A contact's error is its distance from the mean of all held-out poses in
the same socket. Then what the command says of all poses together.
"""

import argparse

import numpy as np
from kept import Row, add_options, rows_of
from real_data import ROOT

from casadical import diagnose
from casadical.core.telling.result import plain_text
from casadical.diagnosis import analyse
from casadical.diagnosis.smooth_description import describe_unlisted
from casadical.diagnosis.text import brief
from casadical.identification.accuracy import errors
from casadical.measurements.derived_columns import derive
from casadical.project.calibration import calibrate
from casadical.project.problem import read_campaign, read_campaign_robot

CAMPAIGNS = {
    "fr3_camera": "fr3_camera/fr3_114.csv",
    "panda_1": "panda_sockets/panda_1.csv",
    "panda_3": "panda_sockets/panda_3.csv",
}
STATES = ("calibrated", "base", "causes", "described")


def judged(entry: tuple[str, int]) -> Row:
    """One split; errors in mm."""
    name, seed = entry
    folder = ROOT / "problems" / name
    robot = read_campaign_robot(folder)
    m = read_campaign(folder, ROOT / "data" / CAMPAIGNS[name], robot)
    # When a pose was taken, and from where, is known of all poses before they are split.
    m, _ = derive(m, ["progress", *(f"approach{i}" for i in range(1, robot.n + 1))])
    parts = m.split({"identify": 0.7, "report": 0.3}, seed)
    test = parts["report"]
    found = diagnose(robot, parts["identify"])
    unlisted = describe_unlisted(found)
    robots = {"calibrated": calibrate(folder, seed=seed).robot, "base": found.identification.robot}
    robots["causes"] = found.apply() if found.effects() else robots["base"]
    robots["described"] = found.apply(unlisted=unlisted) if unlisted else robots["causes"]
    return {
        "robot": name,
        "verdict": found.verdict,
        "causes": [c.label for c in found.causes],
        "forms": list(unlisted.labels) if unlisted else [],
        "held_out": {state: 1e3 * float(errors(robot, test).mean()) for state, robot in robots.items()},
        "expected": 1e3 * found.gap.after,
    }


def verdict(name: str) -> Row:
    """What the command says of all poses, in few lines and in all."""
    folder = ROOT / "problems" / name
    robot = read_campaign_robot(folder)
    found = diagnose(robot, read_campaign(folder, ROOT / "data" / CAMPAIGNS[name], robot))
    return {"said": plain_text(brief(name, found, analyse(found)))}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--splits", type=int, default=10)
    parser.add_argument("--robot", choices=[*CAMPAIGNS], action="append", help="these alone")
    add_options(parser, "real_verdicts")
    given = parser.parse_args()
    robots = given.robot or [*CAMPAIGNS]
    said = rows_of([(name, name) for name in robots], verdict, given)
    todo = [(f"{name} {seed}", (name, seed)) for seed in range(given.splits) for name in robots]
    rows = rows_of(todo, judged, given)
    print(f"held out, mean of the splits [mm]\n{'robot':12s}{'splits':>7s}" + "".join(f"{s:>12s}" for s in STATES))
    for name in robots:
        some = [r for r in rows if r["robot"] == name]
        means = [np.mean([r["held_out"][s] for r in some]) for s in STATES]
        print(f"{name:12s}{len(some):7d}" + "".join(f"{m:12.3f}" for m in means))
        for words in sorted({(r["verdict"], *r["causes"], *r["forms"]) for r in some}):
            print(f"  {sum((r['verdict'], *r['causes'], *r['forms']) == words for r in some)} x {', '.join(words)}")
    for row in said:
        print(f"\n{row['said']}")


if __name__ == "__main__":
    main()

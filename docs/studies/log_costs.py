"""Processor time and memory of the diagnosis of one joint log: 60 s, six joints, 125 Hz, with currents and commands.

    python docs/studies/log_costs.py > docs/studies/log_costs.txt

Synthetic, a UR10e in MuJoCo (joint_logs.py). Each row is a process of its own: `first` is the command's whole work
from the start of the interpreter, with the replay; `again` the same once more in that process. To be reached: 5 s
first, 2 s again, 500 MB; the times need an idle machine. Then long logs of seven joints at 500 Hz (log_reading.py),
read, diagnosed and replayed once: ten minutes within 1 GB, 600,000 rows within 60 s.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from joint_logs import arm_of, day_of, drive_of, simulate, urdf_of, written
from log_reading import JOINTS, RATE, table

from casadical import Body, Joint, Robot, write_robot

SECONDS = 60.0
WORK = """
import json, resource, sys, time
from pathlib import Path
from casadical.project.diagnosis import read_logs
replay, reference = "replay" in sys.argv, Path("known.csv.gz") if "known" in sys.argv else None
spent, long = [], "long" in sys.argv
for _ in range(1 if long else 2):
    began = time.process_time() if spent else 0.0
    if long:
        campaign = read_logs(Path("seven.toml"), [Path("long.csv")])
    else:
        campaign = read_logs(Path("arm.urdf"), [Path("log.csv.gz")], reference, Path("arm.drive.toml"))
    found = campaign.diagnosed(campaign.logs[0]).to_json()
    if replay:
        campaign.replayed().to_json()
    spent.append(time.process_time() - began)
print(json.dumps([*spent, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024]))
"""


def main() -> None:
    rng = np.random.default_rng(20261201)
    truth = arm_of("ur10e", rng)
    days = [day_of(truth, "ur10e", rng) | {"sign": 1.0} for _ in range(4)]
    print(__doc__.splitlines()[0])
    print(f"{'':40} {'first CPU s':>12} {'again':>8} {'MB':>6}")
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "arm.urdf").write_text(urdf_of("ur10e"))
        (place / "arm.drive.toml").write_text(drive_of("ur10e"))
        logs = simulate(days)
        for name, (i, k) in {"log": (0, 1), "known": (2, 3)}.items():
            for at in (i, k):
                written(days[at], logs[at], place / f"{at}.csv.gz")
            whole, more = (pd.read_csv(place / f"{at}.csv.gz") for at in (i, k))
            more = more.assign(run=more["run"] + 3)[: int(SECONDS * 125) - len(whole)]
            pd.concat([whole, more]).to_csv(place / f"{name}.csv.gz", index=False)
        for title, words in {
            "a log alone": (), "with a reference": ("known",), "a log alone, and its replay": ("replay",),
        }.items():  # fmt: skip
            told(place, title, *words)
        seven(place / "seven.toml")
        for minutes in (5, 10, 20):
            table(minutes).to_csv(place / "long.csv", index=False)
            told(place, f"{minutes} minutes, {60 * minutes * RATE} rows, with replay", "long", "replay")


def seven(path: Path) -> None:
    """An arm of seven joints with masses."""
    body = Body(3.0, np.array([0.05, 0.0, -0.1]), np.diag([0.02, 0.02, 0.01]))
    turns, lengths = (0, -1, 1, 1, -1, 1, 1), (0.3, 0, 0.3, 0, 0.4, 0, 0.1)
    joints = (Joint(alpha=a * np.pi / 2, d=d, body=body) for a, d in zip(turns, lengths, strict=True))
    write_robot(Robot(f"{JOINTS} joints", tuple(joints)), path)


def told(place: Path, title: str, *words: str) -> None:
    """Print what a process took in a folder."""
    child = subprocess.run([sys.executable, "-c", WORK, *words], cwd=place, capture_output=True, text=True, check=True)
    *seconds, memory = json.loads(child.stdout)
    first, again = (f"{value:.1f}" for value in seconds) if len(seconds) > 1 else (f"{seconds[0]:.1f}", "")
    print(f"{title:40} {first:>12} {again:>8} {memory:6.0f}", flush=True)


if __name__ == "__main__":
    main()

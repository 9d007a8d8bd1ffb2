"""Open-loop replay of the real SO-101's thirteen motions, each quarter of them withheld in turn; mrad rms a joint.

Made by

    python docs/studies/joint_replay.py > docs/studies/joint_replay.txt
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from casadical import read_robot
from casadical.diagnosis.motion.replay import replayed
from casadical.measurements.logs.reading import read_log
from casadical.project.diagnosis import read_logs

ROOT = Path(__file__).parents[2]


def main() -> None:
    folder = ROOT / "problems" / "so101"
    robot = read_robot(folder / "robot.toml")
    logs = [read_log(path, robot) for path in sorted((ROOT / "data" / "so101_logs").glob("*.csv.gz"))]
    campaign = read_logs(folder)
    assert campaign is not None
    for title, found in (
        (f"{len(logs)} motions, each quarter withheld in turn", replayed(robot, logs)),
        ("problems/so101: the motions of report", campaign.replayed()),
    ):
        assert found is not None
        print(f"real data, SO-101: {title}; rms [mrad], joints 1 to 6")
        print(f"{'position = command':32}", *(f"{1e3 * v:6.2f}" for v in found.before))
        print(f"{'with the response':32}", *(f"{1e3 * v:6.2f}" for v in found.after))
        for run, q in zip(found.runs, found.predicted, strict=True):
            left = 1e3 * np.sqrt(((run.position - q) ** 2).mean(axis=0))
            print(f"  {run.source.removesuffix('.csv.gz'):30}", *(f"{v:6.2f}" for v in left))


if __name__ == "__main__":
    main()

"""Measured poses driven again in MuJoCo: the gap to the measured points before, after geometry, after the effect.

Of a campaign the nominal robot (base and tool placed, rigid), the calibrated one (geometry and joint stiffness) and the
calibrated one with the diagnosed effect are written as MJCF and brought to rest by MuJoCo at poses that were held out
(a third). `apart` is the largest distance between MuJoCo's point and casadical's own. Made by

    python docs/studies/replay.py > docs/studies/replay.txt
"""

from __future__ import annotations

from pathlib import Path

from casadical import read_measurements
from casadical.export.mjcf.equilibrium import load_mujoco
from casadical.export.mjcf.replay import replay_campaign
from casadical.project.problem import read_campaign_robot

ROOT = Path(__file__).parents[2]
CAMPAIGN = "hh800-P01"


def main() -> None:
    print(f"MuJoCo {load_mujoco().__version__}; a third of the poses, held out, seed 0; position error [mm]")
    robot = read_campaign_robot(ROOT / "problems" / CAMPAIGN.partition("-")[0])
    path = ROOT / "data" / "campaigns" / "practice" / f"{CAMPAIGN}.csv"
    found = replay_campaign(robot, read_measurements(path, [j.kind for j in robot.joints]))
    assert found.diagnosis is not None
    verdict, gap = found.diagnosis.verdict, found.diagnosis.gap
    print(f"\n{CAMPAIGN} ({robot.name}), {verdict}; noise floor {1e3 * gap.floor:.4f}")
    print(found.table.to_string(index=False, float_format=lambda v: f"{v:.4f}"))


if __name__ == "__main__":
    main()

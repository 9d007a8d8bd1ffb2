"""Measured poses driven again in MuJoCo: the gap to the measured points before, after geometry, after the effect.

Per campaign the nominal robot (base and tool placed, rigid), the calibrated one (geometry and joint stiffness) and the
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
CAMPAIGNS = ("hh800-P01", "hh800-P04", "kr210-P05", "ur10e-P06", "ur10e-P09", "kr210-P08")


def main() -> None:
    print(f"MuJoCo {load_mujoco().__version__}; a third of the poses, held out, seed 0; position error [mm]")
    for name in CAMPAIGNS:
        robot = read_campaign_robot(ROOT / "problems" / name.partition("-")[0])
        path = ROOT / "data" / "campaigns" / "practice" / f"{name}.csv"
        m = read_measurements(path, [j.kind for j in robot.joints])
        found = replay_campaign(robot, m)
        assert found.diagnosis is not None
        gap = found.diagnosis.gap
        print(f"\n{name} ({robot.name}), {found.diagnosis.verdict}; noise floor {1e3 * gap.floor:.4f}")
        print(found.table.to_string(index=False, float_format=lambda v: f"{v:.4f}"))
        for text in found.stages[-1].export.written:
            print(f"  {text}")
        for text in found.stages[-1].export.left_out:
            print(f"  left out: {text}")


if __name__ == "__main__":
    main()

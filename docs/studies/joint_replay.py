"""Open-loop replay of motions of the real SO-101 of which none was fitted (those of report); mrad rms a joint.

Also by the exported model in MuJoCo, without one effect at a time and with published parameters; then torques of a UR10
(BAGS: repository unisa-acg/inverse-dynamics-solver). Made by

    python docs/studies/joint_replay.py BAGS > docs/studies/joint_replay.txt
    python docs/studies/joint_replay.py docs/images/so101.png     # draws the motions of report
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from casadical import read_robot
from casadical.core.reporting.result import plain_text
from casadical.diagnosis.motion.against import arbitration_tables
from casadical.diagnosis.motion.friction_laws import friction_laws
from casadical.diagnosis.motion.replay import Replay
from casadical.diagnosis.motion.signals import arm_of
from casadical.export.mjcf.moving import driven, moving_mjcf
from casadical.measurements.logs.reading import read_log
from casadical.project.diagnosis import read_logs

ROOT = Path(__file__).parents[2]


def picture(found: Replay, path: str) -> None:
    """Errors of one joint over one motion, and rms of all joints over all motions, before and after."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained", width_ratios=(2, 1))
    run, joint = next(k for k, r in enumerate(found.runs) if "random" in r.source), 1
    t, each = found.runs[run].time, np.arange(5)
    for before, colour, label in ((True, "0.65", "position = command"), (False, "C0", "with the response")):
        left.plot(t, 1e3 * found.residual(run, before=before)[:, joint], colour, label=label)
        rms = found.before if before else found.after
        right.bar(each + (-0.2 if before else 0.2), 1e3 * rms[:5], 0.4, color=colour)
    left.set(xlabel="time [s]", ylabel="mrad", title=f"random_waypoints, {found.runs[run].joints[joint]}: reading less")
    left.legend(loc="lower right")
    right.set(xticks=each, xticklabels=each + 1, xlabel="joint", ylabel="mrad", title="rms, motions not fitted")
    figure.savefig(path, dpi=90, metadata={"Software": None})


def main() -> None:
    campaign = read_logs(ROOT / "problems" / "so101")
    assert campaign is not None
    if sys.argv[1].endswith(".png"):
        drawn = campaign.replayed()
        assert drawn is not None
        picture(drawn, sys.argv[1])
        return
    published = sorted((ROOT / "data/so101_logs/published").glob("*.csv"))
    found = campaign.replayed(against=published)
    assert found is not None
    print("real data, SO-101: problems/so101: the motions of report; rms [mrad], joints 1 to 6")
    print(f"{'position = command':32}", *(f"{1e3 * v:6.2f}" for v in found.before))
    print(f"{'with the response':32}", *(f"{1e3 * v:6.2f}" for v in found.after))
    text = moving_mjcf(found.response.robot()).text
    errors = [run.position - driven(text, run) for run in found.runs]
    rms = np.sqrt((np.concatenate(errors) ** 2).mean(axis=0))
    print(f"{'by the exported MJCF in MuJoCo':32}", *(f"{1e3 * v:6.2f}" for v in rms))
    print("real data, SO-101, the motions of report;", found.effects.sentence)
    print(plain_text([found.effects.table()], 100))
    print(plain_text([*arbitration_tables(found.runs[0].joints, found.after, found.against)], 180))
    (bag,) = Path(sys.argv[1], "ur10_exciting").glob("*.db3")
    arm = read_robot(ROOT / "problems" / "ur10" / "robot.toml")
    laws = friction_laws(read_log(bag, arm), arm_of(arm))
    assert laws is not None
    print(f"real data, ur10_exciting, robot file of problems/ur10; {laws.effects.sentence}\n{laws.explained}")
    print(plain_text(laws.tables(), 100))


if __name__ == "__main__":
    main()

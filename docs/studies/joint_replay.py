"""Open-loop replay of the real SO-101's thirteen motions, each quarter of them withheld in turn; mrad rms a joint.

The motions of report, of which none was fitted, also by MuJoCo alone, with the exported model. Then what the diagnosis
says of each motion on its own: the arm is healthy as far as its makers know, and nobody knows the true causes.

Made by

    python docs/studies/joint_replay.py > docs/studies/joint_replay.txt
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from casadical import read_robot
from casadical.diagnosis.motion.replay import replayed
from casadical.diagnosis.motion.result import diagnose_log
from casadical.export.mjcf.moving import moving_mjcf
from casadical.measurements.logs.log import JointLog
from casadical.measurements.logs.reading import read_log
from casadical.project.diagnosis import read_logs

ROOT = Path(__file__).parents[2]


def driven(text: str, run: JointLog) -> np.ndarray:
    """Angles of a run by MuJoCo, from its first reading and its commands, shape (rows, joints)."""
    model = mujoco.MjModel.from_xml_string(text)
    data, t, out = mujoco.MjData(model), run.time - run.time[0], np.empty_like(run.position)
    assert run.command is not None
    data.qpos[:] = run.position[0]
    for i in range(model.nu):
        if samples := int(model.actuator_history[i, 0]):
            mujoco.mj_initCtrlHistory(model, data, i, None, np.full((samples, 1), run.command[0, i]))
    for k, now in enumerate(t):
        while data.time < now - 1e-9:
            data.ctrl[:] = [np.interp(data.time, t, column) for column in run.command.T]
            mujoco.mj_step(model, data)
        out[k] = data.qpos
    return out


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
    text = moving_mjcf(found.response.robot()).text
    left = np.concatenate([run.position - driven(text, run) for run in found.runs])
    print(f"{'by the exported MJCF in MuJoCo':32}", *(f"{1e3 * v:6.2f}" for v in np.sqrt((left**2).mean(axis=0))))
    print("real data, SO-101, commands and readings alone: verdict of each motion, and what fits best (a hint)")
    for log in logs:
        answer = diagnose_log(robot, log)
        ranking = answer.outcome.rankings[0]
        best = ranking.order[0]
        hint = f"{best} {ranking.probability[best]:.2f}" if answer.verdict != "none" else ""
        print(f"  {log.source.removesuffix('.csv.gz'):30} {answer.verdict:10} {hint}")


if __name__ == "__main__":
    main()

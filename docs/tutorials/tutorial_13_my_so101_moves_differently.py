"""
13. Why does my SO-101 move differently?
========================================

A hobby arm, real: five joints and a gripper on position servos. In a simulator each joint is where it was sent; here
the readings are up to 67 mrad (rms) off. Four motions of its own log say how much of that is droop, dry friction and
delay, and a MuJoCo model that moves like the arm comes out. Data: project SAGE, Apache-2.0 (data/README.md).

All it takes is ``pip install 'casadical[mujoco]'`` (here: from a clone, ``pip install '.[mujoco]'``), a robot file or a
URDF with masses, and logs with commands and readings.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from casadical import read_robot
from casadical.diagnosis.motion.replay import replayed
from casadical.measurements.logs.reading import read_log

ROOT = Path(sys.argv[0]).resolve().parents[2]  # this file lies in docs/tutorials
LOGS = ROOT / "data" / "so101_logs"
robot = read_robot(ROOT / "problems" / "so101" / "robot.toml")
folder = Path(tempfile.mkdtemp())


def casadical(*words):
    """A command as in a shell."""
    command = [sys.executable, "-c", "from casadical.cli import main; main()", *map(str, words)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    print(done.stdout or done.stderr)
    return done.returncode


# %%
# What the log is
# ---------------
# Rate, jitter, steps of the readings, what is missing: all of it is found before anything is fitted.

names = ("wave_motion", "staircase_motion", "reach_and_return", "symmetric_motion")
paths = [LOGS / f"{name}.csv.gz" for name in names]
logs = [read_log(path, robot) for path in paths]
for sentence in logs[0].findings:
    print("-", sentence)
assert len(logs[0].joints) == 6

# %%
# One command
# -----------
# It looks at each log, then fits the response of each joint and replays the motions that were **not** fitted (each in
# turn), from the first reading and the commands alone.

out = folder / "found"
assert casadical("diagnose", ROOT / "problems/so101/robot.toml", *paths, "--out", out, "--json", folder / "f.json") == 0
found = json.loads((folder / "f.json").read_text())[0]["replay"]
assert found["held_out"]
before, after = (np.array([joint[key] for joint in found["joints"]][:5]) for key in ("before_rad", "after_rad"))
assert (after < before).all()
assert (after[:3] < 0.25 * before[:3]).all()

# %%
# Before and after, of the first motion, which the other three predict; and the loop that dry friction draws over the
# command: the reading stays behind on the way up and on the way down.

replay = replayed(robot, logs[1:], logs[:1])
run, predicted = replay.runs[0], replay.predicted[0]
figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
j = 1  # shoulder_lift
for word, of, now, colour in (
    ("before: less command", run.command, run.position, "0.6"),
    ("after: less prediction", predicted, predicted, "C0"),
):
    axes[0].plot(run.time, 1e3 * (run.position - of)[:, j], colour, label=word)
    axes[1].plot(run.command[:, j], 1e3 * (now - run.command)[:, j], colour)
axes[0].set(xlabel="time [s]", ylabel="mrad", title=run.joints[j])
axes[1].set(xlabel="command [rad]", ylabel="reading less command [mrad]", title="real (grey), predicted (blue)")
axes[0].legend()
plt.show()
assert replay.after[j] < 0.5 * replay.before[j]

# %%
# In numbers: the servo of the shoulder gives so many N m per rad, and dry friction holds it within F / kp.

response = replay.response
print(np.round(1e3 * response.friction / response.gain, 1), "mrad")
assert response.gain[j] > 1

# %%
# A model that moves like that
# ----------------------------
# ``diagnosed.robot.toml`` has it in ``[drive]``; the exported MuJoCo model is loaded by MuJoCo alone and gets the
# logged commands of the motion.

assert casadical("export", "model", out / "diagnosed.robot.toml", "--out", "so101.xml") == 0

try:
    import mujoco
except ImportError:
    mujoco = None
    print("MuJoCo is not installed: pip install 'casadical[mujoco]'")

if mujoco:
    model = mujoco.MjModel.from_xml_path(str(folder / "so101.xml"))
    data, t = mujoco.MjData(model), run.time - run.time[0]
    data.qpos[:], driven = run.position[0], np.empty_like(run.position)
    for i in range(model.nu):
        if samples := int(model.actuator_history[i, 0]):
            mujoco.mj_initCtrlHistory(model, data, i, None, np.full((samples, 1), run.command[0, i]))
    for k, now in enumerate(t):
        while data.time < now - 1e-9:
            data.ctrl[:] = [np.interp(data.time, t, column) for column in run.command.T]
            mujoco.mj_step(model, data)
        driven[k] = data.qpos
    left = np.sqrt(((run.position - driven) ** 2).mean(axis=0))
    nominal = np.sqrt(((run.position - run.command) ** 2).mean(axis=0))
    print("nominal", np.round(1e3 * nominal, 1), "this model", np.round(1e3 * left, 1), "mrad")
    assert (left[1:3] < 0.5 * nominal[1:3]).all()

# %%
# What is left
# ------------
# In ``figure_eight`` and ``random_waypoints`` shoulder and elbow stay up to 95 mrad behind together, always where the
# wrist is lowest (52 to 70 mm above the base's plane, 33 to 85 mm commanded): as if the gripper stood on the table. A
# response of single joints has no such thing, and the figures of these motions say so.

"""
13. Why does my SO-101 move differently?
========================================

A hobby arm, real: five joints and a gripper on position servos. In a simulator each joint is where it was sent; here
the readings are up to 67 mrad (rms) off. Six motions of its own log say how much of that is droop, dry friction and
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
import pandas as pd

ROOT = Path(sys.argv[0]).resolve().parents[2]  # this file lies in docs/tutorials
LOGS = ROOT / "data" / "so101_logs"
folder = Path(tempfile.mkdtemp())


def casadical(*words):
    """A command as in a shell."""
    command = [sys.executable, "-c", "from casadical.cli import main; main()", *map(str, words)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    print(done.stdout or done.stderr)
    return done.returncode


# %%
# What a log is
# -------------
# A row a sample: the time, and of each joint what was commanded and what was read (``docs/log-files.md`` lists what
# else may be there, and in which forms). Rate, jitter, lost samples and steps of the readings are found before a fit.

names = ("wave_motion", "staircase_motion", "reach_and_return", "symmetric_motion", "circular_motion", "end_effector")
paths = [LOGS / f"{name}.csv.gz" for name in names]
log = pd.read_csv(paths[0])
command, position = (log[[f"{name}{i}_rad" for i in range(1, 7)]].to_numpy() for name in ("command", "q"))
print(f"{len(log)} samples of {log['time_s'].iloc[-1]:.0f} s")

# %%
# One command
# -----------
# It looks at all logs together, then fits the response of each joint and replays the motions that were **not** fitted
# (each in turn), from the first reading and the commands alone. One sentence says which effects of which joints make
# the error, and a table what the replay leaves with one of them taken out at a time.

out = folder / "found"
assert casadical("diagnose", ROOT / "problems/so101/robot.toml", *paths, "--out", out, "--json", folder / "f.json") == 0
found = json.loads((folder / "f.json").read_text())["replay"]
assert found["held_out"]
before, after = (np.array([joint[key] for joint in found["joints"]][:5]) for key in ("before_rad", "after_rad"))
assert (after < before).all()
assert (after[:3] < 0.25 * before[:3]).all()
without = {effect: np.array(rms[:5]) for effect, rms in found["effects"].items()}
assert (without["dry friction"][1:3] > 2 * after[1:3]).all()
assert (without["gravity"][1:3] > 2 * after[1:3]).all()

# %%
# In numbers: the servo of each joint gives so many N m per rad, and dry friction holds it within so much.

gain, friction = (np.array(found["drive"][key]) for key in ("kp_Nm_per_rad", "friction_Nm"))
print(np.round(1e3 * friction / gain, 1), "mrad")
assert (gain > 0).all()

# %%
# A model that moves like that
# ----------------------------
# ``diagnosed.robot.toml`` has it in ``[drive]``; the exported MuJoCo model is loaded by MuJoCo alone and gets the
# logged commands of the first motion, one of those it was fitted to (what is left of others is above). On the right the
# loop that dry friction draws over the command: the reading stays behind on the way up and on the way down.

assert casadical("export", "model", out / "diagnosed.robot.toml", "--campaign", paths[0], "--out", "so101.xml") == 0

try:
    import mujoco
except ImportError:
    mujoco = None
    print("MuJoCo is not installed: pip install 'casadical[mujoco]'")

j, t = 1, log["time_s"].to_numpy() - log["time_s"].iloc[0]  # shoulder_lift
figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
axes[0].plot(t, 1e3 * (position - command)[:, j], "0.6", label="before: less command")
axes[1].plot(command[:, j], 1e3 * (position - command)[:, j], "0.6")
if mujoco:
    model = mujoco.MjModel.from_xml_path(str(folder / "so101.xml"))
    data, driven = mujoco.MjData(model), np.empty_like(position)
    data.qpos[:] = position[0]
    for k, now in enumerate(t):
        while data.time < now - 1e-9:
            data.ctrl[:] = [np.interp(data.time, t, column) for column in command.T]
            mujoco.mj_step(model, data)
        driven[k] = data.qpos
    axes[0].plot(t, 1e3 * (position - driven)[:, j], "C0", label="after: less this model")
    axes[1].plot(command[:, j], 1e3 * (driven - command)[:, j], "C0")
    nominal, left = (np.sqrt(((position - of) ** 2).mean(axis=0)) for of in (command, driven))
    print("nominal", np.round(1e3 * nominal, 1), "this model", np.round(1e3 * left, 1), "mrad")
    assert (left[1:3] < 0.5 * nominal[1:3]).all()
axes[0].set(xlabel="time [s]", ylabel="mrad", title="shoulder_lift")
axes[1].set(xlabel="command [rad]", ylabel="reading less command [mrad]", title="real (grey), this model (blue)")
axes[0].legend()
plt.show()

# %%
# What is left
# ------------
# In ``figure_eight`` and ``random_waypoints`` shoulder and elbow stay up to 95 mrad behind together, always where the
# wrist is lowest: the gripper rests on the table. With all ten motions of ``problems/so101`` the command finds its
# height (69 mm, of the tool's point) from one that touches it, too, and the exported model has it as a plane. Rubbing
# along it, and a joint that others shake loose, are what no such model holds.

# %%
# In one table
# ------------
# The same replays with one effect taken out at a time, as ``found["effects"]`` has them: what each joint would be off
# by, in mrad, without it. Dry friction and gravity of shoulder and elbow are worth modelling first, delay and inertia
# last.

for effect, rms in {"position = command": before, **without, "nothing": after}.items():
    print(f"{effect:20}", *(f"{1e3 * v:6.1f}" for v in rms))
worst = max(without, key=lambda effect: float((without[effect] ** 2 - after**2).sum()))
assert worst in ("dry friction", "gravity")

# %%
# And a cause by its name
# -----------------------
# In a copy of one motion the wrist roll stops at -0.17 rad, as at a cable: its reading stays while commands go on, and
# its current rises. The command names the stop with its angle; the replay and the exported model have it, too.

stopped = pd.read_csv(LOGS / "symmetric_motion.csv.gz")
beyond = stopped["q5_rad"] < -0.17
stopped.loc[beyond, "q5_rad"] = -0.17
stopped.loc[beyond, "current5_abs"] *= 8
stopped.to_csv(folder / "stopped.csv", index=False)
assert casadical("diagnose", ROOT / "problems/so101/robot.toml", "stopped.csv", "--json", folder / "stop.json") == 0
(cause,) = json.loads((folder / "stop.json").read_text())["causes"]
assert (cause["effect"], cause["joint"]) == ("contact", 5)
assert abs(cause["angle_rad"] + 0.17) < 0.002

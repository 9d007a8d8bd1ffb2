"""
9. Tracker accuracy for fifty euros
===================================

A laser tracker costs more than many robots. Three draw wires cost little. Here a real UR10 is calibrated with the
distances that three wires would read, and a laser tracker judges it at 500 poses that no fit has seen. The readings
and the tracker's positions are real; the distances are computed from them, with noise of 0.05 mm, one sigma.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from casadical import identify, read_problem, read_robot
from casadical.identification import errors
from casadical.identification.pose_selection import Noise, place_instrument

ROOT = Path(sys.argv[0]).resolve().parents[2]  # this file lies in docs/tutorials
folder = Path(tempfile.mkdtemp()) / "wired"
folder.mkdir()

# %%
# The robot, 60 poses to read, 500 to judge on
# --------------------------------------------
problem = read_problem(ROOT / "problems/ur10")
everything = problem.sets["identify"][0].positions_alone()
order = np.random.default_rng(4).permutation(len(everything))
read, judge = everything[order[:60]], everything[order[-500:]]

# %%
# Where should the wires end?
# ---------------------------
# A wire sees errors along itself alone, so that not every place is as good. The plan tries every three of 48 posts
# about the robot. From a shell: ``casadical plan robot.toml -n 60 --wires 3``, which
# chooses the poses as well; here they are given. That the joints of such a robot err by some 0.1 mrad, whatever is
# calibrated, is told with the noise.

noise = Noise(sigma=5e-5, repeatability=1e-4)
turns = np.deg2rad(np.arange(0, 360, 30))
local = np.array([[2 * np.cos(a), 2 * np.sin(a), height] for height in (0.0, 0.6, 1.2, 1.8) for a in turns])
places = {"near the robot": np.array([[1.8, 0.3, 0.0], [-0.9, 1.6, 0.0], [-0.6, -1.7, 0.0]])}
places["as planned"] = place_instrument(problem.robot, "wires", local, 3, q=read.q, task=read.q, noise=noise).places
print((1e3 * places["as planned"]).round(0))

# %%
# What the wires would read
# -------------------------
# A table for each wire: readings, the number of the pose, and the distance. Where a wire ends, the table does not say.


def write_tables(ends):
    """Distances from the tracker's positions to three places about the robot's base, in error by 0.05 mm."""
    base = identify(problem.robot, read, loss="huber", priors=True).robot.base.T
    chance = np.random.default_rng(1)
    text = 'casadical = 1\ntitle = "UR10 by three wires"\ndata = "real"\nrobot = "robot.toml"\nmethods = ["KM"]\n'
    for k, end in enumerate(ends @ base[:3, :3].T + base[:3, 3], 1):
        table = pd.DataFrame(np.rad2deg(read.q), columns=[f"q{i}_deg" for i in range(1, 7)])
        length = np.linalg.norm(read.position - end, axis=1) + chance.normal(0, 5e-5, len(read))
        table.assign(pose=range(1, 61), distance_mm=1e3 * length).to_csv(folder / f"wire{k}.csv", index=False)
        text += f'\n[[measurements]]\nfile = "wire{k}.csv"\nkind = "distance"\n'
    (folder / "robot.toml").write_text((ROOT / "problems/ur10/robot.toml").read_text())
    (folder / "problem.toml").write_text(text + "\n[sets]\nidentify = 1\n")


# %%
# Calibrate, and ask the tracker
# ------------------------------
# The wires do not know where the base stands. Before the tracker judges, the base is put where the tracker has it.

casadical_command = Path(sys.executable).with_name("casadical")


def run(*words):
    """Run the command; what it prints."""
    done = subprocess.run([casadical_command, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def judged(robot):
    """Errors [mm] at the poses that nothing has seen."""
    return 1e3 * errors(identify(robot, read, ["base"], loss="huber").robot, judge)


found = {"as it came": judged(problem.robot)}
for name, ends in places.items():
    write_tables(ends)
    printed = run("calibrate", folder, "--out", folder / "out")
    found[f"three wires, {name}"] = judged(read_robot(folder / "out/KM.robot.toml"))
found["laser tracker"] = judged(identify(problem.robot, read, loss="huber", priors=True).robot)
print(printed)

figure, axis = plt.subplots(figsize=(8, 2.6), layout="constrained")
means = {name: float(e.mean()) for name, e in found.items()}
axis.barh(list(means), list(means.values()), color=["#b3ada2", "#8fb8b2", "#0f766e", "#5f6b73"])
for row, mean in enumerate(means.values()):
    axis.text(mean, row, f" {mean:.2f}", va="center")
axis.invert_yaxis()
axis.set(xlabel="mean error at 500 poses that were not used [mm], by the tracker", xlim=(0, 1.15 * max(means.values())))
plt.show()

print({name: round(mean, 3) for name, mean in means.items()})
assert means["three wires, as planned"] < 0.65 * means["as it came"]
assert means["three wires, as planned"] < 1.2 * means["laser tracker"]
assert means["three wires, as planned"] < means["three wires, near the robot"]

# %%
# What is left, and why
# ---------------------
# The diagnosis takes the three tables as one campaign, and finds with the wires what the tracker would find.

told = " ".join(run("diagnose", folder, *(folder / f"wire{k}.csv" for k in (1, 2, 3)), "--together").split())
print(told)
assert "joint_error_curve" in told

# %%
# What one wire cannot see
# ------------------------
# Every command says what such readings leave open, with the one thing that would show it.

one = folder / "problem.toml"
one.write_text(one.read_text().partition('\n[[measurements]]\nfile = "wire2.csv"')[0] + "\n[sets]\nidentify = 1\n")
checked = " ".join(run("check", folder).split())
print(checked)
assert "distances to a second and a third place, not in line with it, show them" in checked

# %%
# What to do next
# ---------------
# - Which set-up, how many poses, how much noise: :doc:`/wires`.
# - Poses and places for your robot: :doc:`/plan`.

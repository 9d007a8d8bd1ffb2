"""
12. Five touches a day
======================

A simulated arm is calibrated, touched at five planned points on three days, and hit on the third: the zero of joint 3
turns by 0.02 degrees. Five touches say so, and correct the robot file. All data here are made up.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from casadical import Measurements, read_robot
from casadical.identification import predicted

COMMAND = [sys.executable, "-c", "from casadical.cli import main; main()"]
folder = Path(tempfile.mkdtemp())


def casadical(*words):
    """A command as in a shell, in the folder; its exit code."""
    done = subprocess.run([*COMMAND, *map(str, words)], cwd=folder, capture_output=True, text=True, check=False)
    print(done.stdout or done.stderr)
    return done.returncode


assert casadical("new", "arm", "--example") == 0
assert casadical("calibrate", "arm", "--out", "results", "--quiet") == 0
robot = read_robot(folder / "results" / "SKCM.robot.toml")

# %%
# Which five?
# -----------
# Those that tell most about zeros, tool and foot.

assert casadical("plan", "results", "--touches", "5") == 0
plan = pd.read_csv(folder / "touches.csv")
print(plan.round(2).to_string(index=False))
q = np.deg2rad(plan[list(robot.reading_units)].to_numpy(dtype=float))
assert q.shape == (5, 6)

# %%
# Three days
# ----------
# The robot as its file has it plays the real one; the instrument has noise of 0.02 mm.

rng = np.random.default_rng(3)
hit = robot.with_values({"theta3": robot.parameters["theta3"].value + np.deg2rad(0.02)})


def touch(day, real):
    """A table as an instrument writes it."""
    m = Measurements(q=q, kind="position", position=np.zeros((5, 3)))
    xyz = 1e3 * predicted(real, m)[0] + 0.02 * rng.normal(size=(5, 3))
    table = pd.DataFrame(np.rad2deg(q), columns=list(robot.reading_units))
    table.assign(x_mm=xyz[:, 0], y_mm=xyz[:, 1], z_mm=xyz[:, 2]).to_csv(folder / f"{day}.csv", index=False)


touch("2026-03-02", robot)
touch("2026-03-03", robot)
days = ["2026-03-02.csv", "2026-03-03.csv"]
assert casadical("verify", "results", *days, "--touches") == 0

# %%
# The crash
# ---------
# Exit code 5: no longer valid.

touch("2026-03-04", hit)
words = ("--touches", "--update", "corrected.robot.toml", "--json", "found.json")
assert casadical("verify", "results", *days, "2026-03-04.csv", *words) == 5
found = json.loads((folder / "found.json").read_text())
assert max(found["changes"], key=found["changes"].get) == "joint_zero@3"
(moved,) = found["moved"]
assert abs(moved["value"] - 0.02) < 4 * moved["std_error"]

# %%
# Corrected
# ---------
# The corrected robot is written where that is better than leaving it.

assert found["correction"]["written"]
new = read_robot(folder / "corrected.robot.toml")
left = new.parameters["theta3"].value - hit.parameters["theta3"].value
print(f"{np.rad2deg(left):+.4f} deg are left")
assert abs(np.rad2deg(left)) < 0.005
chart = pd.DataFrame(found["chart"])
print(chart[["day", "rms_mm", "T2", "limit", "within"]].to_string(index=False))
assert list(chart["within"]) == ["yes", "yes", "no"]

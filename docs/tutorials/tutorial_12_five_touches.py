"""
12. Five touches a day
======================

A simulated arm is calibrated, touched at five planned points on three days, and hit on the third: the zero of joint 3
turns by 0.02 degrees. Five touches say so, and correct the robot file. All data here are made up.
"""

import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from casadical import Measurements, calibrate, read_problem, read_robot
from casadical.fleet.touches import plan_touches, touched
from casadical.identification.accuracy import predicted
from casadical.project.new import new_problem

folder = Path(tempfile.mkdtemp())
new_problem(folder / "arm")
calibrate(folder / "arm").write(folder / "results")
robot = read_robot(folder / "results" / "SKCM.robot.toml")
print(read_problem(folder / "arm"))

# %%
# Which five?
# -----------
# Those that tell most about zeros, tool and foot. From a shell: ``casadical verify results --touches 5``.

plan = plan_touches(folder / "results", 5)
print(plan.round(2))
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
    path = folder / f"{day}.csv"
    table.assign(x_mm=xyz[:, 0], y_mm=xyz[:, 1], z_mm=xyz[:, 2]).to_csv(path, index=False)
    return path


days = [touch("2026-03-02", robot), touch("2026-03-03", robot)]
second = touched(folder / "results", days)
print(second)
assert second.verdict == "valid"

# %%
# The crash
# ---------
days.append(touch("2026-03-04", hit))
third = touched(folder / "results", days)
for block in third.blocks()[:3]:
    print(block.text)
name, amount, std_error, unit = third.moved[0]
print(f"{name}: {amount:+.4f} +- {std_error:.4f} {unit}")
assert third.label == "joint_zero@3"
assert abs(amount - 0.02) < 4 * std_error

# %%
# Corrected
# ---------
# The corrected robot is written where that is better than leaving it: ``--update corrected.robot.toml``.

assert third.better
new = third.corrected()
left = new.parameters["theta3"].value - hit.parameters["theta3"].value
print(f"{np.rad2deg(left):+.4f} deg are left")
assert abs(np.rad2deg(left)) < 0.005
print(third.chart_csv())
assert not third.charted_within[-1]

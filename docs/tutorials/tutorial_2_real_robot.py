"""
2. A real robot from a CSV
==========================

A Universal Robots UR10, 2773 random poses measured with a laser tracker (Landgraf et al. 2021, see
``data/README.md``). We look at the table, identify the robot, check the accuracy of the result, and find how many poses
would have been enough.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import casadical
from casadical.identification import errors

ROOT = Path(sys.argv[0]).resolve().parents[2]  # this file lies in docs/tutorials
CSV = ROOT / "data/ur10_laser_tracker/series_C_random_poses.csv"

# %%
# Look at the table first
# -----------------------
# Units are part of the column names, so nothing is guessed: ``q1_rad`` .. are joint readings, ``x_mm`` .. is the
# measured point. The table also has the probe's orientation; we use the positions only.

table = pd.read_csv(CSV)
print(table[["q1_rad", "q2_rad", "x_mm", "y_mm", "z_mm", "std_x"]].describe().round(3).to_string())
assert len(table) == 2773

# %%
# The robot
# ---------
# ``problems/ur10/robot.toml`` has the maker's DH table in the maker's convention. The pose of the robot in the
# tracker's frame is unknown, and so is the position of the probe on the flange: both are identified.

robot = casadical.read_robot(ROOT / "problems/ur10/robot.toml")
m = casadical.read_measurements(CSV, robot.n, "position")
sets = m.split({"identify": 400, "report": 1000}, seed=0)
print(robot.name, "has", len(robot.parameters), "parameters;", len(sets["identify"]), "poses to identify them from")

# %%
# Identify
# --------
# `KM` finds the geometry, `SKCM` the geometry and the compliance of the joints that are marked compliant. A verdict
# with AT BOUNDS is a warning: here the best fit would have a negative compliance, so do not trust the compliances of
# this arm one by one.

results = {method: casadical.identify(robot, sets["identify"], method=method) for method in ("KM", "SKCM")}
for result in results.values():
    print(result.verdict)
assert all(result.is_optimal() for result in results.values())

# %%
# Errors of 1000 held-out poses. *Given* is the robot file unchanged, *placed* has base and tool fitted: this is the
# only "before" that does not depend on the position of the tracker.

rows = []
for method, result in results.items():
    for state, a in result.accuracy(sets["report"]).items():
        rows.append((method, state, 1e3 * a.mean, 1e3 * a.p95, 1e3 * a.max))
print(pd.DataFrame(rows, columns=["method", "state", "mean_mm", "p95_mm", "max_mm"]).round(3).to_string(index=False))

result = results["SKCM"]
before, after = (1e3 * result.accuracy(sets["report"])[state].mean for state in ("placed", "calibrated"))
assert 0.8 < before < 1.0
assert 0.40 < after < 0.50

# %%
# The identified parameters
# -------------------------

found = result.parameters.query("status == 'identified'")
held = result.parameters.query("status == 'not identifiable'")
print(found[["name", "nominal", "value", "std_error", "unit"]].round(4).to_string(index=False))
print(held[["name", "reason"]].to_string(index=False))
assert "theta6" in set(held.name)  # a point near the last axis has no direction

# %%
# Are the residuals noise?
# ------------------------
# The tracker repeats a coordinate to a few hundredths of a millimetre (column ``std_x``). The scatter after the fit is
# several times larger. Most of the residuals are therefore *not* noise, and the standard errors above, which assume
# noise, are too small. This is the most important figure of a calibration, and the easiest to overlook.

scatter = 1e3 * result.sigmas[0][0]
tracker = float(np.median(pd.read_csv(CSV)["std_x"]))
print(f"scatter of one coordinate after the fit: {scatter:.3f} mm; the tracker's own: {tracker:.3f} mm")
assert scatter > 5 * tracker

# %%
# How many poses would have been enough?
# --------------------------------------
# The error on new poses falls quickly and then stays constant: more poses do not help if the model lacks something.

sizes = (15, 25, 40, 70, 150, 400)
curve = []
for n in sizes:
    few = casadical.identify(robot, sets["identify"][:n], method="KM")
    curve.append(1e3 * few.accuracy(sets["report"])["calibrated"].mean)
    print(f"{n:4d} poses: {curve[-1]:.3f} mm on new poses")
assert curve[0] > 1.2 * curve[-1]  # fifteen are too few
assert curve[-2] < 1.06 * curve[-1]  # 150 are nearly as good as 400

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
left.semilogx(sizes, curve, "o-")
left.set(xlabel="poses to identify from", ylabel="mean error on 1000 new poses [mm]", ylim=(0, None))
edges = np.geomspace(0.03, 20, 60)
for state, model in (("before (base and tool fitted)", result.placed), ("SKCM", result.robot)):
    right.hist(1e3 * errors(model, sets["report"]), bins=edges, alpha=0.7, label=state)
right.set(xscale="log", xlabel="position error of a new pose [mm]", ylabel="poses")
right.legend()
plt.show()

# %%
# Save the robot
# --------------
# The calibrated robot is a file like the nominal one, and gives the same errors when it is read again.

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "ur10_calibrated.toml"
    casadical.write_robot(result.robot, path)
    again = casadical.read_robot(path)
assert abs(1e3 * errors(again, sets["report"]).mean() - after) < 1e-6
print(f"read again: {1e3 * errors(again, sets['report']).mean():.4f} mm")

# %%
# Outliers
# --------
# Real tables have outliers. We shift ten of the 400 poses by 20 mm: the plain fit gets worse, a robust loss removes
# them.

spoilt = sets["identify"].position.copy()
spoilt[:10] += 0.02
with_blunders = replace(sets["identify"], position=spoilt)
for loss in ("linear", "huber"):
    fitted = casadical.identify(robot, with_blunders, method="KM", loss=loss)
    mean = 1e3 * fitted.accuracy(sets["report"])["calibrated"].mean
    print(f"{loss}: {mean:.3f} mm on new poses, {len(fitted.outliers)} poses removed")
    if loss == "huber":
        assert {i for _, i in fitted.outliers} >= set(range(10))
        assert mean < 1.05 * curve[-1]

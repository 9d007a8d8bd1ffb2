"""
1. A planar arm by hand
=======================

The idea of calibration in ten minutes: a model with a few unknown numbers, measured positions, and least squares.
First with numpy only, then with `casadical.identify`, which must give the same result.

Run it from anywhere: ``python docs/tutorials/tutorial_1_planar_arm.py``.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import casadical

ROOT = Path(sys.argv[0]).resolve().parents[2]  # this file lies in docs/tutorials

# %%
# The data
# --------
# An arm of two links moves in a horizontal plane. At 40 poses the two joint readings were recorded and the position of
# the end was measured. The drawing says: link 1 is 400 mm long, link 2 is 300 mm, and both zeros are exact. (The data
# are simulated, with 0.02 mm noise, so the true values are known.)

table = pd.read_csv(ROOT / "data/planar/planar.csv")
q = np.deg2rad(table[["q1_deg", "q2_deg"]].to_numpy())
measured = 1e-3 * table[["x_mm", "y_mm"]].to_numpy()
known, new = np.arange(25), np.arange(25, 40)  # we learn from the first, and judge by the second


def position(q, a1, theta1, tool_x, tool_y):
    """End of the arm, shape (n, 2) [m]: link 1 turned by q1 + theta1, the end at (tool_x, tool_y) on link 2."""
    one = q[:, 0] + theta1
    both = one + q[:, 1]
    x = a1 * np.cos(one) + tool_x * np.cos(both) - tool_y * np.sin(both)
    y = a1 * np.sin(one) + tool_x * np.sin(both) + tool_y * np.cos(both)
    return np.stack([x, y], axis=1)


def mean_error_mm(values, which):
    """Mean distance between model and measurement [mm]."""
    return 1e3 * np.linalg.norm(position(q[which], *values) - measured[which], axis=1).mean()


drawing = np.array([0.4, 0.0, 0.3, 0.0])
print(f"as drawn, the model is wrong by {mean_error_mm(drawing, new):.2f} mm on average")
assert 1.5 < mean_error_mm(drawing, new) < 2.0

# %%
# Least squares
# -------------
# A small change of the four numbers moves the end by ``J @ change``. Choose the change that brings the model
# closest to the measurements, apply it, and repeat until it is zero: the Gauss-Newton method. The Jacobian ``J`` is
# computed by finite differences here; `casadical` uses exact derivatives from CasADi.


def jacobian(values):
    """Derivatives of all coordinates by the four numbers, shape (2 n, 4)."""
    columns = [
        (position(q[known], *(values + step)) - position(q[known], *(values - step))).ravel() / 2e-6
        for step in 1e-6 * np.eye(4)
    ]
    return np.stack(columns, axis=1)


values = drawing
for step in range(4):
    residual = (measured[known] - position(q[known], *values)).ravel()
    values = values + np.linalg.lstsq(jacobian(values), residual, rcond=None)[0]
    print(f"step {step + 1}: {mean_error_mm(values, known):.4f} mm left on the 25 poses of the fit")

print(f"on the 15 held-out poses: {mean_error_mm(values, new):.4f} mm")
assert mean_error_mm(values, new) < 0.04

# %%
# How accurate are the values?
# ----------------------------
# The sum of squared residuals, divided by the degrees of freedom, estimates the variance of the noise. The Jacobian
# converts it into the variance of the parameters. A calibrated value without a standard error is of little use.

residual = (measured[known] - position(q[known], *values)).ravel()
sigma = np.sqrt(residual @ residual / (residual.size - 4))
J = jacobian(values)
error = sigma * np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
built = np.array([0.4006, np.deg2rad(0.25), 0.2993 * np.cos(np.deg2rad(-0.4)), 0.2993 * np.sin(np.deg2rad(-0.4))])

print(f"noise of a coordinate: {1e3 * sigma:.4f} mm (simulated: 0.02)")
names = ("a1", "theta1", "tool_x", "tool_y")
for name, value, e, truth in zip(names, 1e3 * values, 1e3 * error, 1e3 * built, strict=True):
    print(f"{name:7s} {value:9.4f} +- {e:.4f}   built with {truth:9.4f}   (mm, mrad)")
assert abs(sigma - 2e-5) < 4e-6
assert np.all(abs(values - built) < 3 * error)

# %%
# The same with casadical
# -----------------------
# The robot is described in ten lines of ``problems/planar/robot.toml``. For the same four numbers it finds the
# same values, to a thousandth of their standard errors.

robot = casadical.read_robot(ROOT / "problems/planar/robot.toml")
m = casadical.read_measurements(ROOT / "data/planar/planar.csv", robot.n)
four = casadical.identify(robot, m[known], names)
by_name = dict(zip(four.names, four.estimate, strict=True))
same = np.array([by_name[name] for name in names])
assert np.all(abs(same - values) < 1e-3 * error)

# %%
# What cannot be identified
# -------------------------
# The built arm has a wrong zero of joint 2 as well. It is not among the four numbers, because a rotation of link 2
# about its joint moves the end exactly like a sideways shift of the end on link 2: no measurement of the end can
# distinguish them. A Jacobian with a column for it would have a singular value of zero. `casadical` finds such
# columns, holds one parameter of each group at its nominal value, and reports which and why.

everything = casadical.identify(robot, m[known], method="KM")
print(everything.verdict)
held = everything.parameters.query("status == 'not identifiable'")
print(held[["name", "reason"]].to_string(index=False))
assert sorted(held.name) == ["d1", "d2", "theta2"]
assert "tool_y" in held.set_index("name").reason["theta2"]

accuracy = everything.accuracy(m[new])
print(f"new poses: {1e3 * accuracy['placed'].mean:.2f} mm before, {1e3 * accuracy['calibrated'].mean:.4f} mm after")
assert 1e3 * accuracy["calibrated"].mean < 0.04  # heights are measured too, so the distance holds one noise more

# %%
# A figure
# --------
# Each arrow is the error of one pose, enlarged 100 times. Before calibration the errors have a pattern; afterwards
# only noise is left, which has none.

figure, axes = plt.subplots(1, 2, figsize=(9, 4.6), sharex=True, sharey=True, layout="constrained")
for ax, numbers, title in zip(axes, (drawing, values), ("as drawn", "calibrated"), strict=True):
    left = 100 * (measured - position(q, *numbers))
    ax.plot(*measured.T, ".", color="0.6", markersize=4)
    ax.quiver(*measured.T, *left.T, angles="xy", scale_units="xy", scale=1, width=0.004, color="C0")
    ax.set(title=f"{title}: {mean_error_mm(numbers, new):.3f} mm on new poses", xlabel="x [m]", aspect="equal")
axes[0].set_ylabel("y [m]")
plt.show()

# %%
# Summary
# -------
# - The parameters are identified from some poses and tested on others.
# - Every value has a standard error, and some parameters are not identifiable.
# - The residuals should look like noise of the size of your instrument's. If they do not, the model lacks something,
#   and :doc:`tutorial 5 <tutorial_5_diagnose_a_gap>` finds out what.

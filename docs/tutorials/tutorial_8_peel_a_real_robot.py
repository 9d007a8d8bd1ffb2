"""
8. Peel a real robot
====================

A real UR10, measured by a laser tracker at 2773 random poses: from 0.9 mm to the noise of its readings, layer by
layer. Every figure below is an error on poses that no fit and no diagnosis has seen.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from casadical import diagnose, identify, read_problem
from casadical.identification import errors
from casadical.measurements import derive

ROOT = Path(sys.argv[0]).resolve().parents[2]  # this file lies in docs/tutorials

# %%
# The poses
# ---------
# 300 poses to learn from, 800 others to judge on. Effects of time need to know when a pose was measured: `progress`,
# its place in the campaign, is worked out before the campaign is split.

problem = read_problem(ROOT / "problems/ur10")
everything = derive(problem.sets["identify"][0], ["progress"])[0]
order = np.random.default_rng(0).permutation(len(everything))
learn, judge = everything[np.sort(order[:300])], everything[order[300:1100]]

# %%
# The first layers: geometry, and joints that give way
# -----------------------------------------------------
layers = {}
for name, method in (("geometry", "KM"), ("and compliance", "SKCM")):
    result = identify(problem.robot, learn, method=method)
    layers.setdefault("base and tool alone", errors(result.placed, judge))
    layers[name] = errors(result.robot, judge)

# %%
# The next layers: what the diagnosis finds
# ------------------------------------------
# A calibrated robot of this class is usually left at some tenths of a millimetre. The tracker reads ten times better.

found = diagnose(problem.robot, learn)
print(found.verdict, [(cause.label, round(cause.confidence, 3)) for cause in found.causes])
print(found.course[["model", "gap_mm", "blocks_mm"]].to_string(index=False))

# %%
# The first cause is an error curve in every joint: what its encoder reads and where its link stands differ by a
# function of its own angle that repeats every turn. The second is a measuring frame that moves at the start of the
# day and comes to rest, which nobody could see beneath the first.
#
# The verdict is `explained`: both causes are certain, and what may still hide in the noise is less than half of what
# they explain. The noise is not declared here, so small effects of no name may be part of it.

for top, cause in enumerate(found.causes, 1):
    if cause.effects:
        layers[f"and {cause.label.replace('_', ' ')}"] = errors(found.apply(top), judge)

# %%
# All layers
# ----------
figure, axis = plt.subplots(figsize=(8, 3.6), layout="constrained")
means = [1e3 * e.mean() for e in layers.values()]
axis.barh(list(layers), means, color=["#b3ada2", "#8fb8b2", "#5f9f98", "#0f766e", "#0b5a54"][: len(means)])
for place, mean in enumerate(means):
    axis.text(mean, place, f" {mean:.3f}", va="center")
axis.invert_yaxis()
axis.set(xlabel="mean error of 800 poses that were never seen [mm]", xlim=(0, 1.12 * max(means)))
plt.show()

for name, mean in zip(layers, means, strict=True):
    print(f"{name:<28} {mean:.3f} mm")

assert found.verdict == "explained"
assert found.causes[0].effect == "joint_error_curve"
assert found.causes[0].confidence > 0.92
assert means[-1] < 0.11 < 0.3 < means[1]

# %%
# The curves
# ----------
# One harmonic after another, the curve of joint 2 as the refit has it, with the readings that it was learnt from.

robot = found.apply(1)
(curve,) = found.causes[0].effects
q = np.linspace(-np.pi, np.pi, 2000)
values = robot.effect_values
shape = sum(
    values[f"{curve.label}.s{k}_q2"] * np.sin(k * q) + values[f"{curve.label}.c{k}_q2"] * np.cos(k * q)
    for k in range(1, curve.orders + 1)
)
figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
axis.plot(np.rad2deg(q), 1e6 * shape, color="#0f766e", linewidth=1)
readings = np.rad2deg(np.angle(np.exp(1j * learn.q[:, 1])))
axis.plot(readings, np.full(len(learn), 1e6 * shape.min() - 60), "|", color="#23262b", markersize=6)
axis.set(xlabel="joint 2 [deg]", ylabel="error [urad]", xlim=(-180, 180))
plt.show()

# %%
# Where no pose was measured (no mark below), the curve is a guess and its uncertainty grows; keep a program's joint
# angles where marks are, or measure there. `casadical diagnose --out` writes this robot to a file, curves and all.

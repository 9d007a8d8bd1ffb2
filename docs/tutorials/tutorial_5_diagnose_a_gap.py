"""
5. Diagnose a gap
=================

A robot has been calibrated, and an error is left. This tutorial finds the cause, tests it on poses that were
not used to find it, and corrects the model. The campaign comes from a simulator that shares no formula with the
model (`data/campaigns/practice`); its hidden cause is shown at the end.
"""

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from casadical import diagnose, identify, isolability, next_poses, read_campaign_robot, read_measurements
from casadical.diagnosis import analyse
from casadical.identification import errors, predicted
from casadical.measurements import derive

ROOT = Path(sys.argv[0]).resolve().parents[2]  # this file lies in docs/tutorials
CAMPAIGNS = ROOT / "data/campaigns/practice"

# %%
# First look
# ----------
# 60 poses of a KUKA KR 210. In addition to readings and positions the log has the columns that a diagnosis needs:
# time, temperature, payload, and the direction of approach of each joint. Effects of a missing column cannot be found.

robot = read_campaign_robot(ROOT / "problems/kr210")
m = read_measurements(CAMPAIGNS / "kr210-P02.csv", robot.n)
print(len(m), "poses;", ", ".join(m.conditions))

base = identify(robot, m, ("kinematic", "compliance"), priors=True)
residual = 1e3 * (m.position - predicted(base.robot, m)[0])
print(f"after calibration: {np.linalg.norm(residual, axis=1).mean():.3f} mm mean on the poses used")

figure, axes = plt.subplots(1, 3, figsize=(11, 3.4), sharey=True, layout="constrained")
for ax, (name, unit, x) in zip(
    axes,
    (
        ("joint 1", "deg", np.rad2deg(m.q[:, 0])),
        ("pose", "number", np.arange(1, len(m) + 1)),
        ("temperature", "degC", m.conditions["temperature_degC"]),
    ),
    strict=True,
):
    ax.plot(x, residual, "o", markersize=3, label=["x", "y", "z"])
    ax.set(xlabel=f"{name} [{unit}]")
axes[0].set_ylabel("residual [mm]")
axes[2].legend()
plt.show()

# %%
# The residuals are about a tenth of a millimetre, with some pattern. But the fit has already changed link lengths and
# stiffnesses to absorb part of the cause. Only the part that the base parameters cannot reproduce is left.

# %%
# What can these poses show?
# --------------------------
# First, compute how visible each effect would be in these poses at a realistic size. *Absorbed* is the
# share that the base model absorbs; *findable_from* is the multiple of the realistic size from which it would be
# found nine times in ten.

seen = isolability(robot, m)
print(seen.effects.sort_values("visible_to_noise", ascending=False).head(8).round(3).to_string())
print("and the least visible:\n" + seen.effects.sort_values("visible_to_noise").head(4).round(3).to_string())

# %%
# Diagnose
# --------
# Each effect's signature is fitted *together* with the base model; the evidence balances fit and flexibility, and
# unlisted smooth causes are compared with the listed ones.

found = diagnose(robot, m)
print(found.verdict, [(c.label, round(c.confidence, 3)) for c in found.causes])
cause = found.causes[0]
for name, (value, error, unit) in cause.estimates.items():
    print(f"  {name} = {value:.3g} +- {error:.2g} {unit}")
print(f"gap, held out: {1e3 * found.gap.before:.4f} mm; floor of the noise alone: {1e3 * found.gap.floor:.4f} mm")
low, high = cause.shrink_interval
print(f"shrinks by {100 * cause.shrink:.0f} % (95 % interval {100 * low:.0f} .. {100 * high:.0f} %)")
assert found.verdict == "explained"
assert [c.label for c in found.causes] == ["thermal_growth"]

# %%
# Where it lies, and how far the gap falls
# ----------------------------------------
# Growth lies in the links up to the wrist (a row of the DH table each); errors of joints explain nothing of it.

where = analyse(found).where
print(where.links[["part", "share", "low", "high"]].round(2).to_string(index=False))
print(found.course[["model", "gap_mm", "low_mm", "high_mm", "loo_mm"]].round(4).to_string(index=False))
shares = where.links.set_index("part").share
assert shares[[f"link {k}" for k in range(1, 5)]].sum() > 0.95

# %%
# The other candidates
# --------------------
# Probabilities of the first step. They are relative to the hypotheses compared.

first = found.rankings[0]
for label in first.order[:5]:
    print(f"{label:28s} {first.probability[label]:.2g}")

# %%
# Test it on other poses
# ----------------------
# A cause must predict. Identify from the first 45 poses, with and without the effect, and predict the last 15. They
# are the warm end of the campaign, so this test is harder than random folds.

better = robot.with_effect(*found.effects())
logged, _ = derive(m, better.conditions)
early, late = logged[:45], logged[45:]
with_effect = identify(better, early, ("kinematic", "compliance", *(e.label for e in better.effects)), priors=True)
without = identify(robot, early, ("kinematic", "compliance"), priors=True)
before, after = (1e3 * errors(r.robot, late).mean() for r in (without, with_effect))
print(f"the last 15 poses: {before:.3f} mm without thermal growth in the model, {after:.3f} mm with it")
assert after < 0.4 * before

figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), sharey=True, layout="constrained")
for ax, fit, title in ((axes[0], without, "without"), (axes[1], with_effect, "with the effect")):
    e = 1e3 * errors(fit.robot, logged)
    ax.bar(np.arange(1, 61), e, color=["C0"] * 45 + ["C1"] * 15)
    ax.set(title=f"{title}: {e[45:].mean():.3f} mm on the last 15", xlabel="pose")
axes[0].set_ylabel("error [mm]")
plt.show()

# %%
# The solution
# ------------
# The simulator's log has the hidden effect, and the shrink for the exactly known effect.

answers = json.loads((CAMPAIGNS / "answers.json").read_text())
print(answers["kr210-P02"])
assert [e["effect"] for e in answers["kr210-P02"]["effects"]] == ["thermal_growth"]
assert abs(cause.shrink - answers["kr210-P02"]["true_shrink"]) < 0.05

# %%
# When there is nothing
# ---------------------
# A diagnosis that always finds something is useless. This campaign has no hidden effect.

nothing = diagnose(robot, read_measurements(CAMPAIGNS / "kr210-P08.csv", robot.n))
left, floor = 1e3 * nothing.gap.before, 1e3 * nothing.gap.floor
print(f"{nothing.verdict}: {left:.4f} mm are left, and noise alone would leave {floor:.4f} mm")
assert nothing.verdict == "none"
assert not nothing.causes

# %%
# When the result is ambiguous
# ----------------------------
# A UR10e with two small effects. The whole campaign of 120 poses identifies both. With the first half only, the result
# is ambiguous: the stiffness of joint 2 looks like backlash in that joint. The diagnosis says so, and `next_poses`
# gives the poses that distinguish the two. `separation` grows with each pose: 3 is a factor of 20.

arm = read_campaign_robot(ROOT / "problems/ur10e")
campaign = read_measurements(CAMPAIGNS / "ur10e-P09.csv", arm.n)
print("truth:", answers["ur10e-P09"]["effects"])
for name, part in (("half", campaign[:60]), ("whole", campaign)):
    answer = diagnose(arm, part)
    print(name, [(c.label, f"{c.confidence:.2f}", "or", c.indistinguishable) for c in answer.causes])
    if name == "half":
        half = answer
assert {c.label for c in answer.causes} == {"nonlinear_stiffness@2", "frame_drift"}
assert {c.label for c in half.causes} <= {"nonlinear_stiffness@2", "backlash@2", "frame_drift"}

poses = next_poses(half, 10, ["nonlinear_stiffness@2", "backlash@2"])
print(poses.round(2).head(3).dropna(axis=1, how="all").T.to_string(header=False))
assert len(poses) == 10
assert poses.separation.is_monotonic_increasing
assert poses.separation.iloc[-1] > 3

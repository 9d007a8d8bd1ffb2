"""
3. The HH800 as in the paper
============================

The paper calibrates a Hyundai HH800 in four ways and compares them in two tables. Its measurements are not public.
Here the same experiment runs on a **simulated** HH800: the paper's nominal geometry, assumed masses, and errors sized
so that KM and SKCM come near the paper's figures (``problems/hh800/README.md``). So agreement in size is no evidence.
The comparison is between the four methods on the same data: how much each gains over the previous one.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from casadical import calibrate
from casadical.compensator import Backprop, Iwo, JointBox, Layout, Network, make_task, train
from casadical.identification import errors, residual_mm

ROOT = Path(sys.argv[0]).resolve().parents[2]  # this file lies in docs/tutorials

# %%
# The experiment
# --------------
# 40 poses to identify the robot (the paper's Q1), 50 to train the network (Q2), 50 to report (Q3). We add 50 more,
# *choose*, which decide whether a network is kept; the report set is not used for this.

calibration = calibrate(ROOT / "problems/hh800")
problem, results = calibration.problem, calibration.identifications
sets = {name: parts[0] for name, parts in problem.sets.items()}
print({name: len(m) for name, m in sets.items()})
assert [len(sets[name]) for name in ("identify", "train", "choose", "report")] == [40, 50, 50, 50]

# %%
# Tables 2 and 3: what was identified
# -----------------------------------
# 29 kinematic parameters and the stiffness of joints 2 to 5, as in the paper. `d2`, `d6`, `theta6` and `L3` are not
# identifiable; they are the X marks of Table 3, and here each has its reason.

skcm = results["SKCM"]
print(skcm.verdict)
held = skcm.parameters.query("status == 'not identifiable'")
print(held[["name", "reason"]].to_string(index=False))
assert len(skcm.names) == 33
assert set(held.name) == {"d2", "d6", "theta6", "L3"}

# %%
# Train the paper's networks
# --------------------------
# Six joint angles in, five tansig nodes, three millimetres out: 53 weights, trained on 50 poses. `Backprop` is the
# paper's baseline, `Iwo` its invasive weed optimisation, with the paper's settings except eq. 17: as printed, all
# steps are positive and every weight drifts to its bound, so we use the normal steps of Mehrabian and Lucas (2006).
# One run proves nothing for methods with a random start: the paper shows one, we make fifteen.

layout = Layout(joints=6, hidden=(5,), outputs=3)
q, residual = sets["train"].q, residual_mm(skcm.robot, sets["train"])
box = JointBox(q.min(axis=0), q.max(axis=0))
task = make_task(layout, box, q, residual, scale_mm=1.0)
assert layout.count == 53


def trained(trainer, seed):
    """A network of the paper's size, used whether it helps or not, and how its loss fell."""
    outcome = train(task, trainer, seed=seed, every=10)
    return Network(layout, box, outcome.weights, 1.0), outcome.history


networks = {
    "NN-SKCM": [trained(Backprop(), seed) for seed in range(15)],
    "IWO-NN-SKCM": [trained(Iwo(), seed) for seed in range(15)],
}

# %%
# Tables 4 and 5: the errors
# --------------------------
# Rows of networks are medians over the fifteen seeds. The paper's figures, of a real robot, are in the other columns.


def left_mm(name, which, seed=0):
    """Position error of every pose of a set [mm] with one of the methods."""
    m = sets[which]
    if name == "before":
        return 1e3 * errors(skcm.placed, m)
    if name in results:
        return 1e3 * errors(results[name].robot, m)
    return np.linalg.norm(residual_mm(skcm.robot, m) - networks[name][seed][0].output_mm(m.q), axis=1)


def figures(name, which):
    """Mean, maximum and standard deviation [mm]; of networks the median over the seeds."""
    runs = [left_mm(name, which, seed) for seed in range(15 if name in networks else 1)]
    return np.median([(e.mean(), e.max(), e.std(ddof=1)) for e in runs], axis=0)


METHODS = ("before", "KM", "SKCM", "NN-SKCM", "IWO-NN-SKCM")
ours = {}
for title, which, printed in (
    ("Table 4 (KM, SKCM: set identify; networks: set train)", ("identify", "train"), problem.paper.calibration),
    ("Table 5 (set report)", ("report", "report"), problem.paper.validation),
):
    table = {name: figures(name, which[name in networks]) for name in METHODS}
    ours[which[1]] = table
    both = pd.DataFrame(
        [(*table[name], *printed[name]) for name in METHODS],
        index=METHODS,
        columns=["mean", "max", "std", "paper's mean", "max", "std"],
    )
    print(f"{title}, mm\n{both.round(3).to_string()}\n")

report = {name: row[0] for name, row in ours["report"].items()}

# %%
# KM and SKCM do what the paper says: joint compliance reduces the error, on new poses too.

assert report["before"] > 3.0
assert report["KM"] > report["SKCM"]
assert 0.5 < report["SKCM"] < 0.6

# %%
# The networks do not. Both reduce the error on their training poses and increase it on new ones: 53 weights fit the
# noise of 50 poses. Invasive weed optimisation increases it less, because it stops far from the minimum, not because
# it finds a better one.

trained_on = {name: ours["train"][name][0] for name in networks}
iwo, bp = (np.array([left_mm(name, "report", s).mean() for s in range(15)]) for name in ("IWO-NN-SKCM", "NN-SKCM"))
skcm_on_train = left_mm("SKCM", "train").mean()
worse = {"NN-SKCM": np.sum(bp > report["SKCM"]), "IWO-NN-SKCM": np.sum(iwo > report["SKCM"])}
print(f"poses trained on: SKCM {skcm_on_train:.3f} mm,", {name: f"{mean:.3f} mm" for name, mean in trained_on.items()})
print("new poses, seeds of 15 with a larger mean than SKCM's:", {name: int(n) for name, n in worse.items()})
print(f"IWO better than NN on new poses in {np.sum(iwo < bp)} of 15 seeds")
assert max(trained_on.values()) < skcm_on_train
assert min(worse.values()) >= 13

# %%
# Figures 6 and 7: error of each pose
# -----------------------------------

figure, axes = plt.subplots(2, 1, figsize=(9, 6), sharey=True, layout="constrained")
for ax, which, title in zip(axes, ("train", "report"), ("trained on (Fig. 6)", "new poses (Fig. 7)"), strict=True):
    for name in METHODS[1:]:
        ax.plot(np.arange(1, 51), left_mm(name, which), "o-", markersize=3, linewidth=0.8, label=name)
    ax.set(title=title, ylabel="error [mm]", ylim=(0, None))
axes[0].legend(ncols=4)
axes[1].set_xlabel("pose")
plt.show()

# %%
# The losses: invasive weed optimisation ends far above back-propagation.

figure, ax = plt.subplots(figsize=(7, 3.5), layout="constrained")
for colour, (name, runs) in zip(("C2", "C3"), networks.items(), strict=True):
    for seed, (_, history) in enumerate(runs):
        ax.semilogy(*zip(*history, strict=True), color=colour, linewidth=0.7, label=name if seed == 0 else None)
ax.set(xlabel="step (of invasive weeds: iteration)", ylabel="the paper's loss (eq. 14) [mm2]")
ax.legend()
plt.show()

# %%
# What helps
# ----------
# A network is kept only if it reduces the error on *choose*. And `GP-NN-SKCM` is better with fifty poses: it fits a
# Gaussian process with a length scale for each joint, and trains the network on its predictions. This network reaches
# the gain of the paper.

kept = calibration.networks.results
for name, found in kept.items():
    word = "kept" if found.helps else "REFUSED"
    print(f"{name:15s} {word:8s} mean on new poses {1e3 * found.errors['report'].mean:.3f} mm")
assert not kept["NN-SKCM"].helps
assert not kept["IWO-NN-SKCM"].helps
gain = 1 - 1e3 * kept["GP-NN-SKCM"].errors["report"].mean / report["SKCM"]
papers = 1 - 0.4662 / 0.5458
print(f"GP-NN-SKCM: {100 * gain:.0f} % less than SKCM; the paper's Table 5: {100 * papers:.1f} % for IWO-NN-SKCM")
assert gain > 0.15

# %%
# Where we differ from the paper, and why
# ---------------------------------------
# - On fifty poses, the paper's two networks make new poses worse here. In the paper they are better. Its data are not
#   public, so the reason is unknown; the results are the same with 50 other seeds of the trainers
#   (``docs/studies/twin_networks.txt``), and on a real UR10 both are rejected as well
#   (``docs/studies/real_networks.txt``).
# - The paper's explanation, that the method avoids local minima of gradient methods, does not hold on our data:
#   refined to their local minima, the results of gradient runs are as good or better.
# - More in ``docs/the-paper.md``, line by line.

"""python docs/studies/layers.py > docs/studies/layers.txt; draws docs/images/layers.png

A real UR10, layer by layer: held-out mean errors of three series of one robot, 300 poses of each learnt from, judged
on up to 2500 others (see joint_curves.py); the noise of repeated readings where a series has them.
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt

sys.path.insert(0, str(Path(__file__).parent))
from joint_curves import ROOT, SERIES, judged, split
from real_diagnoses import campaign

from casadical import Measurements, diagnose, identify, read_problem
from casadical.identification.accuracy import errors

NAMES = {"A": "A, grid", "B": "B, joint configurations", "C": "C, random poses"}
COLOURS = ("#b3ada2", "#8fb8b2", "#5f9f98", "#0f766e", "#0b5a54")


def layers(name: str, folder: str) -> dict[str, float]:
    """Mean error [mm] of each layer on poses that were never seen."""
    robot = read_problem(ROOT / "problems" / folder).robot
    learn, test = split(campaign(folder, robot), 300, 0)
    test = judged(name, test)

    def mean(r: object, m: Measurements = test) -> float:
        return float(1e3 * errors(r, m).mean())  # type: ignore[arg-type]

    rows = {}
    for layer, method in (("geometry", "KM"), ("compliance", "SKCM")):
        result = identify(robot, learn, method=method, loss="huber")
        rows.setdefault("base and tool alone", mean(result.placed))
        rows[layer] = mean(result.robot)
    found = diagnose(robot, learn)
    for top, cause in enumerate(found.causes, 1):
        if cause.effects:
            rows[cause.label.replace("_", " ")] = mean(found.apply(top))
    if found.replicates.enough:  # the mean length of an error whose coordinates scatter alike
        rows["(repeated readings scatter)"] = float(1e3 * found.replicates.sigma * np.sqrt(8 / np.pi))
    return rows


if __name__ == "__main__":
    print("real data; mean error of held-out poses [mm], 300 poses learnt from")
    figure, axes = plt.subplots(1, 3, figsize=(13, 2.8), sharex=True, layout="tight")
    for axis, (name, folder) in zip(axes, SERIES.items(), strict=True):
        rows = layers(name, folder)
        for layer, mean in rows.items():
            print(f"{name}  {layer:<28} {mean:.3f}", flush=True)
        axis.barh([*rows], [*rows.values()], color=[COLOURS[min(k, 4)] for k in range(len(rows))])
        for place, mean in enumerate(rows.values()):
            axis.text(mean, place, f" {mean:.2f}" if mean > 0.2 else f" {mean:.3f}", va="center", fontsize=9)
        axis.invert_yaxis()
        axis.set(title=f"UR10, series {NAMES[name]}", xlabel="mean error, poses never seen [mm]")
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_xlim(0, 1.3)
    figure.savefig(ROOT / "docs" / "images" / "layers.png", dpi=100, bbox_inches="tight")
